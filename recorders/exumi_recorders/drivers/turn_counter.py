"""An encoder that goes round more than once: which turn it is on, counted from a place of rest.

Counts of one turn say nothing of others. So turns are counted from a place that is known, *home*,
such as the closed gripper: there the encoder has to rest for a moment. They are lost, until it
rests there again, where it could have gone half a turn without being seen.
"""

__all__ = ["TurnCounter"]

_NEAR_SHARE = 1 / 48
_REST_NS = 500_000_000
# A gripper is moved by hand: not half a turn in this time, nor a quarter in that of a sample.
_MOST_GAP_NS = 50_000_000
_MOST_STEP_SHARE = 1 / 4


class TurnCounter:
    """Makes counts that wrap into counts that go on.

    Parameters
    ----------
    home : int
        What the encoder says at home.
    modulus : int
        Where it wraps.

    Attributes
    ----------
    is_known : bool
        Whether it was at home, and could be followed since.
    """

    def __init__(self, home: int, modulus: int) -> None:
        self.is_known = False
        self._home = home
        self._modulus = modulus
        self._near = modulus * _NEAR_SHARE
        self._most_step = modulus * _MOST_STEP_SHARE
        self._last = home
        self._last_ns: int | None = None
        self._rests_since_ns: int | None = None

    def lose(self) -> None:
        """Forget the turn: the encoder was not seen."""
        self.is_known = False
        self._rests_since_ns = None
        self._last_ns = None

    def take(self, count: int, time_ns: int) -> int:
        """Return a reading with its turns.

        Parameters
        ----------
        count : int
            As the encoder says, 0 to modulus less 1.
        time_ns : int

        Returns
        -------
        int
            Equal to `count` modulo the modulus. The number nearest to home while `is_known` is
            false.
        """
        step = self._nearest(count - self._last)
        gap_ns = 0 if self._last_ns is None else time_ns - self._last_ns
        self._last_ns = time_ns
        if self.is_known and (gap_ns > _MOST_GAP_NS or abs(step) > self._most_step):
            self.is_known = False
            self._rests_since_ns = None
        if not self.is_known:
            step = self._nearest(count - self._home)
            self._last = self._home
            self._look_for_home(step, time_ns)
        self._last += step
        return self._last

    def _look_for_home(self, away: int, time_ns: int) -> None:
        if abs(away) > self._near:
            self._rests_since_ns = None
        elif self._rests_since_ns is None:
            self._rests_since_ns = time_ns
        elif time_ns - self._rests_since_ns >= _REST_NS:
            self.is_known = True

    def _nearest(self, difference: int) -> int:
        half = self._modulus // 2
        return (difference + half) % self._modulus - half
