"""Adding up the figures of episodes: what is kept does not grow with their length."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from exumi_data.stats.html.figures import (
    STEPS,
    ClockFigures,
    EpisodeFigures,
    PoseFigures,
    TouchFigures,
)
from exumi_data.stats.html.sound_figures import SoundTotal
from exumi_data.stats.html.taxel_figures import TaxelTotal
from exumi_data.stats.model import Unreadable

__all__ = ["EpisodeRow", "PoseTotal", "Totals", "TouchTotal", "ValueTotal"]

_MOST_CELLS = 40_000
_MOST_COUNTED = 5_000
_MOST_GRIDS = 256  # a hundred kilobytes each
Cells = Counter[tuple[int, int]]


@dataclass(slots=True)
class TouchTotal:
    """Frames and active frames over the parts of an episode, (STEPS,) int64 each."""

    frames: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(STEPS, np.int64))
    active: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(STEPS, np.int64))

    def add(self, touch: TouchFigures) -> None:
        """Add a stream of an episode."""
        self.frames += np.array(touch.frames)
        self.active += np.array(touch.active)

    @property
    def share(self) -> float | None:
        """Share of active frames; None without frames."""
        frames = int(self.frames.sum())
        return int(self.active.sum()) / frames if frames else None


@dataclass(slots=True)
class ValueTotal:
    """All values of one component of a stream: see `ValueFigures`."""

    kind: str
    unit: str
    step: float
    counts: Counter[int] = field(default_factory=Counter)
    left_out: int = 0
    episodes: int = 0


@dataclass(slots=True)
class PoseTotal:
    """All poses of one stream: see `PoseFigures`. `cell_m` grows where there are many cells.

    The ends are exact, whatever the cells: empty until there is a valid sample.
    """

    parent: str
    child: str
    cell_m: float = 0.01
    from_above: Cells = field(default_factory=Counter)
    from_side: Cells = field(default_factory=Counter)
    tilts: Counter[int] = field(default_factory=Counter)
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    tilt_ends: tuple[float, ...] = ()
    left_out: int = 0
    episodes: int = 0

    def add(self, pose: PoseFigures) -> None:
        """Add an episode, whose cells are 1 cm wide."""
        self.episodes += 1
        self.left_out += pose.left_out
        self.tilts.update(pose.tilts)
        self.low = _each(min, self.low, pose.low)
        self.high = _each(max, self.high, pose.high)
        ends = (*self.tilt_ends, *pose.tilt_ends)
        self.tilt_ends = (min(ends), max(ends)) if ends else ()
        self._add_cells(pose)

    def _add_cells(self, pose: PoseFigures) -> None:
        factor = round(self.cell_m / 0.01)
        self.from_above.update(_coarser(pose.from_above, factor))
        self.from_side.update(_coarser(pose.from_side, factor))
        while max(len(self.from_above), len(self.from_side)) > _MOST_CELLS:
            self.from_above = _coarser(self.from_above, 2)
            self.from_side = _coarser(self.from_side, 2)
            self.cell_m *= 2


def _each(
    choose: Callable[[float, float], float], first: tuple[float, ...], second: tuple[float, ...]
) -> tuple[float, ...]:
    """Choose of each pair; of an empty tuple and another the other."""
    return tuple(map(choose, first, second)) if first and second else first or second


def _coarser(cells: dict[tuple[int, int], int], factor: int) -> Cells:
    found: Cells = Counter()
    for (a, b), count in cells.items():
        found[a // factor, b // factor] += count
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeRow:
    """What is kept of every single episode."""

    position: int
    id: str
    task: str
    object_id: str | None
    part_id: str | None
    duration_s: float
    peak: float
    touched: bool | None
    """Whether any frame is active; None where no activity is stored."""


@dataclass(slots=True)
class Totals:
    """All figures of a dataset, added up in the order of its episodes.

    Attributes
    ----------
    rows : list of EpisodeRow
    touch : dict
        By tactile stream.
    by_group : dict
        Activity by (what is grouped, such as ``task``, and its value).
    without_activity, without_reference : dict of str to int
        Tactile streams: episodes in which it is not stored.
    clocks : dict of str to list of ClockFigures
    values : dict
        By stream and component.
    poses : dict
        By stream.
    taxels : dict
        By (stream, unit, grid).
    large_taxels : dict of str to (int, int)
        Streams of taxels that are too large to be drawn, and the largest grid of each.
    sounds : dict
        By stream.
    sensors : dict of str to Counter
        By stream.
    kinds : dict of str to dict of str to int
        By kind: streams, each with its number of episodes.
    holding : Counter
        Episodes that have a stream of a kind.
    people, sites, devices, grippers, instructions : Counter
    numbers : dict of str to list of float
        Labels that are numbers, by property.
    unreadable : list of Unreadable
    """

    rows: list[EpisodeRow] = field(default_factory=list)
    touch: dict[str, TouchTotal] = field(default_factory=dict)
    by_group: dict[tuple[str, str], TouchTotal] = field(default_factory=dict)
    without_activity: Counter[str] = field(default_factory=Counter)
    without_reference: Counter[str] = field(default_factory=Counter)
    clocks: dict[str, list[ClockFigures]] = field(default_factory=dict)
    values: dict[tuple[str, str], ValueTotal] = field(default_factory=dict)
    poses: dict[str, PoseTotal] = field(default_factory=dict)
    taxels: dict[tuple[str, str, tuple[int, int]], TaxelTotal] = field(default_factory=dict)
    large_taxels: dict[str, tuple[int, int]] = field(default_factory=dict)
    sounds: dict[str, SoundTotal] = field(default_factory=dict)
    sensors: dict[str, Counter[str]] = field(default_factory=dict)
    kinds: dict[str, Counter[str]] = field(default_factory=dict)
    holding: Counter[str] = field(default_factory=Counter)
    people: Counter[str] = field(default_factory=Counter)
    sites: Counter[str] = field(default_factory=Counter)
    devices: Counter[str] = field(default_factory=Counter)
    grippers: Counter[str] = field(default_factory=Counter)
    instructions: Counter[str] = field(default_factory=Counter)
    numbers: dict[str, list[float]] = field(default_factory=dict)
    unreadable: list[Unreadable] = field(default_factory=list)

    def add(self, position: int, one: EpisodeFigures) -> None:
        """Add an episode.

        Parameters
        ----------
        position : int
            Where it stands in the dataset.
        one : EpisodeFigures
        """
        measured = [touch for touch in one.touches if touch.measured]
        touched = any(any(touch.active) for touch in measured) if measured else None
        self.rows.append(
            EpisodeRow(
                position=position,
                id=one.id,
                task=one.task,
                object_id=one.object_id,
                part_id=one.part_id,
                duration_s=one.duration_s,
                peak=max((touch.peak for touch in measured), default=0.0),
                touched=touched,
            )
        )
        self._add_touches(one)
        for clock in one.clocks:
            self.clocks.setdefault(clock.stream, []).append(clock)
        self._add_motion(one)
        for name, model in one.sensors.items():
            self.sensors.setdefault(name, Counter())[model] += 1
        for name, kind in one.kinds.items():
            self.kinds.setdefault(kind, Counter())[name] += 1
        self.holding.update(set(one.kinds.values()))
        for counter, value in (
            (self.people, one.operator),
            (self.sites, one.site),
            (self.devices, one.device),
            (self.grippers, one.embodiment),
            (self.instructions, one.instruction),
        ):
            # Each may be unique: what is beyond is not listed anyway.
            if value and (value in counter or len(counter) < _MOST_COUNTED):
                counter[value] += 1
        for name, number in one.numbers:
            self.numbers.setdefault(name, []).append(number)

    def _add_touches(self, one: EpisodeFigures) -> None:
        groups = (("task", one.task), ("object", one.object_id), ("part", one.part_id))
        for touch in one.touches:
            self.without_reference[touch.stream] += not touch.has_reference
            if not touch.measured:
                self.without_activity[touch.stream] += 1
                continue
            self.touch.setdefault(touch.stream, TouchTotal()).add(touch)
            for what, value in groups:
                if value is not None:
                    self.by_group.setdefault((what, value), TouchTotal()).add(touch)

    def _add_motion(self, one: EpisodeFigures) -> None:
        for value in one.values:
            new = ValueTotal(value.kind, value.unit, value.step)
            total = self.values.setdefault((value.stream, value.component), new)
            total.counts.update(value.counts)
            total.left_out += value.left_out
            total.episodes += 1
        for pose in one.poses:
            total_pose = self.poses.setdefault(pose.stream, PoseTotal(pose.parent, pose.child))
            total_pose.add(pose)
        for name, grid in one.large_taxels:
            if name in self.large_taxels or len(self.large_taxels) < _MOST_GRIDS:
                self.large_taxels[name] = max(grid, self.large_taxels.get(name, grid))
        for felt in one.taxels:
            key = (felt.stream, felt.unit, felt.grid)
            if key not in self.taxels and len(self.taxels) == _MOST_GRIDS:
                continue  # of which only a few are drawn
            self.taxels.setdefault(key, TaxelTotal(felt.unit, felt.grid)).add(felt)
        for heard in one.sounds:
            self.sounds.setdefault(heard.stream, SoundTotal()).add(heard)
