"""UDP datagrams with the time at which Linux's kernel received them, and a count of lost ones."""

import errno
import select
import socket
import struct
import sys
import time
from dataclasses import dataclass

from exumi_recorders.contract import DeviceError, DeviceLostError

__all__ = ["ClockPair", "Datagram", "StampedSocket", "take_clock_pair", "to_monotonic"]

# Python's socket module does not have them: asm-generic/socket.h, the same on x86 and ARM.
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_TIMESPEC = struct.Struct("@ll")
_COUNT = struct.Struct("@I")
_ANCILLARY_BYTES = 256

_PAIR_ATTEMPTS = 3
_STEP_NS = 1_000_000  # clocks are slewed by less than a microsecond between two reads
_MAX_DATAGRAMS = 1024  # in one read, so that a flood does not keep it from returning

_OTHER_ADDRESS = "Name an address of this machine (hostname -I), or 0.0.0.0 for all of them."
_FIXES = {
    errno.EADDRINUSE: (
        "Another program may be listening there, or another device of this rig: end it, or use "
        "another port."
    ),
    errno.EACCES: "Ports below 1024 are for the system: use another one.",
}


@dataclass(frozen=True, slots=True)
class ClockPair:
    """CLOCK_REALTIME and CLOCK_MONOTONIC of one instant.

    Attributes
    ----------
    monotonic_ns : int
        Midway between the readings before and after that of the other clock.
    realtime_ns : int
    bracket_ns : int
        Time between those readings.
    """

    monotonic_ns: int
    realtime_ns: int
    bracket_ns: int

    @property
    def offset_ns(self) -> int:
        """What leads from CLOCK_REALTIME to CLOCK_MONOTONIC."""
        return self.monotonic_ns - self.realtime_ns


@dataclass(frozen=True, slots=True)
class Datagram:
    """A datagram that has come.

    Attributes
    ----------
    data : bytes
    time_ns : int
        CLOCK_MONOTONIC at which the kernel received it.
    sender : tuple of (str, int)
        Address and port.
    """

    data: bytes
    time_ns: int
    sender: tuple[str, int]


