"""Episodes taken out of a dataset; of each a tombstone stays, with the reason."""

import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from exumi_data.catalog import build_catalog, rows_to_table
from exumi_data.dataset import Dataset, read_metadata
from exumi_data.editing.copying import chosen_of
from exumi_data.editing.documents import write_splits
from exumi_data.errors import DamagedDataError, ExumiError, MetadataError, NotAnEpisodeError
from exumi_data.store.files import sync_folder, write_atomic

__all__ = [
    "TOMBSTONE",
    "Unreadable",
    "find_unreadable",
    "id_in_name",
    "remove_episodes",
    "remove_unreadable",
]

TOMBSTONE = ".removed-"
"""``.removed-<id>.json`` stays beside where an episode was: what it was, and why it went."""

_GONE = (FileNotFoundError, NotADirectoryError, IsADirectoryError)


def remove_episodes(
    dataset: Dataset,
    ids: Sequence[str],
    reason: str,
    *,
    on_done: Callable[[int], None] = lambda _done: None,
) -> None:
    """Remove episodes: from the splits first, then one by one, each at once.

    Parameters
    ----------
    dataset : Dataset
    ids : sequence of str
    reason : str
    on_done : callable
        Told how many are done.
    """
    _shorten_splits(dataset, set(ids))
    for number, one in enumerate(chosen_of(dataset, ids)):
        known = {"id": one.id, "revision": one.row["revision"], "digest": one.row["digest"]}
        _remove(one.path, {**known, "reason": reason})
        on_done(number + 1)


@dataclass(frozen=True, slots=True)
class Unreadable:
    """What of a dataset cannot be read; why, by the path of the episode below the dataset.

    Attributes
    ----------
    dataset : Dataset
        Of the episodes that can be read.
    damaged : dict of str to str
        Documents or times are damaged or missing.
    left_alone : dict of str to str
        What may well be whole: this program, or this computer, cannot read it, or its metadata say
        what the standard does not know.
    """

    dataset: Dataset
    damaged: dict[str, str]
    left_alone: dict[str, str]


def find_unreadable(root: Path, on_done: Callable[[int], None] = lambda _done: None) -> Unreadable:
    """Read every episode of a dataset, as far as its catalog needs it.

    Parameters
    ----------
    root : pathlib.Path
    on_done : callable
        Told how many are read.

    Returns
    -------
    Unreadable

    Raises
    ------
    NotAnEpisodeError, MetadataError, UnsupportedError
        There is no ``dataset.json``, or it breaks the standard, or is newer.
    """
    metadata = read_metadata(str(root))
    done = count(1)
    table, failed = build_catalog(root, on_done=lambda _outcome: on_done(next(done)))
    # Once more, here: what was for a moment is over, and a worker does not tell what caused it.
    again, failed = build_catalog(root, paths=[one.item for one in failed], workers=1)
    damaged: dict[str, str] = {}
    left_alone: dict[str, str] = {}
    for one in sorted(failed, key=lambda outcome: outcome.item):
        error = one.error
        if isinstance(error, ExumiError):
            # Without the folder that the dataset happens to lie in: it stays in the note.
            (damaged if _is_damage(error) else left_alone)[one.item] = error.what
    whole = rows_to_table([*table.to_pylist(), *again.to_pylist()])
    return Unreadable(Dataset(str(root), metadata, whole), damaged, left_alone)


def _is_damage(error: ExumiError) -> bool:
    """Whether no other program, computer or day could read an episode, and nobody could mend it."""
    cause = error.__cause__
    if isinstance(cause, OSError) and not isinstance(cause, _GONE):
        return False
    if isinstance(error, MetadataError):
        return not error.problems  # not even JSON
    return isinstance(error, DamagedDataError | NotAnEpisodeError)


def remove_unreadable(
    unreadable: Unreadable,
    reason: str,
    *,
    on_done: Callable[[int], None] = lambda _done: None,
) -> None:
    """Remove episodes that are damaged, as `remove_episodes` does those that are not.

    Parameters
    ----------
    unreadable : Unreadable
    reason : str
    on_done : callable
        Told how many are done.
    """
    dataset = unreadable.dataset
    _shorten_splits(dataset, {id_in_name(path) for path in unreadable.damaged})
    for number, (path, problem) in enumerate(unreadable.damaged.items()):
        said = {"id": id_in_name(path), "problem": problem, "reason": reason}
        _remove(Path(dataset.path, path), said)
        on_done(number + 1)


def id_in_name(path: str) -> str:
    """Return the id that an episode has by its path.

    Parameters
    ----------
    path : str
    """
    return Path(path).name.removesuffix(".zip").removesuffix(".zarr")


def _shorten_splits(dataset: Dataset, gone: Iterable[str]) -> None:
    shorter = {}
    for name, document in dataset.splits.items():
        lists = {
            part: [one for one in listed if one not in gone]
            for part, listed in document.lists.items()
        }
        if lists != document.lists:
            shorter[name] = document.model_copy(update={"lists": lists})
    write_splits(Path(dataset.path), shorter)


def _remove(path: Path, said: Mapping[str, Any]) -> None:
    name = said["id"]
    write_atomic(path.with_name(f"{TOMBSTONE}{name}.json"), (json.dumps(said) + "\n").encode())
    # From here on it is no episode; a command that is killed leaves what the next one clears away.
    aside = path.with_name(f".partial-{name}{'.zip' if path.is_file() else ''}")
    if aside.is_dir():
        shutil.rmtree(aside)
    path.rename(aside)
    sync_folder(path.parent)
    if aside.is_dir():
        shutil.rmtree(aside)
    else:
        aside.unlink()
