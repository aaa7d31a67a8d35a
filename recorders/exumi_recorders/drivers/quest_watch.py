"""What a headset's driver keeps an eye on: poses that freeze or jump, the flag, who sends."""

from collections import deque
from math import dist

from exumi_recorders.drivers.quest_dialects import Pose

__all__ = ["FlagWatch", "PoseWatch", "RateWatch", "SenderWatch"]

_S_NS = 1_000_000_000
_FASTEST_M_PER_S = 5.0
_STEADY = 3
_SENDER_SILENT_NS = 2 * _S_NS


class PoseWatch:
    """Notices that a pose does not change any more, and that it jumps.

    Parameters
    ----------
    jump_m : float
        The least distance between two poses, metres, that is a jump; it must also be further than
        a hand moves in the time between them.

    Attributes
    ----------
    jumps : int
    latest : tuple of float or None
        The last pose.
    """

    def __init__(self, jump_m: float) -> None:
        self._jump_m = jump_m
        self._shift = (0.0, 0.0, 0.0)
        self._time_ns = 0
        self._changed_ns = 0
        self.latest: Pose | None = None
        self.jumps = 0

    @property
    def frozen_s(self) -> float:
        """How long the pose had been the same, to the last digit, when the last one came."""
        return (self._time_ns - self._changed_ns) / _S_NS

    @property
    def shifted_m(self) -> float:
        """How far all jumps together lead: nothing, where the pose has jumped back."""
        return dist(self._shift, (0.0, 0.0, 0.0))

    def take(self, time_ns: int, pose: Pose) -> float | None:
        """Look at the next pose; return the distance if it is a jump, metres.

        Parameters
        ----------
        time_ns : int
        pose : tuple of float
        """
        before, before_ns = self.latest, self._time_ns
        self.latest, self._time_ns = pose, time_ns
        if pose != before:
            self._changed_ns = time_ns
        if before is None:
            return None
        moved_m = dist(before[:3], pose[:3])
        possible_m = _FASTEST_M_PER_S * (time_ns - before_ns) / _S_NS
        if moved_m <= max(self._jump_m, possible_m):
            return None
        self.jumps += 1
        x, y, z = (s + new - old for s, new, old in zip(self._shift, pose, before, strict=False))
        self._shift = (x, y, z)
        return moved_m

    def settle(self) -> None:
        """Forget the jumps: the poses' world is known anew."""
        self._shift = (0.0, 0.0, 0.0)


class FlagWatch:
    """Finds when the operator's flag changed, in datagrams that may be out of order.

    Attributes
    ----------
    on : bool
        The flag; off until it is known.
    """

    def __init__(self) -> None:
        self.on = False
        self._run = 0
        self._since_ns = 0

    def take(self, time_ns: int, flag: bool) -> int | None:
        """Look at the next flag; return when it changed, once that is sure.

        Parameters
        ----------
        time_ns : int
        flag : bool

        Returns
        -------
        int or None
            The time of the first of three datagrams in a row that say so.
        """
        if flag == self.on:
            self._run = 0
            return None
        if self._run == 0:
            self._since_ns = time_ns
        self._run += 1
        if self._run < _STEADY:
            return None
        self.on, self._run = flag, 0
        return self._since_ns


class SenderWatch:
    """Keeps to one headset where several send: poses of two would be mixed.

    Parameters
    ----------
    only : str, optional
        The address to keep to; without it, the first, until that is silent for two seconds.

    Attributes
    ----------
    address : str or None
    """

    def __init__(self, only: str | None) -> None:
        self._only = only
        self._heard_ns = 0
        self.address = only

    def take(self, time_ns: int, address: str) -> bool:
        """Return whether a datagram is to be taken.

        Parameters
        ----------
        time_ns : int
        address : str
        """
        if self._only is not None:
            return address == self._only
        if address != self.address:
            if self.address is not None and time_ns - self._heard_ns < _SENDER_SILENT_NS:
                return False
            self.address = address
        self._heard_ns = time_ns
        return True


class RateWatch:
    """Counts what comes, and how often of late."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=256)
        self.count = 0

    def take(self, time_ns: int) -> None:
        """Count one.

        Parameters
        ----------
        time_ns : int
        """
        self._times.append(time_ns)
        self.count += 1

    @property
    def last_ns(self) -> int | None:
        """When the last one came."""
        return self._times[-1] if self._times else None

    def rate_hz(self, now_ns: int) -> float:
        """Return how many came a second, over the last second.

        Parameters
        ----------
        now_ns : int
        """
        recent = [time for time in self._times if now_ns - time <= _S_NS]
        if len(recent) < 2 or recent[-1] <= recent[0]:
            return float(len(recent))
        return (len(recent) - 1) * _S_NS / (recent[-1] - recent[0])
