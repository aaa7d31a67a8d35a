"""Planning a play session: what the hand does when, with which object.

A hand that plays reaches for an object, closes on it, lifts it, turns it about and lets it slide
between the pads, squeezes once more, puts it down a little further on and leaves. The steps
overlap as in real reaching, except where the gripper must rest on the object: while it closes and
while it opens. On request the hand taps first: it stays where it is and closes and opens at random
times, to random depths, sometimes short of contact. What will be felt is then decided by the
fingers alone; nothing that a camera sees tells when.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from exumi_data.simulation.motion import (
    Float64Array,
    RotationTrack,
    Step,
    Track,
    minimum_jerk_inverse,
    multiply_quaternions,
    quaternion_from_rotation_vector,
    rotate_vectors,
)
from exumi_data.simulation.objects import SimulatedObject
from exumi_data.simulation.tremor import make_tremor
from exumi_data.simulation.truth import GelStiffness, Grasp, Truth

__all__ = ["plan_play"]

_GRASP_S = 5.0
_TAP_S = 0.9
_IDLE_S = 0.3
_DOWN = (1.0, 0.0, 0.0, 0.0)  # gripper or object z down, x along world x
_HOME = (0.0, -0.09, 0.20)
_HOVER_M = 0.07

_Vector = Sequence[float] | Float64Array

# Phases of a grasp: start and end as parts of its time. As in real play, the fingers touch
# something for nearly two thirds of it.
_REACH = (0.00, 0.14)
_DESCEND = (0.08, 0.19)
_CLOSE = (0.20, 0.31)
_LIFT = (0.31, 0.45)
_TURN = (0.40, 0.57)
_TURN_BACK = (0.55, 0.73)
_SLIDE = (0.37, 0.55)
_SLIDE_ON = (0.57, 0.74)
_SQUEEZE = (0.47, 0.57)
_EASE = (0.61, 0.70)
_LOWER = (0.72, 0.88)
_OPEN = (0.895, 0.98)
_RETREAT = (0.95, 1.00)
_TAPS_AT = 0.195  # before the fingers close

_FEINTS = 0.3  # share of taps that stop short of contact
_SHORTEST_TAP_S = 0.3


@dataclass(frozen=True, slots=True)
class _Pose:
    """A pose while planning: position (3,) in metres and quaternion xyzw (4,)."""

    place: Float64Array
    turn: Float64Array

    def moved(
        self, world: Sequence[float] = (0, 0, 0), local: Sequence[float] = (0, 0, 0)
    ) -> _Pose:
        """Return this pose shifted along the world's and its own axes, metres."""
        along = rotate_vectors(self.turn[None], np.array([local], dtype=np.float64))[0]
        return _Pose(self.place + np.array(world) + along, self.turn)

    def turned(self, vector: Float64Array) -> _Pose:
        """Return this pose turned about its own origin, by a rotation vector in its own axes."""
        turn = quaternion_from_rotation_vector(vector[None])
        return _Pose(self.place, multiply_quaternions(self.turn[None], turn)[0])

    def without_slip(self, slip: Float64Array) -> _Pose:
        """Return the gripper's pose when this is the object's, lying in the grip at `slip`."""
        upright = self.turned(np.array([-slip[2], 0.0, 0.0]))
        return upright.moved(local=(0.0, -slip[0], -slip[1]))

    def as_array(self) -> Float64Array:
        return np.concatenate([self.place, self.turn])


@dataclass(slots=True)
class _Builder:
    """Collects the steps of all tracks, keeping the targets reached so far."""

    pose: _Pose
    opening_m: float
    slip: Float64Array
    steps: dict[str, list[Step]] = field(
        default_factory=lambda: {
            "position": [],
            "rotation": [],
            "closing": [],
            "slip": [],
            "envelope": [],
        }
    )

    def add(self, track: str, phase: tuple[float, float], delta: _Vector) -> None:
        components = tuple(float(x) for x in delta)
        self.steps[track].append(Step(phase[0], phase[1] - phase[0], components))

    def move_to(self, phase: tuple[float, float], target: _Pose) -> None:
        self.add("position", phase, target.place - self.pose.place)
        self.add("rotation", phase, _rotation_between(self.pose.turn, target.turn))
        self.pose = target

    def close_to(self, phase: tuple[float, float], opening_m: float) -> None:
        self.add("closing", phase, (opening_m - self.opening_m,))
        self.opening_m = opening_m

    def slip_to(self, phase: tuple[float, float], slip: Float64Array) -> None:
        self.add("slip", phase, slip - self.slip)
        self.slip = slip


