"""What a hand cannot do with a pose: go too fast, jump, stand still to the bit."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from exumi_validators.series import BoolArray, Float64Array, Series

__all__ = [
    "Break",
    "Change",
    "Reach",
    "Still",
    "StillLimits",
    "find_breaks",
    "find_still",
    "pose_steps",
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

    def allowance(self, seconds: Float64Array) -> Float64Array:
        """Return by how much steps may differ from their neighbours.

        Parameters
        ----------
        seconds : (M,) float64
            How long the steps take.
        """
        return np.maximum(self.step, self.acceleration * seconds**2)


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


def pose_steps(poses: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return how far each pose is from the one before.

    Parameters
    ----------
    poses : (N, 7) float64

    Returns
    -------
    moved, turned : (N - 1,) float64
        Metres and radians; whatever comes out of values that are not finite.
    """
    with np.errstate(all="ignore"):
        moved = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
        turned = _angle(poses[1:, 3:], poses[:-1, 3:])
    return moved, turned


def _angle(a: Float64Array, b: Float64Array) -> Float64Array:
    """Return the angle between rotations; also where norms are off, which other rules say."""
    scale = np.sqrt((a * a).sum(axis=-1) * (b * b).sum(axis=-1))
    cosine = np.abs((a * b).sum(axis=-1)) / np.where(scale > 0, scale, 1.0)
    return np.asarray(2.0 * np.arccos(np.minimum(cosine, 1.0)), np.float64)


def find_breaks(
    poses: Float64Array,
    step_s: Float64Array,
    joined: BoolArray,
    linear: Reach,
    angular: Reach,
) -> list[Break]:
    """Find where a track goes too fast, or is broken.

    A step is out of line when it is longer than its neighbours' speed explains, by more than a
    hand can accelerate. A break begins with a step that is out of line with the steps before,
    and ends with one that is out of line with the steps after: a blow, which only stops, is none.

    Parameters
    ----------
    poses : (N, 7) float64
    step_s : (N - 1,) float64
        How long each step takes, seconds.
    joined : (N - 1,) bool
        Steps that can be judged.
    linear, angular : Reach
        In metres and in radians.

    Returns
    -------
    list of Break
    """
    moved, turned = pose_steps(poses)
    suspect = joined & (
        (moved > np.minimum(linear.step, linear.speed * step_s))
        | (turned > np.minimum(angular.step, angular.speed * step_s))
    )
    if not suspect.any():
        return []
    sides = [
        _Component.of(moved, step_s, joined, linear),
        _Component.of(turned, step_s, joined, angular),
    ]
    broken = np.logical_or(sides[0].broken, sides[1].broken)
    found = (_classify(poses, sides, first, last) for first, last in _clusters(broken))
    return [item for item in found if item is not None]


@dataclass(frozen=True, slots=True)
class _Component:
    """Steps of the position or of the rotation."""

    step: Float64Array
    speed: Float64Array
    rises: BoolArray
    falls: BoolArray
    fast: BoolArray

    @classmethod
    def of(
        cls, step: Float64Array, step_s: Float64Array, joined: BoolArray, reach: Reach
    ) -> "_Component":
        speed = np.where(joined, step / step_s, -np.inf)
        allowed = reach.allowance(step_s)
        rises = joined & (step - _highest_before(speed) * step_s > allowed)
        falls = joined & (step - _highest_before(speed[::-1])[::-1] * step_s > allowed)
        return cls(step, speed, rises, falls, speed > reach.speed)

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


def _classify(poses: Float64Array, sides: list[_Component], first: int, last: int) -> Break | None:
    inside = slice(first, last + 1)
    away = [0.0, 0.0]
    if last - first <= _NEAR:
        whole = [float(step[0]) for step in pose_steps(poses[[first, last + 1]])]
        for axis, side in enumerate(sides):
            if side.rises[first] and side.falls[last]:
                away[axis] = float(side.step[inside].max())
        if any(gone and net >= gone / 2 for gone, net in zip(away, whole, strict=True)):
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
    series: Series, step_s: Float64Array, since: Change, limits: StillLimits
) -> tuple[list[Still], Change]:
    """Find stretches without change that end within a block.

    Parameters
    ----------
    series : Series
        Its first array holds poses.
    step_s : (N - 1,) float64
        How long each step takes, seconds.
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
    moved, turned = pose_steps(poses)
    abrupt = series.joined & (
        (moved > limits.linear.allowance(step_s)) | (turned > limits.angular.allowance(step_s))
    )
    leaps = np.zeros(len(moved), dtype=bool)
    if len(long):
        for steps, reach in ((moved, limits.linear), (turned, limits.angular)):
            leaps |= _Component.of(steps, step_s, series.joined, reach).falls
    found = [
        Still(
            index=int(begins[run]),
            end=int(at[run]),
            seconds=float(lasted[run]),
            halted=bool(abrupt[changes[run - 1]]) if run else since.abrupt,
            leapt=bool(leaps[changes[run]]),
        )
        for run in long.tolist()
    ]
    return found, Change(int(at[-1]), int(time[-1]), bool(abrupt[changes[-1]]))
