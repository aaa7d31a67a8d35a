"""What a hand cannot do with a pose: go too fast, jump, stand still to the bit."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Literal

import numpy as np

from exumi_validators.series import BoolArray, Float64Array, Series

__all__ = [
    "Break",
    "Change",
    "Reach",
    "Steps",
    "Still",
    "StillLimits",
    "find_breaks",
    "find_still",
]

_NS = 1e-9

# Steps that are broken within so few samples are one event, such as a sample out and back.
_NEAR = 2


@dataclass(frozen=True, slots=True)
class Reach:
    """How far a hand can come within a step; metres or radians.

    Attributes
    ----------
    speed : float
        Per second.
    step : float
        What any step may differ from its neighbours.
    acceleration : float
        Per second squared: what a step may differ from its neighbours, by its time squared.
    """

    speed: float
    step: float
    acceleration: float

    def allowance(self, step_s: Float64Array) -> Float64Array:
        """Return by how much steps may differ from their neighbours.

        Parameters
        ----------
        step_s : float64, any shape
            How long the steps take, seconds.
        """
        return np.maximum(self.step, self.acceleration * step_s * step_s)


@dataclass(frozen=True, slots=True)
class Break:
    """A place where a track is broken.

    Attributes
    ----------
    kind : {"fast", "away", "jump"}
        Faster than a hand; a few samples out and back; moved, and gone on from there.
    index : int
        First sample that the hand could not reach, in the series.
    moved, turned : float
        What it moved: metres and radians; per second for ``fast``.
    """

    kind: Literal["fast", "away", "jump"]
    index: int
    moved: float
    turned: float


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps of a track of poses.

    Attributes
    ----------
    moved, turned : (N - 1,) float64
        Metres and radians; whatever comes out of values that are not finite.
    step_s : (N - 1,) float64
        How long each step takes, seconds.
    joined : (N - 1,) bool
        Steps that can be judged.
    """

    moved: Float64Array
    turned: Float64Array
    step_s: Float64Array
    joined: BoolArray

    @classmethod
    def of(cls, poses: Float64Array, step_s: Float64Array, joined: BoolArray) -> "Steps":
        """Return the steps of (N, 7) poses.

        Parameters
        ----------
        poses : (N, 7) float64
        step_s : (N - 1,) float64
        joined : (N - 1,) bool
        """
        with np.errstate(all="ignore"):
            way = poses[1:, :3] - poses[:-1, :3]
            moved = np.sqrt(np.einsum("ij,ij->i", way, way))
            return cls(moved, _angle(poses[1:, 3:], poses[:-1, 3:]), step_s, joined)


def _angle(a: Float64Array, b: Float64Array) -> Float64Array:
    """Return the angle between rotations; also where norms are off, which other rules say."""
    product = np.einsum("ij,ij->i", a, a) * np.einsum("ij,ij->i", b, b)
    cosine = np.abs(np.einsum("ij,ij->i", a, b)) / np.sqrt(np.where(product > 0, product, 1.0))
    return np.asarray(2.0 * np.arccos(np.minimum(cosine, 1.0)), np.float64)


def find_breaks(
    poses: Float64Array, steps: Steps, linear: Reach, angular: Reach, *, most: int
) -> list[Break]:
    """Find where a track goes too fast, or is broken.

    A step is out of line when it is longer than its neighbours' speed explains, by more than a
    hand can accelerate. A break begins with a step that is out of line with the steps before,
    and ends with one that is out of line with the steps after: a blow, which only stops, is none.

    Parameters
    ----------
    poses : (N, 7) float64
    steps : Steps
    linear, angular : Reach
        In metres and in radians.
    most : int
        How many places to look at: a file may be nothing but broken.

    Returns
    -------
    list of Break
    """
    suspect = steps.joined & (
        (steps.moved > np.minimum(linear.step, linear.speed * steps.step_s))
        | (steps.turned > np.minimum(angular.step, angular.speed * steps.step_s))
    )
    if not suspect.any():
        return []
    sides = _Component.of(steps.moved, steps, linear), _Component.of(steps.turned, steps, angular)
    broken = np.logical_or(sides[0].broken, sides[1].broken)
    clusters = islice(_clusters(broken), most)
    found = (_classify(poses, sides, first, last) for first, last in clusters)
    return [item for item in found if item is not None]


@dataclass(frozen=True, slots=True)
class _Component:
    """Steps of the position or of the rotation."""

    length: Float64Array
    speed: Float64Array
    rises: BoolArray
    falls: BoolArray
    fast: BoolArray

    @classmethod
    def of(cls, length: Float64Array, steps: Steps, reach: Reach) -> "_Component":
        speed = np.where(steps.joined, length / steps.step_s, -np.inf)
        allowed = reach.allowance(steps.step_s)
        before, after = _highest_before(speed), _highest_before(speed[::-1])[::-1]
        with np.errstate(invalid="ignore"):  # unknown neighbours are infinitely fast
            rises = length - before * steps.step_s > allowed
            falls = length - after * steps.step_s > allowed
        return cls(length, speed, rises & steps.joined, falls & steps.joined, speed > reach.speed)

    @property
    def broken(self) -> BoolArray:
        return self.rises | self.falls | self.fast


