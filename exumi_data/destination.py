"""The dataset that a command writes into: made or taken up, by one at a time; its catalog."""

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from exumi_data.catalog import (
    EPISODES_FOLDER,
    build_catalog,
    list_episodes,
    read_catalog,
    rows_to_table,
    write_catalog,
)
from exumi_data.dataset import (
    DATASET_DOCUMENT,
    UNFINISHED_DOCUMENT,
    create_dataset,
    make_dataset,
)
from exumi_data.engine import Engine
from exumi_data.errors import ExumiError, UsageError
from exumi_data.model import DatasetMetadata
from exumi_data.store.access import open_store
from exumi_data.store.digest import digest_of
from exumi_data.store.files import sync_folder, try_lock

__all__ = ["begin", "finish", "is_current", "only_run", "suspend", "take_up", "update_catalog"]


def take_up(path: Path, metadata: DatasetMetadata) -> Path:
    """Make a dataset, or take up the one that is there.

    Parameters
    ----------
    path : pathlib.Path
    metadata : DatasetMetadata
        Of a new one.

    Returns
    -------
    pathlib.Path
        Its folder.

    Raises
    ------
    UsageError
        The folder holds something else, or cannot be written.
    """
    with _told_as_usage(path):
        root = create_dataset(path, metadata)
        (root / EPISODES_FOLDER).mkdir(exist_ok=True)
    return root


def begin(path: Path, metadata: DatasetMetadata) -> None:
    """Make a dataset that is none to any reader until `finish`, or take up the one that is there.

    Parameters
    ----------
    path : pathlib.Path
    metadata : DatasetMetadata
        Of a new one.

    Raises
    ------
    UsageError
        The folder holds something else, or cannot be written.
    """
    with _told_as_usage(path):
        # In this order: another run may finish meanwhile.
        if not any((path / name).exists() for name in (UNFINISHED_DOCUMENT, DATASET_DOCUMENT)):
            make_dataset(path, metadata, UNFINISHED_DOCUMENT)
        (path / EPISODES_FOLDER).mkdir(exist_ok=True)


def suspend(root: Path) -> None:
    """Make a dataset none to any reader until `finish`.

    Parameters
    ----------
    root : pathlib.Path
    """
    if (root / DATASET_DOCUMENT).exists():
        (root / DATASET_DOCUMENT).replace(root / UNFINISHED_DOCUMENT)
        sync_folder(root)


def finish(root: Path) -> None:
    """Make what was begun or suspended a dataset to every reader.

    Parameters
    ----------
    root : pathlib.Path
    """
    if not (root / DATASET_DOCUMENT).exists():
        (root / UNFINISHED_DOCUMENT).replace(root / DATASET_DOCUMENT)
        sync_folder(root)
    (root / UNFINISHED_DOCUMENT).unlink(missing_ok=True)


@contextmanager
def _told_as_usage(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"cannot be made ({error.strerror})", where=path, fix="Name a folder you may write to."
        ) from None


@contextmanager
def only_run(root: Path) -> Iterator[None]:
    """Be the only run that writes into a dataset.

    The lock is the system's own on the folder itself: it leaves no file, and ends with the process.

    Parameters
    ----------
    root : pathlib.Path

    Raises
    ------
    UsageError
        Another one does.
    """
    descriptor = os.open(root, os.O_RDONLY)
    try:
        try:
            try_lock(descriptor)
        except BlockingIOError:
            raise UsageError(
                "another command is writing into this dataset",
                where=root,
                fix="Wait until it is done, or stop it.",
            ) from None
        yield
    finally:
        os.close(descriptor)


def update_catalog(
    root: Path,
    known: Mapping[str, dict[str, Any]],
    *,
    workers: int | None = None,
    engine: Engine | None = None,
) -> list[str]:
    """Write the catalog, if it is not what it should be; read the episodes that are not known.

    Parameters
    ----------
    root : pathlib.Path
        The dataset.
    known : mapping of str to dict
        Rows that are right, by path. Those of episodes that are gone are left out.
    workers : int, optional
        Processes; default all cores.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.

    Returns
    -------
    list of str
        Episodes that cannot be read, and why.

    Raises
    ------
    UsageError, OSError
        The catalog cannot be written.
    """
    present = list_episodes(root)
    rows = [known[path] for path in present if path in known]
    todo = [path for path in present if path not in known]
    built, problems = build_catalog(root, paths=todo, workers=workers, engine=engine)
    table = rows_to_table([*rows, *built.to_pylist()])
    before = read_catalog(root)
    if before is None or not table.equals(before):
        write_catalog(root, table)
    return [f"not in the catalog, because it cannot be read: {one.error}" for one in problems]


def is_current(path: Path, row: Mapping[str, Any]) -> bool:
    """Whether the documents of an episode are those that its row of the catalog was made from.

    The bytes of its streams are not read. One that cannot be read is not current.

    Parameters
    ----------
    path : pathlib.Path
        Of the episode.
    row : mapping
    """
    try:
        store = open_store(path)
    except ExumiError:
        return False  # reading it will say what is wrong
    try:
        if hashlib.sha256(store.read("zarr.json")).hexdigest() != row["root_sha256"]:
            return False
        there = "derived/zarr.json" in store.paths()
        return bool((digest_of(store, derived=True) if there else None) == row["derived_digest"])
    except (ExumiError, OSError):
        return False
    finally:
        store.close()
