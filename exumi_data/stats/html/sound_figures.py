"""How loud it was: sound's mean square over the parts of an episode."""

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from exumi_data.episode import StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.model.streams import AudioStream
from exumi_data.stats.html.blocks import STEPS, step_of

__all__ = ["FLOOR_DB", "SoundFigures", "SoundTotal", "read_sound"]

FLOOR_DB = -96.0
"""Of 16 bits: silence is drawn here."""

_FULL_SCALE = 32_768.0
_CHUNK = 1 << 19  # values of all channels


@dataclass(frozen=True, slots=True, kw_only=True)
class SoundFigures:
    """The sound of one stream of an episode; full scale is 1.

    Attributes
    ----------
    stream : str
    values : tuple of int
        Samples of all channels, in each of `STEPS` parts of the episode.
    squares : tuple of float
        The sums of their squares.
    clipped : int
        Samples at the ends of 16 bits.
    """

    stream: str
    values: tuple[int, ...]
    squares: tuple[float, ...]
    clipped: int


def read_sound(stream: StreamView, span: tuple[int, int]) -> SoundFigures:
    """Read how loud an episode's sound is.

    Parameters
    ----------
    stream : StreamView
        Of kind ``audio``.
    span : (int, int)
        First and last time of the episode, ns.

    Raises
    ------
    DamagedDataError
        The blocks do not follow each other, or do not fit the sound.
    """
    model = stream.metadata
    assert isinstance(model, AudioStream)  # noqa: S101  # by its kind
    values, squares, clipped = np.zeros(STEPS, np.int64), np.zeros(STEPS), 0
    offset = stream.array("offset").astype(np.int64)
    if len(offset) != len(stream) + 1 or (offset[1:] < offset[:-1]).any() or offset[0] < 0:
        raise DamagedDataError(f"`offset` of {stream.name} does not say where its blocks are")
    step = step_of(stream.time, span, STEPS)
    rows = max(1, _CHUNK // model.channels)
    for begin in range(int(offset[0]), int(offset[-1]), rows):
        end = min(begin + rows, int(offset[-1]))
        sound = stream.samples(begin, end)
        clipped += int(((sound == 32_767) | (sound == -32_768)).sum())
        each = np.square(sound / _FULL_SCALE).sum(axis=1)
        until = np.concatenate(([0.0], np.cumsum(each)))
        edges = np.clip(offset, begin, end) - begin
        squares += np.bincount(step, np.diff(until[edges]), minlength=STEPS)
        values += np.bincount(step, np.diff(edges), minlength=STEPS).astype(np.int64)
    return SoundFigures(
        stream=stream.name,
        values=tuple((values * model.channels).tolist()),
        squares=tuple(squares.tolist()),
        clipped=clipped,
    )


@dataclass(slots=True)
class SoundTotal:
    """Sound of the same name over all episodes; see `SoundFigures`."""

    values: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(STEPS, np.int64))
    squares: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(STEPS))
    clipped: int = 0

    def add(self, one: SoundFigures) -> None:
        """Add an episode."""
        self.values += np.array(one.values)
        self.squares += np.array(one.squares)
        self.clipped += one.clipped

    @property
    def over_time(self) -> list[float]:
        """The level in each part of an episode, dB of full scale; NaN without sound."""
        pairs = zip(self.squares.tolist(), self.values.tolist(), strict=True)
        return [_level(square / count) if count else math.nan for square, count in pairs]

    @property
    def level_db(self) -> float:
        """The level of everything, dB of full scale; NaN without sound."""
        count = int(self.values.sum())
        return _level(float(self.squares.sum()) / count) if count else math.nan


def _level(mean_square: float) -> float:
    return max(FLOOR_DB, 10 * math.log10(max(mean_square, 1e-30)))
