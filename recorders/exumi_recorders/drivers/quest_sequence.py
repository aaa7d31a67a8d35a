"""What the sequence numbers of a headset's datagrams tell: lost, late, twice, restarted."""

from typing import Literal, TypeAlias

__all__ = ["Order", "SequenceWatch"]

Order: TypeAlias = Literal["next", "late", "twice", "restart"]

_WINDOW = 1024
_PATIENCE = 32  # a number that is so far behind the newest does not come any more
_LATE_NS = 10_000_000_000


class SequenceWatch:
    """Judges datagrams by their sequence number and the device's time, one after the other.

    Parameters
    ----------
    modulus : int
        Where the numbers wrap.

    Attributes
    ----------
    lost : int
        Numbers that have been passed over and did not come since.
    settled : int
        Those of them that have had time enough to come: it never goes down.
    late, twice, restarts : int
        How often each was found.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._newest: int | None = None
        self._newest_ns = 0
        self._seen = 0  # bit i: the number `newest - i` has come
        self._span = 0  # newest less first: what came before the first was never counted as lost
        self.lost = self.settled = 0
        self.late = 0
        self.twice = 0
        self.restarts = 0

    def take(self, sequence: int, time_device_ns: int) -> Order:
        """Return how a datagram stands to those before it.

        Parameters
        ----------
        sequence : int
            As sent.
        time_device_ns : int
            As sent. A number that is not new with a newer time comes from an app that has been
            started again; so does one with a much older time, from a headset that has.
        """
        if self._newest is None:
            self._start(sequence, time_device_ns)
            return "next"
        half = self._modulus // 2
        ahead = (sequence - self._newest + half) % self._modulus - half
        if ahead > 0:
            self.lost += ahead - 1
            self._span += ahead
            self._seen = (self._seen << min(ahead, _WINDOW)) & ((1 << _WINDOW) - 1) | 1
            self._newest, self._newest_ns = sequence, time_device_ns
            self.settled = max(self.settled, self.lost - self._awaited())
            return "next"
        newer_ns = time_device_ns - self._newest_ns
        if ahead <= -_WINDOW or newer_ns > 0 or newer_ns < -_LATE_NS:
            self._start(sequence, time_device_ns)
            self.restarts += 1
            return "restart"
        if self._seen >> -ahead & 1:
            self.twice += 1
            return "twice"
        self._seen |= 1 << -ahead
        self.late += 1
        self.lost -= -ahead <= self._span
        return "late"

    def _awaited(self) -> int:
        """Return how many of the newest numbers may still come."""
        newest = min(_PATIENCE, self._span)
        return newest - (self._seen & ((1 << newest) - 1)).bit_count()

    def _start(self, sequence: int, time_device_ns: int) -> None:
        self._newest, self._newest_ns = sequence, time_device_ns
        self._seen, self._span = 1, 0
