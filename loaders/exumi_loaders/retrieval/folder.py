"""The folder of an index: one writer at a time, readers at any time, whole at any moment."""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from exumi_data.errors import NotAnEpisodeError, UsageError
from exumi_data.model.documents import MAX_DOCUMENT_BYTES
from exumi_data.store.files import try_lock, write_atomic
from exumi_data.store.plain_files import read_plain
from exumi_loaders.retrieval.document import IndexDocument, dump_index, parse_index
from exumi_loaders.retrieval.segments import SEGMENTS

__all__ = ["DOCUMENT", "changing", "read_document", "write_document"]

DOCUMENT = "index.json"
_PATIENCE_S = 60.0
_POLL_S = 0.02


def read_document(root: Path) -> IndexDocument:
    """Read ``index.json``.

    Raises
    ------
    NotAnEpisodeError
        There is none.
    MetadataError, UnsupportedError
        It breaks the model, or is newer.
    """
    try:
        raw = read_plain(root / DOCUMENT, MAX_DOCUMENT_BYTES)
    except FileNotFoundError:
        raise NotAnEpisodeError(
            "no index.json: not an index",
            where=root,
            fix="Make one with: exumi index build DATASET INDEX",
        ) from None
    return parse_index(raw, root / DOCUMENT)


def write_document(root: Path, document: IndexDocument) -> None:
    """Write ``index.json``, whole or not at all: with it, a change has happened."""
    raw = dump_index(document)
    parse_index(raw, root / DOCUMENT)  # what is written can be read
    write_atomic(root / DOCUMENT, raw)


@contextmanager
def changing(root: Path) -> Iterator[IndexDocument]:
    """Hold an index for a change, and yield what it is now.

    Another process that changes it waits. What a process left behind that died is removed.

    Parameters
    ----------
    root : pathlib.Path

    Raises
    ------
    UsageError
        Another process has held it for a minute.
    """
    read_document(root)
    descriptor = os.open(root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _lock(descriptor, root)
        document = read_document(root)
        _remove_leftovers(root, document)
        yield document
    finally:
        os.close(descriptor)


def _lock(descriptor: int, root: Path) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while True:
        try:
            try_lock(descriptor)
            return
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise UsageError(
                    "another process is changing it", where=root, fix="Wait until it has ended."
                ) from None
            time.sleep(_POLL_S)


def _remove_leftovers(root: Path, document: IndexDocument) -> None:
    """Remove segments that no document names, and documents that were never finished."""
    known = {segment.name for segment in document.segments}
    with suppress(FileNotFoundError):
        for folder in (root / SEGMENTS).iterdir():
            if folder.name not in known and not folder.is_symlink() and folder.is_dir():
                shutil.rmtree(folder, ignore_errors=True)
    for file in root.glob(f".partial-*-{DOCUMENT}"):
        file.unlink(missing_ok=True)
