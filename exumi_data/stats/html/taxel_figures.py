"""What taxels felt: the mean of each cell, and all cells together over time."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from exumi_data.episode import StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.model.streams import TaxelsStream
from exumi_data.stats.html.blocks import STEPS, step_of, valid_blocks

__all__ = ["MOST_CELLS", "TaxelFigures", "TaxelTotal", "grid_of", "read_taxels"]

MOST_CELLS = 4_096
"""Of a grid that is drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TaxelFigures:
    """The taxels of one stream: ``sign * (value - offset)``, which rises with the force.

    Attributes
    ----------
    stream, unit : str
    grid : (int, int)
        Rows and columns.
    alive : tuple of bool
        Row by row.
    sums : tuple of float
        Over the samples, by cell.
    peak : float
        The most that any cell felt.
    samples, totals : tuple
        Samples, and the sums of all their cells, in each of `STEPS` parts of the episode.
    left_out : int
        Samples that are flagged as not valid, or are no numbers.
    """

    stream: str
    unit: str
    grid: tuple[int, int]
    alive: tuple[bool, ...]
    sums: tuple[float, ...]
    peak: float
    samples: tuple[int, ...]
    totals: tuple[float, ...]
    left_out: int


def grid_of(stream: StreamView) -> tuple[int, int]:
    """Return the rows and columns of a stream of taxels.

    Parameters
    ----------
    stream : StreamView
        Of kind ``taxels``.
    """
    model = stream.metadata
    assert isinstance(model, TaxelsStream)  # noqa: S101  # by its kind
    return model.grid[0], model.grid[1]


def read_taxels(stream: StreamView, span: tuple[int, int]) -> TaxelFigures | None:
    """Read what the taxels of an episode felt; None where there are too many to draw.

    Parameters
    ----------
    stream : StreamView
        Of kind ``taxels``.
    span : (int, int)
        First and last time of the episode, ns.

    Raises
    ------
    DamagedDataError
        An array does not fit the grid.
    """
    model = stream.metadata
    assert isinstance(model, TaxelsStream)  # noqa: S101  # by its kind
    grid = grid_of(stream)
    if grid[0] * grid[1] > MOST_CELLS:
        return None
    mask = stream.valid
    alive = np.ones(grid, np.bool_) if mask is None else mask
    if alive.shape != grid:
        raise DamagedDataError(f"`valid` of {stream.name} is not {grid[0]}x{grid[1]}")
    sums, peak, left_out = np.zeros(grid), 0.0, 0
    samples, totals = np.zeros(STEPS, np.int64), np.zeros(STEPS)
    time = stream.time
    for taken, data, valid in valid_blocks(stream, alive.size * 8):
        if data.shape[1:] != grid:
            raise DamagedDataError(f"`data` of {stream.name} is not {grid[0]}x{grid[1]} a sample")
        kept = valid & np.isfinite(data[:, alive]).all(axis=1)
        felt = np.where(alive, model.sign * (data[kept] - model.offset), 0.0)
        step = step_of(time[taken][kept], span, STEPS)
        left_out += len(data) - len(felt)
        sums += felt.sum(axis=0)
        peak = max(peak, float(felt.max(initial=0.0)))
        samples += np.bincount(step, minlength=STEPS)
        totals += np.bincount(step, felt.sum(axis=(1, 2)), minlength=STEPS)
    return TaxelFigures(
        stream=stream.name,
        unit=model.unit,
        grid=grid,
        alive=tuple(alive.ravel().tolist()),
        sums=tuple(sums.ravel().tolist()),
        peak=peak,
        samples=tuple(samples.tolist()),
        totals=tuple(totals.tolist()),
        left_out=left_out,
    )


@dataclass(slots=True)
class TaxelTotal:
    """Taxels of the same name, unit and grid, over all episodes; see `TaxelFigures`.

    A cell is dead where it is dead in every episode.
    """

    unit: str
    grid: tuple[int, int]
    sums: npt.NDArray[np.float64] = field(init=False)
    alive: npt.NDArray[np.bool_] = field(init=False)
    counts: npt.NDArray[np.int64] = field(init=False)
    samples: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(STEPS, np.int64))
    totals: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(STEPS))
    peak: float = 0.0
    left_out: int = 0

    def __post_init__(self) -> None:
        """Begin with nothing."""
        self.sums, self.alive = np.zeros(self.grid), np.zeros(self.grid, np.bool_)
        self.counts = np.zeros(self.grid, np.int64)

    def add(self, one: TaxelFigures) -> None:
        """Add an episode."""
        alive = np.array(one.alive).reshape(self.grid)
        self.sums += np.array(one.sums).reshape(self.grid)
        self.counts += np.where(alive, sum(one.samples), 0)
        self.alive |= alive
        self.samples += np.array(one.samples)
        self.totals += np.array(one.totals)
        self.peak = max(self.peak, one.peak)
        self.left_out += one.left_out

    @property
    def means(self) -> npt.NDArray[np.float64]:
        """(R, C): the mean of each cell over its samples; 0 where there is none."""
        return np.asarray(self.sums / np.maximum(self.counts, 1))

    @property
    def over_time(self) -> list[float]:
        """All cells together, the mean in each part of an episode; NaN without samples."""
        with np.errstate(invalid="ignore"):
            return [float(value) for value in self.totals / self.samples]
