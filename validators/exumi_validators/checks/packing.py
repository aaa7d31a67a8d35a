"""Packed episodes: what the zip's directory may hold."""

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from exumi_data.errors import DamagedDataError
from exumi_data.store.pack import packing_order
from exumi_data.store.paths import check_member_path
from exumi_validators.archive import ArchiveContext, Member
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = [
    "checksums",
    "dates",
    "folders",
    "links",
    "local_headers",
    "names",
    "nothing_else",
    "once",
    "order",
    "readable",
    "stored",
]

_WHOLE = "."
_EPOCH = (1980, 1, 1, 0, 0, 0)
_ENCRYPTED = 0x1
_DATA_DESCRIPTOR = 0x8
_PIECE = 1 << 20


def _is_folder(member: Member) -> bool:
    return member.name.endswith("/")


@check("PACK-001")
def readable(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that the directory can be read."""
    if archive.mistake is not None:
        yield problem("PACK-001", _WHOLE, detail=archive.mistake)


@check("SAFE-001")
def names(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that no name leads out of the episode."""
    for index, member in enumerate(archive.members):
        if _is_folder(member):
            continue
        try:
            check_member_path(member.name, _WHOLE)
        except DamagedDataError:
            yield problem("SAFE-001", _WHOLE, index=index, found=member.name)


@check("SAFE-002")
def links(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that there are no links."""
    for index, member in enumerate(archive.members):
        if member.is_link:
            yield problem("SAFE-002", _WHOLE, index=index, found=member.name)


@check("PACK-002")
def stored(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that members are stored as they are."""
    for index, member in enumerate(archive.members):
        info = member.info
        mistake = None
        if info.compress_type != 0:
            mistake = "is compressed"
        elif info.flag_bits & _ENCRYPTED:
            mistake = "is encrypted"
        elif info.flag_bits & _DATA_DESCRIPTOR:
            mistake = "has a data descriptor"
        elif info.compress_size != info.file_size:
            mistake = "has two different sizes"
        if mistake:
            yield problem("PACK-002", _WHOLE, index=index, found=member.name, detail=mistake)


@check("PACK-003")
def once(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that every name stands once."""
    seen: set[str] = set()
    for index, member in enumerate(archive.members):
        if member.name in seen:
            yield problem("PACK-003", _WHOLE, index=index, found=member.name)
        seen.add(member.name)


@check("PACK-004")
def folders(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that folders have no entries of their own."""
    for index, member in enumerate(archive.members):
        if _is_folder(member):
            yield problem("PACK-004", _WHOLE, index=index, found=member.name)


@check("PACK-005")
def order(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that metadata comes first: the root's, then the others, breadth first."""
    # A name that stands twice is the matter of another rule.
    found = list(dict.fromkeys(m.name for m in archive.members if not _is_folder(m)))
    metadata = packing_order([name for name in found if name.rpartition("/")[2] == "zarr.json"])
    for index, (name, expected) in enumerate(zip(found, metadata, strict=False)):
        if name != expected:
            yield problem("PACK-005", _WHOLE, index=index, expected=expected, found=name)
            return


@check("PACK-006")
def dates(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that members carry no date of their own."""
    for index, member in enumerate(archive.members):
        date = member.info.date_time
        if date != _EPOCH:
            detail = "{:04}-{:02}-{:02} {:02}:{:02}:{:02}".format(*date)
            yield problem("PACK-006", _WHOLE, index=index, found=member.name, detail=detail)
            return


@check("PACK-007")
def local_headers(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that the two descriptions of a member agree, and that no byte belongs to two."""
    last = 0
    by_place = sorted(enumerate(archive.members), key=lambda pair: pair[1].info.header_offset)
    seen: dict[int, str] = {}
    for index, member in by_place:
        start = member.info.header_offset
        mistake = member.local
        if mistake is None and start < last and seen.get(start) != member.name:
            mistake = "it overlaps another member"
        if mistake:
            yield problem("PACK-007", _WHOLE, index=index, found=member.name, detail=mistake)
        last = max(last, member.end)
        seen[start] = member.name


@check("PACK-008")
def nothing_else(archive: ArchiveContext) -> Iterator[Problem]:
    """Judge that every byte belongs to a member or to the directory."""
    if archive.mistake is not None or any(local_headers(archive)) or any(once(archive)):
        return
    last = 0
    for member in sorted(archive.members, key=lambda member: member.info.header_offset):
        if member.info.header_offset > last:
            break
        last = member.end
    if last < archive.directory:
        detail = f"the bytes from {last} on belong to no member"
        yield problem("PACK-008", _WHOLE, detail=detail)
    elif archive.comment:
        yield problem("PACK-008", _WHOLE, detail="the zip has a comment")


@check("PACK-009")
def checksums(archive: ArchiveContext) -> Iterator[Problem]:
    """Read every member and judge its checksum."""
    if archive.mistake is not None or any(local_headers(archive)) or any(stored(archive)):
        return
    with Path(archive.path).open("rb") as file:
        for index, member in enumerate(archive.members):
            if _crc32(file, member) != member.info.CRC:
                yield problem("PACK-009", _WHOLE, index=index, found=member.name)


def _crc32(file: BinaryIO, member: Member) -> int:
    file.seek(member.start)
    left, value = member.end - member.start, 0
    while left:
        piece = file.read(min(left, _PIECE))
        if not piece:
            return -1
        value, left = zlib.crc32(piece, value), left - len(piece)
    return value