def take_clock_pair() -> ClockPair:
    """Read both clocks, a few times, and return the pair that was read fastest."""
    pairs = []
    for _ in range(_PAIR_ATTEMPTS):
        before = time.monotonic_ns()
        realtime = time.time_ns()
        after = time.monotonic_ns()
        pairs.append(ClockPair((before + after) // 2, realtime, after - before))
    return min(pairs, key=lambda pair: pair.bracket_ns)


def to_monotonic(realtime_ns: int, before: ClockPair, after: ClockPair) -> int:
    """Return the CLOCK_MONOTONIC of a kernel's stamp.

    The kernel stamps by CLOCK_REALTIME, which may be set to another time at any moment. A stamp
    that was made between the two pairs is one that either offset puts between them.

    Parameters
    ----------
    realtime_ns : int
        The stamp.
    before, after : ClockPair
        Taken before it can have been made and after it was read.

    Returns
    -------
    int
        Never later than `after`. Where the clock was set and neither offset fits, `after`'s own
        time: the datagram came then or before.
    """
    if abs(after.offset_ns - before.offset_ns) <= _STEP_NS:
        return min(realtime_ns + after.offset_ns, after.monotonic_ns)
    first, last = before.monotonic_ns - _STEP_NS, after.monotonic_ns + _STEP_NS
    for offset_ns in (before.offset_ns, after.offset_ns):
        if first <= realtime_ns + offset_ns <= last:
            return min(realtime_ns + offset_ns, after.monotonic_ns)
    return after.monotonic_ns


class StampedSocket:
    """A bound UDP socket whose datagrams carry the kernel's stamps.

    For a few milliseconds after the first such socket of a machine is opened, the kernel does not
    stamp yet: datagrams of that time get the time at which they are read.

    Parameters
    ----------
    host : str
        IPv4 address of this machine to listen on; ``0.0.0.0`` for all.
    port : int
        0 for any that is free.
    buffer_bytes : int
        Wanted size of the receive buffer; the kernel may allow less.
    max_bytes : int
        Longer datagrams are cut to one byte more than this.

    Raises
    ------
    DeviceError
        The system is not Linux, or the address cannot be used.
    """

    def __init__(self, host: str, port: int, *, buffer_bytes: int, max_bytes: int) -> None:
        if sys.platform != "linux":
            raise DeviceError(
                "datagrams are stamped by Linux's kernel only", fix="Record on a Linux machine."
            )
        self._max_bytes = max_bytes
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
            self._socket.setblocking(False)
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise DeviceError(
                f"cannot listen for datagrams: {error.strerror}",
                where=f"{host}:{port}",
                fix=_FIXES.get(error.errno or 0, _OTHER_ADDRESS),
            ) from error
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)
        self._before = take_clock_pair()
        self._offset_ns = self._before.offset_ns
        self._last_count = 0
        self.dropped = 0
        """Datagrams that the kernel has dropped since, for want of room in the buffer."""
        self.utc_steps = 0
        """How often CLOCK_REALTIME was set to another time."""

    @property
    def address(self) -> tuple[str, int]:
        """Address and port that it listens on."""
        host, port = self._socket.getsockname()
        return host, port

    @property
    def buffer_bytes(self) -> int:
        """Size of the receive buffer that the kernel gave, with its own bookkeeping."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    @property
    def stamp_sigma_ns(self) -> float:
        """How well the kernel's clock was compared with CLOCK_MONOTONIC last time."""
        return self._before.bracket_ns / 2

    def receive(self, timeout_s: float) -> list[Datagram]:
        """Return what has come, in order; wait for the first, but not longer.

        Parameters
        ----------
        timeout_s : float

        Raises
        ------
        DeviceLostError
            The socket fails, as when the network goes.
        """
        try:
            self._poll.poll(max(0.0, timeout_s * 1e3))
            drained_from = take_clock_pair()
            raw = self._drain()
        except OSError as error:
            raise DeviceLostError(f"datagrams cannot be received: {error.strerror}") from error
        after = take_clock_pair()
        if abs(after.offset_ns - self._offset_ns) > _STEP_NS:
            self.utc_steps += 1
        self._offset_ns = after.offset_ns
        found = [
            Datagram(
                data,
                after.monotonic_ns
                if stamp_ns is None
                else to_monotonic(stamp_ns, self._before, after),
                sender,
            )
            for data, stamp_ns, sender in raw
        ]
        # What is read next came while the buffer was emptied, or later. Should it not be empty
        # yet, the rest came earlier: the older pair stays.
        if len(raw) < _MAX_DATAGRAMS:
            self._before = drained_from
        return found

    def send(self, data: bytes, to: tuple[str, int]) -> None:
        """Send a datagram; one that cannot be sent is dropped, as the network may drop it.

        Parameters
        ----------
        data : bytes
        to : tuple of (str, int)
            Address and port.
        """
        try:
            self._socket.sendto(data, to)
        except OSError:
            return

    def close(self) -> None:
        """Close the socket; also a second time."""
        self._socket.close()

    def _drain(self) -> list[tuple[bytes, int | None, tuple[str, int]]]:
        found = []
        for _ in range(_MAX_DATAGRAMS):
            try:
                data, ancillary, _, sender = self._socket.recvmsg(
                    self._max_bytes + 1, _ANCILLARY_BYTES
                )
            except BlockingIOError:
                break
            stamp_ns = None
            for level, kind, value in ancillary:
                if level != socket.SOL_SOCKET:
                    continue
                if kind == _SO_TIMESTAMPNS:
                    seconds, nanoseconds = _TIMESPEC.unpack_from(value)
                    stamp_ns = seconds * 1_000_000_000 + nanoseconds
                elif kind == _SO_RXQ_OVFL:
                    self._count(_COUNT.unpack_from(value)[0])
            found.append((data, stamp_ns, sender))
        return found

    def _count(self, count: int) -> None:
        self.dropped += (count - self._last_count) & 0xFFFFFFFF
        self._last_count = count
