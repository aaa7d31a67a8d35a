"""Recovering: every journal that a crash left behind becomes an episode."""

import fcntl
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from exumi_data.catalog import CATALOG_NAME, read_catalog
from exumi_data.destination import update_catalog
from exumi_data.errors import ExumiError, UsageError
from exumi_recorders.finalise.episode import Finalised, dataset_of, finalise, inspect
from exumi_recorders.journal.space import drop_stale_reserve
from exumi_recorders.journal.states import (
    RECORDING_FOLDER,
    SUFFIX,
    list_journals,
    remove_leftovers,
)

__all__ = ["Recovery", "add_to_catalog", "find_journals", "for_journals", "recover"]


class _HasOutcome(Protocol):
    @property
    def outcome(self) -> str: ...


One = TypeVar("One", bound=_HasOutcome)


@dataclass(frozen=True, slots=True)
class Recovery:
    """What became of all journals.

    Attributes
    ----------
    done : tuple of Finalised
    failed : tuple of (pathlib.Path, str)
        Journals that stay as they were, and why.
    notices : tuple of str
        What else was found.
    """

    done: tuple[Finalised, ...]
    failed: tuple[tuple[Path, str], ...]
    notices: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "journals": [_document(one) for one in self.done],
            "failed": [{"journal": str(path), "reason": reason} for path, reason in self.failed],
            "notices": list(self.notices),
        }


def _document(one: Finalised) -> dict[str, Any]:
    return {
        "journal": str(one.journal),
        "outcome": one.outcome,
        "episode": None if one.episode is None else str(one.episode),
        "samples": dict(one.samples or {}),
        "damages": [{**asdict(damage), "path": str(damage.path)} for damage in one.damages],
        "truncated": one.truncated,
        "crashed": one.crashed,
    }


def find_journals(path: Path) -> list[Path]:
    """Return the journals that a path stands for.

    Parameters
    ----------
    path : pathlib.Path
        A journal, a dataset, or its folder ``.recording``.

    Raises
    ------
    UsageError
        It is none of these.
    """
    if not path.is_dir():
        raise UsageError("is no folder", where=path)
    whole = path.absolute()
    if whole.name.endswith(SUFFIX):
        dataset_of(whole)
        return [whole]
    if whole.name == RECORDING_FOLDER:
        return list_journals(whole.parent)
    if not (whole / RECORDING_FOLDER).is_dir() and not (whole / "dataset.json").is_file():
        raise UsageError(
            "is no dataset and no journal",
            where=path,
            fix=f"Name a dataset, its folder {RECORDING_FOLDER}, or a journal in it.",
        )
    return list_journals(whole)


def _dataset_at(path: Path) -> Path:
    """Return the dataset of a path that `find_journals` took."""
    whole = path.absolute()
    if whole.name.endswith(SUFFIX):
        return dataset_of(whole)
    return whole.parent if whole.name == RECORDING_FOLDER else whole


def recover(
    paths: Sequence[Path],
    *,
    dry_run: bool = False,
    on_done: Callable[[int, int, str], None] | None = None,
) -> Recovery:
    """Finalise journals; those that are being recorded or were discarded are left alone.

    A journal that cannot be finalised stays as it is, and does not keep the others.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        Journals, datasets, or folders ``.recording``.
    dry_run : bool
        Read all, and write nothing.
    on_done : callable, optional
        Called with the number of journals done, of all, and what became of the last one.

    Returns
    -------
    Recovery

    Raises
    ------
    UsageError
        A path is none of these. Nothing was done.
    """
    for path in paths:
        find_journals(path)  # nothing is done where one of them is none
    datasets = [] if dry_run else list(dict.fromkeys(map(_dataset_at, paths)))
    for dataset in datasets:
        drop_stale_reserve(dataset)  # first: on a full disk it is the room there is
    done, failed = for_journals(paths, inspect if dry_run else finalise, on_done)
    for dataset in datasets:
        remove_leftovers(dataset)
    notices = []
    for dataset in dict.fromkeys(
        dataset_of(one.journal) for one in done if one.outcome == "finalised"
    ):
        notices += add_to_catalog(dataset)
    return Recovery(tuple(done), tuple(failed), tuple(notices))


def for_journals(
    paths: Sequence[Path],
    work: Callable[[Path], One],
    on_done: Callable[[int, int, str], None] | None = None,
) -> tuple[list[One], list[tuple[Path, str]]]:
    """Do something with each journal; one that it fails for does not keep the others.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        Journals, datasets, or folders ``.recording``.
    work : callable
        Takes a journal, and returns what became of it.
    on_done : callable, optional
        Called with the number of journals done, of all, and what became of the last one.

    Returns
    -------
    done : list
        What `work` returned.
    failed : list of (pathlib.Path, str)
        The journals that it failed for, and why.

    Raises
    ------
    UsageError
        A path is none of these. Nothing was done.
    """
    journals = list(dict.fromkeys(journal for path in paths for journal in find_journals(path)))
    done: list[One] = []
    failed: list[tuple[Path, str]] = []
    for journal in journals:
        try:
            done.append(work(journal))
            outcome = done[-1].outcome
        except ExumiError as error:
            failed.append((journal, str(error)))
            outcome = "failed"
        except OSError as error:
            failed.append((journal, f"{error.filename or journal}: {error.strerror or error}"))
            outcome = "failed"
        except Exception as error:  # noqa: BLE001  # one journal must not keep the others
            what = f"cannot be made an episode of ({type(error).__name__}: {error})"
            failed.append((journal, what))
            outcome = "failed"
        if on_done is not None:
            on_done(len(done) + len(failed), len(journals), outcome)
    return done, failed


def add_to_catalog(dataset: Path) -> list[str]:
    """Add new episodes to a dataset's catalog; return why some, or all of it, could not be.

    Parameters
    ----------
    dataset : pathlib.Path
    """
    try:
        with _alone(dataset):
            return _add_to_catalog(dataset)
    except (ExumiError, OSError, ValueError) as error:
        return [f"{dataset}: the catalog was not written: {error}"]


def _add_to_catalog(dataset: Path) -> list[str]:
    table = read_catalog(dataset)
    if table is None and (dataset / CATALOG_NAME).exists():
        return [f"{dataset}: the catalog cannot be read. Write it with: exumi index {dataset}"]
    known = [] if table is None else table.to_pylist()
    return update_catalog(dataset, {row["path"]: row for row in known})


@contextmanager
def _alone(dataset: Path) -> Iterator[None]:
    """Wait until no other recorder of the dataset adds to its catalog: one would lose the other's.

    Parameters
    ----------
    dataset : pathlib.Path
    """
    descriptor = os.open(dataset / RECORDING_FOLDER, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
