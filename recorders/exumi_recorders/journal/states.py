"""What state a journal is in, and how one that was discarded comes back.

A discarded journal stays where it is, as a tombstone with the reason; its logs are removed only by
`purge`, after which it cannot come back.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from exumi_data.errors import MetadataError, UsageError
from exumi_data.model.base import Model, Version
from exumi_data.model.documents import check_version, dump, load_json
from exumi_data.store.files import try_lock, write_atomic
from exumi_data.store.plain_files import read_plain

__all__ = [
    "HEADER_NAME",
    "RECORDING_FOLDER",
    "REMOVED",
    "STATE_NAME",
    "SUFFIX",
    "JournalState",
    "State",
    "bytes_of_logs",
    "discard",
    "journal_folder",
    "judge",
    "list_journals",
    "locked",
    "purge",
    "read_state",
    "remove_leftovers",
    "undo_discard",
    "write_state",
]

RECORDING_FOLDER = ".recording"
SUFFIX = ".rec"
HEADER_NAME = "header.json"
REMOVED = ".removed"
"""In place of `SUFFIX`, of a journal whose episode is complete: nobody reads it any more."""
STATE_NAME = "state.json"
STATE_FORMAT = "exumi-journal-state"
_MOST_BYTES = 1 << 16

State = Literal["recording", "stopped", "finalised", "discarded"]


class JournalState(Model):
    """The document ``state.json``, replaced as a whole."""

    format: Literal["exumi-journal-state"] = "exumi-journal-state"
    version: Version = "1.0"
    state: State
    reason: Annotated[str, Field(max_length=1000)] | None = None
    """Why it was discarded."""
    truncated: Annotated[str, Field(max_length=1000)] | None = None
    """Why recording ended before it was stopped: ``disk_full``, or an error of the disk."""
    success: bool | None = None
    """Whether the task was done, where that was said after the recording."""
    purged: bool = False
    """Whether the logs of a discarded journal are gone."""


def journal_folder(dataset: Path, episode_id: str) -> Path:
    """Return where the journal of an episode is.

    Parameters
    ----------
    dataset : pathlib.Path
    episode_id : str
    """
    return dataset / RECORDING_FOLDER / f"{episode_id}{SUFFIX}"


def list_journals(dataset: Path) -> list[Path]:
    """Return the journals of a dataset, sorted by name.

    Parameters
    ----------
    dataset : pathlib.Path
    """
    folder = dataset / RECORDING_FOLDER
    if folder.is_symlink() or not folder.is_dir():
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.name.endswith(SUFFIX) and path.is_dir() and not path.is_symlink()
    )


def remove_leftovers(dataset: Path) -> None:
    """Remove what is left of journals whose removal was interrupted.

    Parameters
    ----------
    dataset : pathlib.Path
    """
    folder = dataset / RECORDING_FOLDER
    if not folder.is_symlink():
        for path in folder.glob(f"*{REMOVED}"):
            shutil.rmtree(path, ignore_errors=True)


def read_state(journal: Path) -> JournalState:
    """Return a journal's state. One that cannot be read was being recorded when the power went.

    Parameters
    ----------
    journal : pathlib.Path

    Raises
    ------
    DamagedDataError
        There is something else of that name.
    UnsupportedError
        It is of a newer version.
    """
    path = journal / STATE_NAME
    try:
        document = load_json(read_plain(path, _MOST_BYTES), path)
        newer = check_version(document, STATE_FORMAT, path)
        return JournalState.model_validate_json(
            json.dumps(document), context={"newer_minor": newer}
        )
    except (FileNotFoundError, MetadataError, ValidationError):
        return JournalState(state="recording")


def write_state(journal: Path, state: JournalState) -> None:
    """Replace a journal's state, durably.

    Parameters
    ----------
    journal : pathlib.Path
    state : JournalState
    """
    write_atomic(journal / STATE_NAME, (json.dumps(dump(state)) + "\n").encode())


@contextmanager
def locked(journal: Path) -> Iterator[None]:
    """Hold a journal: nobody else records, finalises or discards it meanwhile.

    Parameters
    ----------
    journal : pathlib.Path

    Raises
    ------
    BlockingIOError
        Another one holds it: it is being recorded, or finalised.
    """
    descriptor = os.open(journal, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        try_lock(descriptor)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _changed(journal: Path) -> Iterator[JournalState]:
    try:
        with locked(journal):
            yield read_state(journal)
    except FileNotFoundError:
        raise UsageError(
            "is not there", where=journal, fix="It may have become an episode already."
        ) from None
    except BlockingIOError:
        raise UsageError(
            "is being recorded or finalised", where=journal, fix="Stop it first."
        ) from None


def discard(journal: Path, reason: str) -> None:
    """Make a stopped journal a tombstone.

    Parameters
    ----------
    journal : pathlib.Path
    reason : str

    Raises
    ------
    UsageError
        It is held by somebody, or is not there.
    """
    with _changed(journal) as state:
        write_state(
            journal, state.model_copy(update={"state": "discarded", "reason": reason[:1000]})
        )


def undo_discard(journal: Path) -> None:
    """Take a discarded journal back.

    Parameters
    ----------
    journal : pathlib.Path

    Raises
    ------
    UsageError
        It was not discarded, or its logs are gone.
    """
    with _changed(journal) as state:
        if state.state != "discarded" or state.purged:
            what = "its logs are gone" if state.purged else f"it is {state.state}"
            raise UsageError(f"cannot be taken back: {what}", where=journal)
        write_state(journal, state.model_copy(update={"state": "stopped", "reason": None}))


def judge(journal: Path, *, success: bool) -> None:
    """Say of a stopped journal whether the task was done; it counts more than what was said before.

    Parameters
    ----------
    journal : pathlib.Path
    success : bool

    Raises
    ------
    UsageError
        It is held by somebody, or is not there.
    """
    with _changed(journal) as state:
        write_state(journal, state.model_copy(update={"success": success}))


def bytes_of_logs(journal: Path) -> int:
    """Return how many bytes `purge` would remove.

    Parameters
    ----------
    journal : pathlib.Path
    """
    return sum(
        path.lstat().st_size
        for folder in _folders_of(journal)
        for path in folder.rglob("*")
        if not path.is_dir()
    )


def _folders_of(journal: Path) -> list[Path]:
    return [entry for entry in journal.iterdir() if entry.is_dir() and not entry.is_symlink()]


def purge(journal: Path) -> int:
    """Remove the logs of a discarded journal; header and state stay as the tombstone.

    Parameters
    ----------
    journal : pathlib.Path

    Returns
    -------
    int
        The bytes that were removed.

    Raises
    ------
    UsageError
        It was not discarded.
    """
    with _changed(journal) as state:
        if state.state != "discarded":
            raise UsageError(f"is not discarded but {state.state}", where=journal)
        size = bytes_of_logs(journal)
        write_state(journal, state.model_copy(update={"purged": True}))
        for folder in _folders_of(journal):
            shutil.rmtree(folder)
        return size
