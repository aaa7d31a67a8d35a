"""The header of a journal, read where it is whole: by itself, or as the copy with a checksum."""

from pathlib import Path

from exumi_data.errors import DamagedDataError, ExumiError
from exumi_data.store.plain_files import read_plain
from exumi_recorders.journal.header import HEADER_LOG, JournalHeader, parse_header
from exumi_recorders.journal.reading import Damage, LogReader
from exumi_recorders.journal.record import salt_of
from exumi_recorders.journal.states import HEADER_NAME, SUFFIX

__all__ = ["read_header"]

_MOST_BYTES = 32 << 20


def read_header(journal: Path) -> tuple[JournalHeader, list[Damage]]:
    """Read a journal's header, and check that it is this journal's.

    Parameters
    ----------
    journal : pathlib.Path

    Returns
    -------
    header : JournalHeader
    damages : list of Damage
        One, where ``header.json`` is not what was written and the copy was taken.

    Raises
    ------
    ExumiError
        Neither is a header, or it is that of another journal.
    """
    path = journal / HEADER_NAME
    copy = _copy(journal)
    try:
        raw = read_plain(path, _MOST_BYTES)
    except (FileNotFoundError, ExumiError) as error:
        if copy is None:
            raise _without(journal) if isinstance(error, FileNotFoundError) else error from None
        raw = b""
    header = parse_header(raw if copy is None else copy, path)
    if f"{header.episode.id}{SUFFIX}" != journal.name:
        raise DamagedDataError(f"the header is that of {header.episode.id}", where=journal)
    if copy is None or raw == copy:
        return header, []
    return header, [Damage(path, 0, len(raw), None, "not as it was written: its copy was taken")]


def _copy(journal: Path) -> bytes | None:
    """Return the header's copy; None where it is not whole."""
    log = LogReader(journal / HEADER_LOG, salt_of(journal.name.removesuffix(SUFFIX), HEADER_LOG))
    try:
        return next((file for block in log for file in block.files), None)
    except OSError:
        return None


def _without(journal: Path) -> DamagedDataError:
    return DamagedDataError(
        "has samples, but no header.json, which says what they are",
        where=journal,
        fix="Restore it from a copy; the journal stays as it is.",
    )
