"""Where the members of a buffer go: files in a folder, or a zip that is written as they come."""

import struct
import tempfile
import zlib
from abc import ABC, abstractmethod
from pathlib import Path
from typing import IO, Self

__all__ = ["FolderSink", "Sink", "ZipSink", "open_sink"]

_LOCAL = struct.Struct("<4s5H3L2H")
_ENTRY = struct.Struct("<4s6H3L5H2L")
_END = struct.Struct("<4s4H2LH")
_END64 = struct.Struct("<4sQ2H2L4Q")
_LOCATOR = struct.Struct("<4sLQL")
_DATE = 1 << 5 | 1  # 1980-01-01
_UNIX = 3 << 8
_VERSION = 20
_VERSION64 = 45
_MODE = (0o100644) << 16
_LARGE, _LARGE_SHORT = 0xFFFFFFFF, 0xFFFF
_COPY_PIECE = 4 << 20


class Sink(ABC):
    """Takes members by name; a context manager that closes it."""

    @abstractmethod
    def put(self, name: str, content: bytes) -> None:
        """Write one."""

    @abstractmethod
    def close(self) -> None:
        """Finish."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class FolderSink(Sink):
    """Files in a folder that is there.

    Parameters
    ----------
    folder : pathlib.Path
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: set[str] = set()

    def put(self, name: str, content: bytes) -> None:
        """Write a file; its folder is made."""
        parent = name.rpartition("/")[0]
        if parent not in self._made:
            (self._folder / parent).mkdir(parents=True, exist_ok=True)
            self._made.add(parent)
        (self._folder / name).write_bytes(content)

    def close(self) -> None:
        """Do nothing: every file is closed."""


class ZipSink(Sink):
    """A zip whose members are stored, without dates: equal members give equal bytes.

    Its directory grows in a file of its own, so that memory does not grow with the members.

    Parameters
    ----------
    path : pathlib.Path
        Must not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._file: IO[bytes] = path.open("xb")
        self._directory: IO[bytes] = tempfile.TemporaryFile(  # noqa: SIM115  # closed with the sink
            dir=path.parent
        )
        self._offset = 0
        self._count = 0

    def put(self, name: str, content: bytes) -> None:
        """Write a member."""
        raw = name.encode("ascii")
        size, crc = len(content), zlib.crc32(content)
        self._file.write(
            _LOCAL.pack(b"PK\3\4", _VERSION, 0, 0, 0, _DATE, crc, size, size, len(raw), 0)
        )
        self._file.write(raw)
        self._file.write(content)
        far = self._offset >= _LARGE
        extra = struct.pack("<2HQ", 1, 8, self._offset) if far else b""
        version = _VERSION64 if far else _VERSION
        self._directory.write(
            _ENTRY.pack(
                b"PK\1\2",
                _UNIX | version,
                version,
                0,
                0,
                0,
                _DATE,
                crc,
                size,
                size,
                len(raw),
                len(extra),
                0,
                0,
                0,
                _MODE,
                _LARGE if far else self._offset,
            )
        )
        self._directory.write(raw + extra)
        self._offset += _LOCAL.size + len(raw) + size
        self._count += 1

    def close(self) -> None:
        """Write the directory."""
        size = self._directory.tell()
        self._directory.seek(0)
        while piece := self._directory.read(_COPY_PIECE):
            self._file.write(piece)
        self._directory.close()
        start, count = self._offset, self._count
        if start >= _LARGE or size >= _LARGE or count >= _LARGE_SHORT:
            end = start + size
            self._file.write(
                _END64.pack(
                    b"PK\6\6",
                    _END64.size - 12,
                    _UNIX | _VERSION64,
                    _VERSION64,
                    0,
                    0,
                    count,
                    count,
                    size,
                    start,
                )
            )
            self._file.write(_LOCATOR.pack(b"PK\6\7", 0, end, 1))
        short = min(count, _LARGE_SHORT)
        self._file.write(
            _END.pack(b"PK\5\6", 0, 0, short, short, min(size, _LARGE), min(start, _LARGE), 0)
        )
        self._file.close()


def open_sink(target: Path) -> Sink:
    """Return where the members of a buffer go.

    Parameters
    ----------
    target : pathlib.Path
        A folder that is there, or the name of a zip to make.
    """
    return FolderSink(target) if target.is_dir() else ZipSink(target)
