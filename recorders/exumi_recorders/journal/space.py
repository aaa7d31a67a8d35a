"""Room on the disk: how much a recording needs, and what is kept back for its end."""

import errno
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exumi_data.errors import ExumiError
from exumi_data.store.files import try_lock
from exumi_data.time import parse_rate
from exumi_recorders.contract import Blocks, Files, Port, Rows
from exumi_recorders.journal.record import HEADER_BYTES
from exumi_recorders.journal.states import RECORDING_FOLDER

__all__ = [
    "NoRoomError",
    "Reserve",
    "SpaceLimits",
    "bytes_per_second",
    "check_room",
    "drop_stale_reserve",
    "free_bytes",
    "seconds_left",
]

_FILE_NAME = ".reserve"
_JPEG_BYTES_PER_PIXEL = 0.3
_USUAL_RATE = 100.0


class NoRoomError(ExumiError):
    """There is too little room on the disk to record."""


@dataclass(frozen=True, slots=True)
class SpaceLimits:
    """How much room has to be there.

    Attributes
    ----------
    soft_bytes : int
        With less, no episode is begun.
    hard_bytes : int
        With less, the one that is being recorded is ended.
    reserve_bytes : int
        Size of a file that is there only to be removed when the disk is full, so that what is
        being recorded can be closed.
    """

    soft_bytes: int = 2 << 30
    hard_bytes: int = 128 << 20
    reserve_bytes: int = 32 << 20


def free_bytes(folder: Path) -> int:
    """Return how many bytes a user can still write to a folder's file system.

    Parameters
    ----------
    folder : pathlib.Path
    """
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize


def bytes_per_second(ports: Iterable[Port]) -> float:
    """Estimate how fast a recording grows, from the rates that the makers state.

    Parameters
    ----------
    ports : iterable of Port
    """
    return sum(map(_bytes_per_second, ports))


def _bytes_per_second(port: Port) -> float:
    rate = _USUAL_RATE if port.nominal_rate is None else float(parse_rate(port.nominal_rate))
    if isinstance(port.payload, Blocks):
        return rate * HEADER_BYTES + 2.0 * port.payload.channels * float(
            parse_rate(port.payload.rate)
        )
    return rate * (HEADER_BYTES + _payload_bytes(port.payload))


def _payload_bytes(payload: Files | Rows) -> float:
    if isinstance(payload, Files):
        return payload.height * payload.width * _JPEG_BYTES_PER_PIXEL
    arrays = payload.arrays.values()
    return float(sum(np.dtype(dtype).itemsize * np.prod(shape) for dtype, shape in arrays))


def seconds_left(folder: Path, ports: Iterable[Port], limits: SpaceLimits) -> float:
    """Estimate for how long can be recorded, seconds.

    Parameters
    ----------
    folder : pathlib.Path
    ports : iterable of Port
    limits : SpaceLimits
    """
    rate = bytes_per_second(ports)
    room = max(0, free_bytes(folder) - limits.hard_bytes)
    # Finalising needs the same room again, for as long as the journal is there.
    return room / (2 * rate) if rate else float("inf")


def check_room(folder: Path, limits: SpaceLimits) -> None:
    """Refuse to begin where the disk is nearly full.

    Parameters
    ----------
    folder : pathlib.Path
    limits : SpaceLimits

    Raises
    ------
    NoRoomError
        Less than the soft limit is free.
    """
    free = free_bytes(folder)
    if free < limits.soft_bytes:
        raise NoRoomError(
            f"only {free / 1e9:.2f} GB are free, {limits.soft_bytes / 1e9:.2f} GB are needed to "
            "begin an episode",
            where=folder,
            fix="Copy recordings away and remove them here, or record to another disk.",
        )


class Reserve:
    """Room that is kept back until the disk is full.

    The file is locked for as long as it is held: what a crash left behind can be told.

    Parameters
    ----------
    dataset : pathlib.Path
    size : int
        Bytes; 0 keeps nothing back.
    """

    def __init__(self, dataset: Path, size: int) -> None:
        self.path = dataset / RECORDING_FOLDER / _FILE_NAME
        self._size = size
        self._held: int | None = None

    def hold(self) -> None:
        """Take the room, if it is not taken yet, by this or by another recorder.

        Raises
        ------
        NoRoomError
            There is none.
        """
        if not self._size or (self._held is not None and self.path.exists()):
            return
        self.leave()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        descriptor = os.open(self.path, flags, 0o644)
        try:
            try_lock(descriptor)
        except BlockingIOError:
            os.close(descriptor)  # another recorder of this dataset holds it, for both
            return
        self._held = descriptor
        try:
            if os.fstat(descriptor).st_size < self._size:
                os.posix_fallocate(descriptor, 0, self._size)
        except OSError as error:
            self.release()
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise NoRoomError("the disk is full", where=self.path.parent) from error
            raise

    def release(self) -> None:
        """Give the room back, now that the disk is full, or when nothing is recorded any more."""
        self.path.unlink(missing_ok=True)
        self.leave()

    def leave(self) -> None:
        """Give back what this recorder holds; another one's stays."""
        held, self._held = self._held, None
        if held is not None:
            self.path.unlink(missing_ok=True)
            os.close(held)


def drop_stale_reserve(dataset: Path) -> None:
    """Remove the reserve that a crash left behind; one that somebody holds stays.

    Parameters
    ----------
    dataset : pathlib.Path
    """
    path = Reserve(dataset, 0).path
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return
    try:
        try_lock(descriptor)
        path.unlink(missing_ok=True)
    except BlockingIOError:
        pass
    finally:
        os.close(descriptor)
