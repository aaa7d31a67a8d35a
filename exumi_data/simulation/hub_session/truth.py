"""What happens in a simulated session: a sweep before a marker, fingers that move, demonstrations.

Between two of these the hand goes on to where the next one begins, and waits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from exumi_data.geometry import compose
from exumi_data.simulation.demonstrations import Demonstrations
from exumi_data.simulation.motion import minimum_jerk
from exumi_data.simulation.objects import Finger
from exumi_data.simulation.sweep import SimulatedSweep
from exumi_data.simulation.truth import Truth

__all__ = ["HubTruth", "hub_truth"]

Float64Array = NDArray[np.float64]
Curve = Callable[[Float64Array], Float64Array]

# Where the marker's own world is in the hub's: nothing lies along the same axes.
_TABLE = np.array([0.7, -0.4, 0.9, 0.18257419, 0.36514837, 0.54772256, 0.73029674])
_OPEN_M, _SHUT_M = 0.075, 0.025
_FLEX_S = 1.1
_REST_S = 0.6


@dataclass(frozen=True)
class _Phase:
    """One of the things that happen. Times within it are seconds from its start."""

    start_s: float
    stop_s: float
    pose: Curve
    width_m: Curve
    depth_m: Callable[[Finger, Float64Array], Float64Array]


@dataclass(frozen=True)
class HubTruth:
    """What really happens, at any second of the session.

    Attributes
    ----------
    duration_s : float
    calibration_s : (float, float) or None
        When the latency clip is filmed: a sweep, then fingers that move while the hand rests.
    flexing_s : (float, float) or None
        When they do.
    spans_s : tuple of (float, float)
        The demonstrations.
    """

    duration_s: float
    calibration_s: tuple[float, float] | None
    flexing_s: tuple[float, float] | None
    spans_s: tuple[tuple[float, float], ...]
    phases: tuple[_Phase, ...]

    def pose(self, t_s: Float64Array) -> Float64Array:
        """Return ``T_world_controller``, (N, 7): x y z qx qy qz qw, metres."""
        return self._joined(t_s, lambda phase: phase.pose, _between)

    def width_m(self, t_s: Float64Array) -> Float64Array:
        """Return the gripper's opening, (N,) metres."""
        return self._joined(
            t_s,
            lambda phase: phase.width_m,
            lambda before, after, share: before + share * (after - before),
        )

    def depth_m(self, finger: Finger, t_s: Float64Array) -> Float64Array:
        """Return how deep something is pressed into a finger's gel, (N,) metres."""
        values = np.zeros(len(t_s))
        for phase in self.phases:
            inside = (t_s >= phase.start_s) & (t_s < phase.stop_s)
            if inside.any():
                values[inside] = phase.depth_m(finger, t_s[inside] - phase.start_s)
        return values

    def rad_per_s(self, t_s: NDArray[np.floating]) -> Float64Array:
        """Return the hand's angular velocity about its own axes, (N, 3)."""
        half = 1e-3
        at = np.asarray(t_s, np.float64)
        before = Rotation.from_quat(self.pose(at - half)[:, 3:])
        after = Rotation.from_quat(self.pose(at + half)[:, 3:])
        return np.asarray((before.inv() * after).as_rotvec() / (2 * half), np.float64)

    def _joined(
        self,
        times: Float64Array,
        curve: Callable[[_Phase], Curve],
        pause: Callable[[Float64Array, Float64Array, Float64Array], Float64Array],
    ) -> Float64Array:
        zero = np.zeros(1)
        stop, before = 0.0, curve(self.phases[0])(zero)[0]
        values = np.empty((len(times), *np.shape(before)))
        values[times < 0.0] = before
        for phase in self.phases:
            waiting = (times >= stop) & (times < phase.start_s)
            if waiting.any():
                share = minimum_jerk((times[waiting] - stop) / (phase.start_s - stop))
                values[waiting] = pause(before, curve(phase)(zero)[0], share)
            inside = (times >= phase.start_s) & (times < phase.stop_s)
            if inside.any():
                values[inside] = curve(phase)(times[inside] - phase.start_s)
            stop = phase.stop_s
            before = curve(phase)(np.array([phase.stop_s - phase.start_s]))[0]
        values[times >= stop] = before
        return values


def _between(before: Float64Array, after: Float64Array, share: Float64Array) -> Float64Array:
    places = before[:3] + share[:, None] * (after[:3] - before[:3])
    turns = Slerp([0.0, 1.0], Rotation.from_quat(np.stack([before[3:], after[3:]])))(share)
    return np.hstack([places, turns.as_quat()])


def hub_truth(
    demonstrations: Demonstrations,
    sweep: SimulatedSweep | None,
    *,
    lead_s: float,
    flexes: int,
) -> HubTruth:
    """Put a session together.

    Parameters
    ----------
    demonstrations : Demonstrations
    sweep : SimulatedSweep or None
        What the latency clip shows; None for a session without one.
    lead_s : float
        How long nothing happens first.
    flexes : int
        How often the gripper shuts and opens in the latency clip, after the sweep.
    """
    phases: list[_Phase] = []
    at, calibration, flexing = lead_s, None, None
    if sweep is not None:
        swept_until = at + sweep.settings.seconds
        end = swept_until + (flexes * _FLEX_S + 2 * _REST_S if flexes else 0.0)
        phases.append(_sweep_phase(at, end, sweep, flexes))
        calibration = (at, end)
        flexing = (swept_until, end) if flexes else None
        at = end + lead_s
    for (start, stop), truth in zip(demonstrations.spans_s, demonstrations.truths, strict=True):
        phases.append(_demonstration(at + start, at + stop, truth))
    return HubTruth(
        duration_s=at + demonstrations.duration_s,
        calibration_s=calibration,
        flexing_s=flexing,
        spans_s=tuple((at + start, at + stop) for start, stop in demonstrations.spans_s),
        phases=tuple(phases),
    )


def _sweep_phase(start: float, stop: float, sweep: SimulatedSweep, flexes: int) -> _Phase:
    first_s = sweep.settings.seconds + _REST_S

    def pose(t_s: Float64Array) -> Float64Array:
        # The hand rests once it has swept: its wandering stops as well.
        swept = sweep.poses(np.minimum(t_s, sweep.settings.seconds))
        return compose(np.tile(_TABLE, (len(t_s), 1)), swept)

    def width(t_s: Float64Array) -> Float64Array:
        part = np.clip((t_s - first_s) / _FLEX_S, 0.0, flexes)
        # No two closings are alike, or a lag of one of them would fit as well.
        pace = (
            part + 0.06 * np.sin(2.1 * part) - 0.06 * np.sin(2.1 * flexes) * part / max(flexes, 1)
        )
        shut = 0.5 - 0.5 * np.cos(2 * np.pi * pace)
        return np.asarray(_OPEN_M + shut * (_SHUT_M - _OPEN_M), np.float64)

    return _Phase(start, stop, pose, width, lambda _finger, t_s: np.zeros(len(t_s)))


def _demonstration(start: float, stop: float, truth: Truth) -> _Phase:
    return _Phase(
        start,
        stop,
        truth.pose,
        truth.width_m,
        truth.contact_depth_m,
    )
