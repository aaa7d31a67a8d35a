"""Runs of frames that are all the same."""

__all__ = ["FrozenFrames"]


class FrozenFrames:
    """Finds runs of equal frames that last too long.

    A sensor's noise makes every frame another one: equal frames were repeated.

    Parameters
    ----------
    longer_than_s : float
        A run that lasts longer is frozen, seconds,
    frames : float
        if it has as many frames.
    """

    def __init__(self, *, longer_than_s: float, frames: float) -> None:
        self._longer_than_s, self._frames = longer_than_s, frames
        self._value: int | None = None
        self._first = 0
        self._count = 0
        self._start_ns = 0
        self._last_ns = 0

    def add(self, index: int, time_ns: int, value: int) -> tuple[int, int, float] | None:
        """Take the next frame; return the run that it ends, if that was a frozen one.

        Parameters
        ----------
        index : int
        time_ns : int
        value : int
            A checksum of the frame.

        Returns
        -------
        tuple or None
            First frame, number of frames, duration in seconds.
        """
        if value == self._value:
            self._count += 1
            self._last_ns = time_ns
            return None
        ended = self.end()
        self._value, self._first, self._count = value, index, 1
        self._start_ns = self._last_ns = time_ns
        return ended

    def end(self) -> tuple[int, int, float] | None:
        """Return the run that is under way, if it is a frozen one."""
        duration_s = (self._last_ns - self._start_ns) * 1e-9
        if self._count < self._frames or duration_s <= self._longer_than_s:
            return None
        return self._first, self._count, duration_s
