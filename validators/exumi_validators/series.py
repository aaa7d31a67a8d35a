"""Samples of a stream in the order of time, and which of them are neighbours."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_validators.context import EpisodeContext
from exumi_validators.sample_flags import flagged
from exumi_validators.windows import windows

__all__ = ["MARGIN", "BoolArray", "Float64Array", "Series", "read_series", "typical_step_s"]

BoolArray = npt.NDArray[np.bool_]
Float64Array = npt.NDArray[np.float64]

MARGIN = 8
"""How many samples before and after a step can be asked for."""
_NS = 1e-9
# Longer steps are pauses.
_USUAL = 0.95


@dataclass(frozen=True, slots=True)
class Series:
    """A block of samples with some of its surroundings; step i leads from sample i to i + 1.

    Attributes
    ----------
    start : int
        Index of the first sample in the stream.
    time : ndarray of int64, shape (N,)
        Nanoseconds.
    values : tuple of ndarray
        One (N, ...) array for each that was asked for.
    usable : ndarray of bool, shape (N,)
        False where the device called the sample invalid, or out of range.
    joined : ndarray of bool, shape (N - 1,)
        Steps between usable samples with nothing known to be missing between them.
    own : slice
        The steps that belong to this block: every step belongs to one block.
    """

    start: int
    time: npt.NDArray[np.int64]
    values: tuple[np.ndarray, ...]
    usable: BoolArray
    joined: BoolArray
    own: slice

    @property
    def own_samples(self) -> slice:
        """The samples that belong to this block: those its own steps lead to, and the very first.

        Every sample belongs to one block.
        """
        return slice(self.own.start + (self.start > 0), self.own.stop + 1)

    def step_s(self, least_s: float) -> Float64Array:
        """Return how long each step takes.

        Samples that arrive in bursts bear stamps that lie closer than the samples were taken,
        which would make any motion infinitely fast. So no step is shorter than the usual one.

        Parameters
        ----------
        least_s : float
            The usual step, seconds: `typical_step_s`.

        Returns
        -------
        (N - 1,) float64
            Seconds.
        """
        return np.maximum(np.diff(self.time) * _NS, least_s)


def typical_step_s(series: Series) -> float:
    """Return how far apart samples usually are, seconds; 0 when there are no neighbours.

    The median, or the mean without the longest steps, whichever is more: where most samples
    come in bursts, the median is the time between two stamps of a burst.

    Parameters
    ----------
    series : Series
    """
    steps = np.sort(np.diff(series.time)[series.joined])
    if not len(steps):
        return 0.0
    usual = steps[: math.ceil(_USUAL * len(steps))]
    return max(0.0, float(steps[len(steps) // 2]), float(usual.mean())) * _NS


def read_series(episode: EpisodeContext, name: str, *arrays: str) -> Iterator[Series]:
    """Read a stream window by window, each with the samples beside it.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the stream.
    *arrays : str
        Arrays with a row for each sample, such as ``data``.

    Yields
    ------
    Series
    """
    known = [f"streams/{name}/{array}" for array in ("time", *arrays)]
    flag_path = f"streams/{name}/flags"
    reader, count = episode.reader(flag_path), episode.count(name)
    if reader is not None and reader.shape[0] == count:
        known.append(flag_path)
    gaps = np.array([gap.after for gap in episode.streams[name].gaps or []], dtype=np.int64)
    held: tuple[int, list[np.ndarray], int] | None = None
    for start, rows in windows(episode, *known):
        if held is None:
            held = start, list(rows), 0
            continue
        yield _series(held, gaps, len(arrays), last=False)
        _, parts, begin = held
        kept = min(2 * MARGIN, len(parts[0]))
        joined = [np.concatenate((a[-kept:], b)) for a, b in zip(parts, rows, strict=True)]
        held = start - kept, joined, _end(parts[0], begin) - (len(parts[0]) - kept)
    if held is not None:
        yield _series(held, gaps, len(arrays), last=True)


def _series(
    held: tuple[int, list[np.ndarray], int], gaps: np.ndarray, wanted: int, *, last: bool
) -> Series:
    start, (time, *rest), begin = held
    values = tuple(rest[:wanted])
    usable = np.ones(len(time), dtype=bool)
    joined = np.ones(max(0, len(time) - 1), dtype=bool)
    if len(rest) > wanted:
        bits = rest[wanted]
        usable = ~flagged(bits, "invalid", "out_of_range")
        joined &= ~flagged(bits[1:], "gap_before")
    for rows in values:
        if rows.dtype.kind == "f":
            usable &= np.isfinite(rows.reshape(len(rows), -1)).all(axis=1)
    joined &= usable[1:] & usable[:-1]
    if len(gaps):
        inside = gaps - start
        joined[inside[(inside >= 0) & (inside < len(joined))]] = False
    end = len(joined) if last else _end(time, begin)
    return Series(start, time, values, usable, joined, slice(begin, end))


def _end(time: np.ndarray, begin: int) -> int:
    """Return the end of the steps that are a block's own, when another block follows."""
    return max(begin, len(time) - MARGIN)
