"""Whether a journal's header and logs belong together: a journal that would lose samples stays.

A log whose bytes are damaged costs the samples in them. But where a header names other streams than
there are logs, or says that samples are of another length than they are, whole samples would be
dropped with the journal: then the header is what is damaged, and nothing is made of it.
"""

import os
from pathlib import Path

from exumi_data.errors import DamagedDataError
from exumi_recorders.finalise.rows import payload_bytes_of
from exumi_recorders.journal.header import CLOCK_LOG, EVENTS_LOG, HEADER_LOG, JournalHeader
from exumi_recorders.journal.reading import LogReader
from exumi_recorders.journal.record import salt_of
from exumi_recorders.journal.states import HEADER_NAME

__all__ = ["check_agreement", "has_samples"]

_SEGMENTS = "*/*.log"
_FIX = "Restore it from a copy; the journal stays as it is."


def has_samples(journal: Path) -> bool:
    """Whether any log of a journal holds bytes.

    Parameters
    ----------
    journal : pathlib.Path
    """
    # The copy of the header is written before the first sample.
    logs = (path for path in journal.glob(_SEGMENTS) if path.parent.name != HEADER_LOG)
    return any(path.lstat().st_size for path in logs)


def check_agreement(journal: Path, header: JournalHeader) -> None:
    """Refuse a journal whose header and logs do not belong together.

    Parameters
    ----------
    journal : pathlib.Path
    header : JournalHeader

    Raises
    ------
    DamagedDataError
        A log is a link, is not in the header, or holds whole records of another length.
    """
    known = {*header.streams, EVENTS_LOG, CLOCK_LOG, HEADER_LOG}
    for folder in journal.iterdir():
        if folder.is_symlink():
            raise DamagedDataError("is a link; links are not followed", where=folder)
    for path in sorted(journal.glob(_SEGMENTS)):
        if path.is_symlink():
            raise DamagedDataError("is a link; links are not followed", where=path)
        if path.parent.name not in known and path.lstat().st_size:
            raise DamagedDataError(
                f"names no stream {path.parent.name!r}, of which there is a log",
                where=journal / HEADER_NAME,
                fix=_FIX,
            )
    for name, stream in header.streams.items():
        stated = payload_bytes_of(stream)
        found = None if stated is None else _payload_bytes(journal, header, name)
        if found not in (None, stated):
            raise DamagedDataError(
                f"says that a sample of {name} has {stated} bytes, and those in its log have "
                f"{found}",
                where=journal / HEADER_NAME,
                fix=_FIX,
            )


def _payload_bytes(journal: Path, header: JournalHeader, name: str) -> int | None:
    """Return the length of the first whole record of a log; None where there is none."""
    folder = journal / name
    if not os.path.lexists(folder):
        return None
    for block in LogReader(folder, salt_of(header.episode.id, name)):
        return len(block.files[0])
    return None
