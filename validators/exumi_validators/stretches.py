"""Reading a stream's times stretch by stretch, so that hours at 1 kHz need little memory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.model.streams import StreamModel
from exumi_validators.checks.time import flags_fit
from exumi_validators.context import EpisodeContext
from exumi_validators.sample_flags import flagged
from exumi_validators.windows import carried_samples, windows

__all__ = ["DeclaredGaps", "Stretch", "stretches"]

_FAR = 1 << 62

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Consecutive samples of a stream.

    Attributes
    ----------
    first : int
        Index of the first sample.
    carried : int
        Samples that the stretch before had too.
    time : (N,) int64
    flags : (N,) uint32
        Zero where the stream has none.
    others : tuple of (N,) ndarray
        What else was asked for.
    """

    first: int
    carried: int
    time: npt.NDArray[np.int64]
    flags: npt.NDArray[np.uint32]
    others: tuple[np.ndarray, ...]

    def flagged(self, *names: str) -> Mask:
        """Find the samples that have one of some flags.

        Parameters
        ----------
        *names : str

        Returns
        -------
        (N,) bool
        """
        return flagged(self.flags, *names)

    def fresh_only(self, intervals: Mask) -> npt.NDArray[np.int64]:
        """Return the intervals of a mask that the stretch before did not have, (K,) int64.

        Parameters
        ----------
        intervals : (N-1,) bool
        """
        found = np.flatnonzero(intervals)
        return found[found >= self.carried - 1]


def stretches(episode: EpisodeContext, name: str, *others: str) -> Iterator[Stretch]:
    """Read the times of a stream, and arrays beside them, window by window.

    Every stretch but the first begins with the last samples of the one before, so that none is
    too short to be judged, and nothing between two is missed.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the stream.
    *others : str
        Further arrays of the stream.

    Yields
    ------
    Stretch
    """
    has_flags = flags_fit(episode, name)
    arrays = ("time", *(("flags",) if has_flags else ()), *others)
    most = carried_samples(episode)
    kept: tuple[np.ndarray, ...] = ()
    for start, block in windows(episode, *(f"streams/{name}/{array}" for array in arrays)):
        rows = (
            tuple(np.concatenate(both) for both in zip(kept, block, strict=True)) if kept else block
        )
        carried = len(kept[0]) if kept else 0
        time = rows[0]
        yield Stretch(
            first=start - carried,
            carried=carried,
            time=time,
            flags=rows[1] if has_flags else np.zeros(len(time), dtype=np.uint32),
            others=rows[1 + has_flags :],
        )
        kept = tuple(column[-most:] for column in rows)


class DeclaredGaps:
    """Where a stream says that samples are missing: its list of gaps, and its flags.

    Parameters
    ----------
    stream : StreamModel
    """

    def __init__(self, stream: StreamModel) -> None:
        gaps = stream.gaps or []
        self.after = np.array([min(gap.after, _FAR) for gap in gaps], dtype=np.int64)
        self.lost = np.array([min(gap.lost or 0, _FAR) for gap in gaps], dtype=np.int64)

    def intervals(self, stretch: Stretch) -> Mask:
        """Find the intervals of a stretch in which samples are said to be missing.

        Parameters
        ----------
        stretch : Stretch

        Returns
        -------
        (N-1,) bool
        """
        declared = stretch.flagged("gap_before")[1:]
        declared[self.after[self.inside(stretch)] - stretch.first] = True
        return declared

    def inside(self, stretch: Stretch) -> npt.NDArray[np.int64]:
        """Return the places in the list of those gaps that lie inside a stretch, (K,) int64.

        Parameters
        ----------
        stretch : Stretch
        """
        last = stretch.first + len(stretch.time) - 1
        return np.flatnonzero((self.after >= stretch.first) & (self.after < last))
