"""The poses of a session, read in parts: a session may be hours long."""

import numpy as np

from exumi_data.episode import Episode, StreamView
from exumi_data.standard import flags
from exumi_data.store.shards import open_array
from exumi_data.synchronisation.sweep import PoseTrack

__all__ = ["PoseReader"]


class PoseReader:
    """Reads parts of a pose stream.

    Parameters
    ----------
    episode : Episode
    stream : StreamView
        Of kind ``pose``.
    """

    def __init__(self, episode: Episode, stream: StreamView) -> None:
        self._store = episode.store
        self._stream = stream
        self._has_flags = "flags" in stream.metadata.arrays

    def rows(self, name: str, first: int, last: int) -> np.ndarray:
        """Return rows ``first`` to before ``last`` of one of the stream's arrays.

        Parameters
        ----------
        name : str
        first, last : int
        """
        return open_array(self._store, f"streams/{self._stream.name}/{name}").rows(first, last)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Time of the first and of the last pose; (0, 0) where there is none."""
        time = self._stream.time
        return (int(time[0]), int(time[-1])) if len(time) else (0, 0)

    def between(self, start_ns: int, stop_ns: int) -> PoseTrack:
        """Return the valid poses with ``start_ns <= time_ns < stop_ns``.

        Parameters
        ----------
        start_ns, stop_ns : int
            In the session's time.
        """
        time = self._stream.time
        first, last = np.searchsorted(time, [start_ns, stop_ns]).tolist()
        poses = np.asarray(self.rows("data", first, last), np.float64)
        good = np.isfinite(poses).all(axis=1)
        good &= np.linalg.norm(poses[:, 3:], axis=1) > 0.5
        if self._has_flags:
            good &= (self.rows("flags", first, last) & flags()["invalid"].mask) == 0
        return PoseTrack(np.asarray(time[first:last], np.int64)[good], poses[good])
