"""The directory of a packed episode, checked: what it may hold, and where members begin."""

import io
import stat
import struct
import zipfile
from typing import IO

from exumi_data.errors import DamagedDataError
from exumi_data.store.paths import check_member_path

__all__ = [
    "LOCAL_HEADER_BYTES",
    "LOCAL_MAGIC",
    "MAX_DIRECTORY",
    "BoundedFile",
    "data_start",
    "read_members",
]

LOCAL_MAGIC = b"PK\x03\x04"
MAX_DIRECTORY = 16 << 20
"""Bytes of the largest directory that is read: each entry takes ten times its bytes in memory."""
_LOCAL_HEADER = struct.Struct("<4s5H3I2H")
LOCAL_HEADER_BYTES = _LOCAL_HEADER.size
"""Bytes in front of a member's name."""
_ENCRYPTED = 0x1
_DATA_DESCRIPTOR = 0x8


class BoundedFile(io.FileIO):
    """A zip as `zipfile` may read it: its directory at once, but none of a hundred megabytes."""

    def read(self, size: int | None = -1) -> bytes:
        """Read; raises `ValueError` where more is asked for than a directory has."""
        if size is not None and size > MAX_DIRECTORY:
            msg = f"a directory of {size:,} bytes"
            raise ValueError(msg)
        return super().read(size) or b""


def read_members(file: IO[bytes], size: int, where: str) -> dict[str, tuple[int, int]]:
    """Read the directory of a packed episode.

    Parameters
    ----------
    file : binary file
        That never gives more than a directory at once.
    size : int
        Of the zip, bytes.
    where : str
        The zip, named in errors.

    Returns
    -------
    dict of str to (int, int)
        Of each member where its local header is, and how long its data is.

    Raises
    ------
    DamagedDataError
        No zip, or one that holds what a packed episode may not.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
    except (
        zipfile.BadZipFile,
        ValueError,
        OverflowError,
        NotImplementedError,
        OSError,
        struct.error,
    ) as error:
        raise DamagedDataError(
            f"not a readable zip ({error})",
            where=where,
            fix="It was probably cut short; copy it again from its source.",
        ) from None
    members: dict[str, tuple[int, int]] = {}
    for info in infos:
        is_folder = info.orig_filename.endswith("/")
        name = check_member_path(info.orig_filename.removesuffix("/"), where)
        problem = None
        if is_folder:
            problem = "is a directory entry; a packed episode has files only"
        elif name in members:
            problem = "appears twice"
        elif info.compress_type != zipfile.ZIP_STORED:
            problem = "is compressed; a packed episode is stored only"
        elif info.flag_bits & (_ENCRYPTED | _DATA_DESCRIPTOR):
            problem = "is encrypted or has a data descriptor"
        elif info.compress_size != info.file_size:
            problem = "has two different sizes"
        elif stat.S_ISLNK(info.external_attr >> 16):
            problem = "is a link"
        elif not 0 <= info.header_offset <= size - info.file_size:
            problem = "lies beyond the end of the file"
        if problem:
            raise DamagedDataError(
                f"{name} {problem}",
                where=where,
                fix="Unpack it elsewhere and pack it again with: exumi pack",
            )
        members[name] = (info.header_offset, info.file_size)
    if sum(length for _, length in members.values()) > size:
        # Bytes that belong to many members would make much data from a small file.
        raise DamagedDataError("members overlap", where=where)
    return members


def data_start(raw: bytes, header: int, path: str, end: int, where: str) -> int:
    """Return where a member's data begins: its local header's extra field may differ.

    Parameters
    ----------
    raw : bytes
        The local header and the name after it.
    header : int
        Where that stands in the zip.
    path : str
        The member, as the directory has it.
    end : int
        The latest place where its data may begin.
    where : str
        The zip, named in errors.

    Raises
    ------
    DamagedDataError
        It is no local header of that member.
    """
    name = path.encode()
    fields = _LOCAL_HEADER.unpack_from(raw)
    start = int(header + _LOCAL_HEADER.size + fields[9] + fields[10])
    sound = (
        fields[0] == LOCAL_MAGIC
        and not fields[2] & (_ENCRYPTED | _DATA_DESCRIPTOR)
        and fields[3] == zipfile.ZIP_STORED
        and fields[9] == len(name)
        and raw.endswith(name)
        and start <= end
    )
    if not sound:
        raise DamagedDataError(f"{path} has no valid local header", where=where)
    return start