def plan_play(
    rng: np.random.Generator,
    duration_s: float,
    objects: tuple[SimulatedObject, ...],
    *,
    taps: int = 0,
) -> Truth:
    """Return the truth of a play session with these objects.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all variation.
    duration_s : float
        Length of the session, seconds; about one grasp every 5 s, and 0.9 s more for each tap.
    objects : tuple of SimulatedObject
        The objects on the table, taken in turn.
    taps : int, optional
        How often the fingers close and open again before each grasp.

    Returns
    -------
    Truth
        The session.
    """
    rests = [[pose] for pose in _lay_out(rng, len(objects))]
    for rest, item in zip(rests, objects, strict=True):
        rest[0] = rest[0].moved(world=(0, 0, item.rest_height_m))
    home = _Pose(np.array(_HOME), np.array(_DOWN)).turned(rng.normal(0, 0.05, 3))
    opening_m = float(rng.uniform(0.070, 0.080))
    builder = _Builder(home, opening_m, np.zeros(3))
    pause_s = taps * _TAP_S
    edges = _grasp_edges(rng, duration_s, _GRASP_S + pause_s)
    gel = GelStiffness()
    grasps = []
    for number, (start, end) in enumerate(pairwise(edges)):
        index = number % len(objects)
        rest = rests[index]
        rest.append(_next_rest(rng, rest[0], rest[-1]))
        # A session that is shorter than a grasp leaves less time to tap, too.
        times = _Times(start, end, pause_s * (end - start) / (_GRASP_S + pause_s))
        grasps.append(_add_grasp(builder, rng, times, index, objects[index], rest, gel, taps))
    return Truth(
        duration_s=duration_s,
        objects=objects,
        grasps=tuple(grasps),
        position=Track(tuple(home.place), tuple(builder.steps["position"])),
        rotation=RotationTrack(tuple(home.turn), tuple(builder.steps["rotation"])),
        tremor=make_tremor(rng, Track((1.0,), tuple(builder.steps["envelope"]))),
        closing=Track((opening_m,), tuple(builder.steps["closing"])),
        slip=Track((0.0, 0.0, 0.0), tuple(builder.steps["slip"])),
        gel=gel,
        rest_poses=tuple(np.stack([pose.as_array() for pose in rest]) for rest in rests),
    )


@dataclass(frozen=True, slots=True)
class _Times:
    """A grasp's start, end, and the pause for taps within, in seconds."""

    start: float
    end: float
    pause: float

    def __call__(self, phase: tuple[float, float]) -> tuple[float, float]:
        """Return a phase, given in parts of the grasp's time without taps, in seconds."""
        return self._at(phase[0]), self._at(phase[1])

    def _at(self, part: float) -> float:
        paused = self.pause if part > _TAPS_AT else 0.0
        return self.start + paused + part * (self.end - self.start - self.pause)

    def taps(self) -> tuple[float, float]:
        """Return when the pause begins and ends."""
        begin = self._at(_TAPS_AT)
        return begin, begin + self.pause


def _add_grasp(
    builder: _Builder,
    rng: np.random.Generator,
    times: _Times,
    index: int,
    item: SimulatedObject,
    rest: list[_Pose],
    gel: GelStiffness,
    taps: int,
) -> Grasp:
    """Append one grasp, from the object's last but one rest pose to its last."""
    slips = _slips(rng)
    grip = rest[-2].without_slip(slips[0])
    release = rest[-1].without_slip(slips[2])
    wide_m = item.width_m + float(rng.uniform(0.022, 0.032))
    builder.slip_to(times(_REACH), slips[0])
    builder.close_to(times(_REACH), wide_m)
    builder.move_to(times(_REACH), grip.moved(local=(0, 0, -_HOVER_M)))
    builder.move_to(times(_DESCEND), grip)
    builder.add("envelope", times((_DESCEND[0], _DESCEND[1])), (-1.0,))
    tapped_s = _add_taps(builder, rng, times, item, gel, taps)
    grasped_s = _add_hold(builder, rng, times, item, gel)
    contact_s = grasped_s if tapped_s is None else tapped_s
    builder.slip_to(times(_SLIDE), slips[1])
    builder.slip_to(times(_SLIDE_ON), slips[2])
    builder.add("envelope", times(_LIFT), (1.0,))
    _add_display(builder, rng, times, release)
    builder.add("envelope", times(_LOWER), (-1.0,))
    touching_m = builder.opening_m
    wide_again_m = item.width_m + float(rng.uniform(0.022, 0.032))
    builder.close_to(times(_OPEN), wide_again_m)
    release_s = _crossing_s(times(_OPEN), touching_m, wide_again_m, item.width_m)
    builder.move_to(times(_RETREAT), release.moved(local=(0, 0, -_HOVER_M)))
    builder.add("envelope", times(_RETREAT), (1.0,))
    share = float(rng.uniform(0.46, 0.54))
    return Grasp(
        item.name, index, times.start, times.end, contact_s, release_s, item.width_m, share
    )


