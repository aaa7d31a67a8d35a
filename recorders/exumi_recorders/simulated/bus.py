"""An I2C bus with the calls of smbus2's ``SMBus`` and one AS5600 on it.

The chip turns as the simulated gripper opens and closes; faults are those of loose wires.
"""

import errno
import os
import time
from array import array
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from exumi_data.simulation import PlaySession
from exumi_recorders.simulated.as5600_chip import ADDRESS, As5600Chip

__all__ = ["SimulatedBus", "gripper_counts"]

_LOOK_UP_HZ = 1000
_NS = 1_000_000_000


def gripper_counts(session: PlaySession, epoch_ns: int) -> Callable[[int], float]:
    """Return the encoder's angle as a function of the hub's clock.

    The truth is looked up in a table with 1 ms between its points: a hand's width is a straight
    line over so short a time, and a bus read takes a microsecond instead of a hundred.

    Parameters
    ----------
    session : PlaySession
    epoch_ns : int
        CLOCK_MONOTONIC at the session's start.

    Returns
    -------
    callable
        From CLOCK_MONOTONIC (ns) to unwrapped counts; at rest before the start and after the end.
    """
    encoder = session.encoder
    points = int(session.truth.duration_s * _LOOK_UP_HZ) + 2
    table: array[float] = array("d")
    for start in range(0, points, _LOOK_UP_HZ):
        # A second at a time: the truth compares every time with every motion of the session.
        times_s = np.arange(start, min(start + _LOOK_UP_HZ, points)) / _LOOK_UP_HZ
        widths = session.truth.width_m(times_s)
        table.extend((encoder.zero_count + encoder.counts_per_m * widths).tolist())
    last = len(table) - 2

    def counts(now_ns: int) -> float:
        place = (now_ns - epoch_ns) * (_LOOK_UP_HZ / _NS)
        index = min(max(int(place), 0), last)
        share = min(max(place - index, 0.0), 1.0)
        left: float = table[index]
        return left + share * (table[index + 1] - left)

    return counts


class SimulatedBus:
    """The calls of ``smbus2.SMBus`` that devices are read with.

    Parameters
    ----------
    chip : As5600Chip
        The only device on the bus.
    address : int, optional
    transfer_s : float, optional
        How long a read keeps the bus; 0.12 ms for two bytes at 400 kHz. The chip takes its value
        midway. 0 for at once.

    Attributes
    ----------
    chip : As5600Chip
    is_plugged : bool
        Whether the chip is there: without it nobody acknowledges.
    away_ns : tuple of (int, int)
        Spans of CLOCK_MONOTONIC in which it is not plugged in either.
    """

    def __init__(
        self, chip: As5600Chip, *, address: int = ADDRESS, transfer_s: float = 0.0
    ) -> None:
        self.chip = chip
        self.is_plugged = True
        self.away_ns: tuple[tuple[int, int], ...] = ()
        self.is_open = True
        self._address = address
        self._half_s = transfer_s / 2
        self._faults: deque[int] = deque()

    def fail(self, number: int, times: int = 1) -> None:
        """Let the next transfers fail.

        Parameters
        ----------
        number : int
            ``errno.EREMOTEIO`` for a missing acknowledgement, ``errno.ETIMEDOUT`` for a bus held
            low ...
        times : int, optional
        """
        self._faults.extend([number] * times)

    def transfer(self, address: int, data: bytes, count: int) -> bytes:
        """Write bytes and, after a repeated start, read some.

        Raises
        ------
        OSError
            Nobody acknowledges, or a fault that was asked for.
        """
        now_ns = time.monotonic_ns()
        away = any(start <= now_ns < end for start, end in self.away_ns)
        if self._faults:
            raise _os_error(self._faults.popleft())
        if address != self._address or not self.is_plugged or away:
            raise _os_error(errno.EREMOTEIO)
        self.chip.write(data)
        if not count:
            return b""
        if self._half_s:
            time.sleep(self._half_s)
            now_ns = time.monotonic_ns()
        given = self.chip.read(count, now_ns)
        if self._half_s:
            time.sleep(self._half_s)
        return given

    def read_byte(self, i2c_addr: int, force: bool | None = None) -> int:
        """Read the byte at the pointer."""
        return self.transfer(i2c_addr, b"", 1)[0]

    def read_byte_data(self, i2c_addr: int, register: int, force: bool | None = None) -> int:
        """Read one register."""
        return self.transfer(i2c_addr, bytes([register]), 1)[0]

    def read_word_data(self, i2c_addr: int, register: int, force: bool | None = None) -> int:
        """Read two bytes, the first as the lower one, as SMBus has it."""
        return int.from_bytes(self.transfer(i2c_addr, bytes([register]), 2), "little")

    def read_i2c_block_data(
        self,
        i2c_addr: int,
        register: int,
        length: int,
        force: bool | None = None,
    ) -> list[int]:
        """Read some bytes."""
        return list(self.transfer(i2c_addr, bytes([register]), length))

    def write_byte(self, i2c_addr: int, value: int, force: bool | None = None) -> None:
        """Set the pointer."""
        self.transfer(i2c_addr, bytes([value]), 0)

    def write_byte_data(
        self,
        i2c_addr: int,
        register: int,
        value: int,
        force: bool | None = None,
    ) -> None:
        """Write one register."""
        self.transfer(i2c_addr, bytes([register, value]), 0)

    def write_i2c_block_data(
        self,
        i2c_addr: int,
        register: int,
        data: list[int],
        force: bool | None = None,
    ) -> None:
        """Write registers."""
        self.transfer(i2c_addr, bytes([register, *data]), 0)

    def close(self) -> None:
        """Close it."""
        self.is_open = False

    def __enter__(self) -> "SimulatedBus":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def _os_error(number: int) -> OSError:
    return OSError(number, os.strerror(number))
