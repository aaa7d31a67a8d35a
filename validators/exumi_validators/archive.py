"""The directory of a packed episode, read without trusting it."""

import os
import stat
import struct
import zipfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from exumi_data.store.zip_directory import BoundedFile

__all__ = ["ArchiveContext", "Member", "read_archive"]

_LOCAL_HEADER = struct.Struct("<4s5H3I2H")
_UNREADABLE = (
    zipfile.BadZipFile,
    ValueError,
    OverflowError,
    NotImplementedError,
    struct.error,
)
_LOCAL_SIGNATURE = b"PK\x03\x04"


@dataclass(frozen=True, slots=True)
class Member:
    """One entry of the directory, with what its local header says.

    Attributes
    ----------
    info : zipfile.ZipInfo
    name : str
        As it is stored.
    local : str or None
        What is wrong with the local header.
    start, end : int
        Where the member's bytes begin and end in the file.
    """

    info: zipfile.ZipInfo
    name: str
    local: str | None
    start: int
    end: int

    @property
    def is_link(self) -> bool:
        """Whether it is a symbolic link."""
        return stat.S_ISLNK(self.info.external_attr >> 16)


@dataclass(frozen=True, slots=True)
class ArchiveContext:
    """A packed episode as the checks of packing see it.

    Attributes
    ----------
    mistake : str or None
        Why the directory cannot be read.
    members : tuple of Member
        In the order of the directory.
    path : str
        Of the zip.
    directory : int
        Where the directory begins.
    comment : bytes
        What follows the directory.
    """

    mistake: str | None
    members: tuple[Member, ...] = ()
    path: str = ""
    directory: int = 0
    comment: bytes = b""


def read_archive(path: str | os.PathLike[str]) -> ArchiveContext:
    """Read the directory and all local headers.

    Parameters
    ----------
    path : path-like
    """
    try:
        with BoundedFile(os.fspath(path)) as raw, zipfile.ZipFile(raw) as archive:
            infos = archive.infolist()
            directory, comment = archive.start_dir, archive.comment
    except _UNREADABLE as error:
        return ArchiveContext(f"not a readable zip: {error}")
    with Path(path).open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        members = tuple(_member(file.fileno(), info, size) for info in infos)
    return ArchiveContext(None, members, os.fspath(path), directory, comment)


def _member(descriptor: int, info: zipfile.ZipInfo, size: int) -> Member:
    name = info.orig_filename
    start = info.header_offset
    raw = os.pread(descriptor, _LOCAL_HEADER.size, start) if 0 <= start < size else b""
    if len(raw) < _LOCAL_HEADER.size:
        return Member(info, name, "there is no local header where the directory says", start, start)
    fields = _LOCAL_HEADER.unpack(raw)
    name_length, extra_length = fields[9], fields[10]
    local_name = os.pread(descriptor, name_length, start + _LOCAL_HEADER.size)
    first = start + _LOCAL_HEADER.size + name_length + extra_length
    end = first + info.compress_size
    mistake = None
    if fields[0] != _LOCAL_SIGNATURE:
        mistake = "there is no local header where the directory says"
    elif local_name not in _encodings(name):
        mistake = "the local header has another name"
    elif fields[8] not in (info.file_size, 0xFFFFFFFF):
        mistake = "the local header has another size"
    elif fields[6] != info.CRC:
        mistake = "the local header has another checksum"
    elif end > size:
        mistake = "it lies beyond the end of the file"
    return Member(info, name, mistake, first, end)


def _encodings(name: str) -> set[bytes]:
    found = {name.encode("utf-8", "surrogateescape")}
    with suppress(UnicodeEncodeError):
        found.add(name.encode("cp437"))
    return found