def _add_taps(
    builder: _Builder,
    rng: np.random.Generator,
    times: _Times,
    item: SimulatedObject,
    gel: GelStiffness,
    taps: int,
) -> float | None:
    """Append closing and opening again; return the time of first contact, None without any."""
    begin, end = times.taps()
    wide_m = builder.opening_m
    first_s = None
    cuts = begin + np.sort(rng.uniform(0, 1, taps)) * (end - begin) if taps else np.empty(0)
    for start, stop in pairwise([*(float(cut) for cut in cuts), end]):
        if stop - start < _SHORTEST_TAP_S:
            continue
        feint = rng.uniform() < _FEINTS
        depth_m = item.hold_depth_m * float(rng.uniform(0.3, 1.1))
        level = item.width_m - gel.drive_m(2 * depth_m)
        if feint:
            level = item.width_m + float(rng.uniform(0.3, 0.7)) * (wide_m - item.width_m)
        hold = min(float(rng.uniform(0.25, 0.40)), 0.4 * (stop - start))
        closing = (start, start + hold)
        builder.close_to(closing, level)
        if not feint and first_s is None:
            first_s = _crossing_s(closing, wide_m, level, item.width_m)
        builder.close_to((stop - hold, stop), wide_m)
    return first_s


def _add_hold(
    builder: _Builder,
    rng: np.random.Generator,
    times: _Times,
    item: SimulatedObject,
    gel: GelStiffness,
) -> float:
    """Append closing on the object and squeezing it; return the time of contact."""
    depth_m = item.hold_depth_m * float(rng.uniform(0.85, 1.0))
    wide_m = builder.opening_m
    levels = [item.width_m - gel.drive_m(2 * depth_m * part) for part in (1.0, 1.15, 0.9)]
    for phase, level in zip((_CLOSE, _SQUEEZE, _EASE), levels, strict=True):
        builder.close_to(times(phase), level)
    return _crossing_s(times(_CLOSE), wide_m, levels[0], item.width_m)


def _add_display(
    builder: _Builder, rng: np.random.Generator, times: _Times, release: _Pose
) -> None:
    """Append lifting the object, turning it about in the air and putting it down."""
    lifted = builder.pose.moved(world=(0, 0, float(rng.uniform(0.06, 0.10))))
    builder.move_to(times(_LIFT), lifted)
    side = rng.choice([-1.0, 1.0], 3)
    turn = side * rng.uniform((0.1, 0.05, 0.2), (0.35, 0.25, 0.6))
    shift = (float(rng.uniform(-0.04, 0.04)), float(rng.uniform(-0.03, 0.05)), 0.02)
    builder.move_to(times(_TURN), lifted.turned(turn).moved(world=shift))
    builder.move_to(times(_TURN_BACK), release.moved(world=(0, 0, _HOVER_M)))
    builder.move_to(times(_LOWER), release)


def _slips(rng: np.random.Generator) -> list[Float64Array]:
    """Return where the object lies in the grip at contact, after sliding, and at release."""
    limit = np.array([2.0e-3, 1.5e-3, 0.30])
    first = rng.uniform(-limit, limit)
    # Sliding goes to the other side, so that it is always seen.
    second = -np.sign(first) * rng.uniform(0.3, 1.0, 3) * limit
    third = 0.5 * first + rng.uniform(-0.3, 0.3, 3) * limit
    return [first, second, third]


def _grasp_edges(rng: np.random.Generator, duration_s: float, grasp_s: float) -> list[float]:
    """Return the times between the grasps, the first grasp's start and the last one's end."""
    count = max(1, round(duration_s / grasp_s))
    idle_s = min(_IDLE_S, 0.05 * duration_s)
    parts = rng.uniform(0.92, 1.08, count)
    ends = idle_s + np.cumsum(parts) / parts.sum() * (duration_s - 2 * idle_s)
    return [idle_s, *(float(end) for end in ends)]


def _lay_out(rng: np.random.Generator, count: int) -> list[_Pose]:
    """Return poses on the table (z = 0), in a zigzag with room for the open fingers."""
    poses = []
    for index in range(count):
        x = (index - (count - 1) / 2) * 0.085
        y = 0.05 if index % 2 else -0.05
        place = np.array([x, y, 0.0]) + np.append(rng.uniform(-0.008, 0.008, 2), 0.0)
        yaw = np.array([0.0, 0.0, rng.uniform(-0.35, 0.35)])
        poses.append(_Pose(place, np.array(_DOWN)).turned(yaw))
    return poses


def _next_rest(rng: np.random.Generator, first: _Pose, last: _Pose) -> _Pose:
    """Return where an object is put down: near its first place, turned a little further."""
    place = first.place + np.append(rng.uniform(-0.015, 0.015, 2), 0.0)
    yaw = float(rng.uniform(-0.35, 0.35))
    return _Pose(place, np.array(_DOWN)).turned(np.array([0.0, 0.0, yaw]))


def _crossing_s(
    phase_s: tuple[float, float], start_m: float, end_m: float, level_m: float
) -> float:
    """Return when a step from `start_m` to `end_m` passes `level_m`, seconds."""
    part = minimum_jerk_inverse((level_m - start_m) / (end_m - start_m))
    return phase_s[0] + part * (phase_s[1] - phase_s[0])


def _rotation_between(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return the world rotation vector (radians) that turns `first` into `second`."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(second) * Rotation.from_quat(first).inv()
    vector: Float64Array = turn.as_rotvec()
    return vector
