"""Keeps two runs out of one destination."""

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from exumi_data.errors import UsageError

__all__ = ["only_run"]

_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)


@contextmanager
def only_run(root: Path) -> Iterator[None]:
    """Be the only run that writes into a dataset.

    The lock is the system's own on the folder itself: it leaves no file, and ends with the process.

    Raises
    ------
    UsageError
        Another one does.
    """
    descriptor = os.open(root, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(
                "another command is writing into this dataset",
                where=root,
                fix="Wait until it is done, or stop it.",
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS_HERE:
                raise
        yield
    finally:
        os.close(descriptor)
