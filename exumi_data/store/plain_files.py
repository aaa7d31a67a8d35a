"""Files of a dataset that lie beside its episodes: opened without following or waiting."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

from exumi_data.errors import DamagedDataError, LimitError

__all__ = ["is_plain_file", "open_plain", "read_plain"]


def is_plain_file(path: Path) -> bool:
    """Whether a path is a file itself: no link, no pipe, no device."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def open_plain(path: Path) -> BufferedReader:
    """Open a file for reading.

    Raises
    ------
    FileNotFoundError
        Nothing of that name is there.
    DamagedDataError
        It is a link, a folder, a pipe or a device, or may not be read.
    """
    # Opening a pipe would wait for ever for its writer; a link could lead anywhere.
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(path, flags)
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(path) from None
    except OSError as error:
        what = "is a link; links are not followed" if error.errno == errno.ELOOP else None
        what = what or f"cannot be read ({error.strerror})"
        raise DamagedDataError(what, where=path) from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise DamagedDataError("is no file", where=path)
    return open(descriptor, "rb")  # noqa: PTH123  # a descriptor has no path


def read_plain(path: Path, limit: int) -> bytes:
    """Read a small file.

    Raises
    ------
    FileNotFoundError
        Nothing of that name is there.
    DamagedDataError
        It is a link, a folder, a pipe or a device, or cannot be read.
    LimitError
        It is larger than `limit` bytes.
    """
    with open_plain(path) as file:
        try:
            raw = file.read(limit + 1)
        except OSError as error:
            raise DamagedDataError(f"cannot be read ({error.strerror})", where=path) from error
    if len(raw) > limit:
        raise LimitError(f"the file has more than {limit:,} bytes", where=path)
    return raw