def _highest_before(speed: Float64Array) -> Float64Array:
    """Return the higher speed of the two steps before; infinite where none is known."""
    padded = np.concatenate((np.full(_NEAR, -np.inf), speed))
    highest = np.maximum(padded[:-_NEAR], padded[1 : 1 - _NEAR])
    return np.where(highest == -np.inf, np.inf, highest)


def _clusters(broken: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield first and last of steps that lie beside each other."""
    at = np.flatnonzero(broken)
    if len(at):
        cuts = np.flatnonzero(np.diff(at) > _NEAR)
        firsts = at[np.concatenate(([0], cuts + 1))]
        lasts = at[np.concatenate((cuts, [len(at) - 1]))]
        yield from zip(firsts.tolist(), lasts.tolist(), strict=True)


def _classify(
    poses: Float64Array, sides: tuple[_Component, _Component], first: int, last: int
) -> Break | None:
    inside = slice(first, last + 1)
    away = [0.0, 0.0]
    if last - first <= _NEAR:
        net = Steps.of(poses[[first, last + 1]], np.ones(1), np.ones(1, dtype=bool))
        whole = float(net.moved[0]), float(net.turned[0])
        for axis, side in enumerate(sides):
            if side.rises[first] and side.falls[last]:
                away[axis] = float(side.length[inside].max())
        if any(gone and end >= gone / 2 for gone, end in zip(away, whole, strict=True)):
            return Break("jump", first + 1, *whole)
    if any(side.fast[inside].any() for side in sides):
        speeds = [float(side.speed[inside].max()) for side in sides]
        return Break("fast", first + 1, *speeds)
    return Break("away", first + 1, *away) if any(away) else None


@dataclass(frozen=True, slots=True)
class Change:
    """A step at which a pose changes: a stretch without change lies between two of them.

    Attributes
    ----------
    index : int
        Of the sample that the step leads to, in the stream.
    time : int
        Of that sample, nanoseconds.
    abrupt : bool
        The step is longer than what a hand can stop from at once.
    """

    index: int
    time: int
    abrupt: bool = False


@dataclass(frozen=True, slots=True)
class Still:
    """A stretch of poses that are the same, bit by bit.

    Attributes
    ----------
    index, end : int
        Its first sample in the stream, and the first one after it.
    seconds : float
        From its first sample to its last.
    halted : bool
        It begins out of a motion that no hand stops at once.
    leapt : bool
        It ends with a step that the steps after it do not explain.
    """

    index: int
    end: int
    seconds: float
    halted: bool
    leapt: bool


@dataclass(frozen=True, slots=True)
class StillLimits:
    """When a stretch without change is found: how long, of how many samples, and how it ends."""

    seconds: float
    samples: int
    linear: Reach
    angular: Reach


def find_still(
    series: Series, steps: Steps, since: Change, limits: StillLimits
) -> tuple[list[Still], Change]:
    """Find stretches without change that end within a block.

    Parameters
    ----------
    series : Series
        Its first array holds poses.
    steps : Steps
        Of the whole block.
    since : Change
        The last change before this block, or the first sample of all.
    limits : StillLimits

    Returns
    -------
    found : list of Still
    since : Change
        The last change so far: the stretch after it has not ended yet.
    """
    poses = series.values[0]
    own = np.arange(series.own.start, series.own.stop)
    same = series.joined[own] & (poses[own + 1] == poses[own]).all(axis=1)
    changes = own[~same]
    if not len(changes):
        return [], since
    at = series.start + changes + 1
    time = series.time[changes + 1]
    begins = np.concatenate(([since.index], at[:-1]))
    lasted = (series.time[changes] - np.concatenate(([since.time], time[:-1]))) * _NS
    long = np.flatnonzero((at - begins >= limits.samples) & (lasted >= limits.seconds))
    sides = (steps.moved, limits.linear), (steps.turned, limits.angular)

    def abrupt(step: int) -> bool:
        lengths = ((length[step], reach.allowance(steps.step_s[step])) for length, reach in sides)
        return bool(steps.joined[step]) and any(long > most for long, most in lengths)

    leaps = np.zeros(len(steps.moved), dtype=bool)
    if len(long):
        leaps = np.logical_or(
            *(_Component.of(length, steps, reach).falls for length, reach in sides)
        )
    found = [
        Still(
            index=int(begins[run]),
            end=int(at[run]),
            seconds=float(lasted[run]),
            halted=abrupt(int(changes[run - 1])) if run else since.abrupt,
            leapt=bool(leaps[changes[run]]),
        )
        for run in long.tolist()
    ]
    return found, Change(int(at[-1]), int(time[-1]), abrupt(int(changes[-1])))
