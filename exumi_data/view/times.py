"""Timelines: an episode's own time, and the time of day where it is known."""

from dataclasses import dataclass

import numpy as np
import rerun as rr

from exumi_data.episode import Episode
from exumi_data.time import parse_utc
from exumi_data.view.names import TIME, UTC

__all__ = ["Timelines", "timelines_of"]

_LIMIT_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Timelines:
    """The two timelines of an episode.

    Attributes
    ----------
    start_ns : int or None
        The episode's start, ns since 1970; None where it is not known, or beyond 64 bits.
    """

    start_ns: int | None

    def columns(self, time: np.ndarray) -> list[rr.TimeColumn]:
        """Return the time columns of samples.

        Parameters
        ----------
        time : (N,) int64
            Nanoseconds since the episode's start.
        """
        columns = [rr.TimeColumn(TIME, duration=time.astype("timedelta64[ns]"))]
        if self.start_ns is not None and len(time):
            ends = (self.start_ns + int(time.min()), self.start_ns + int(time.max()))
            if all(-_LIMIT_NS < end < _LIMIT_NS for end in ends):
                absolute = (time + np.int64(self.start_ns)).astype("datetime64[ns]")
                columns.append(rr.TimeColumn(UTC, timestamp=absolute))
        return columns


def timelines_of(episode: Episode) -> Timelines:
    """Return an episode's timelines."""
    start = episode.metadata.start
    start_ns = None if start is None else parse_utc(start)
    return Timelines(None if start_ns is None or abs(start_ns) >= _LIMIT_NS else start_ns)
