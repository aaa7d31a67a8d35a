"""Latency of poses by a sweep: a marker seen by the camera against what the tracker says.

The hand with its camera is swept before a marker that stands still, or a marker on the hand before
a camera that does. Where the marker is in the camera's frame then follows from the poses, by gains
that need not be known: each axis is fitted by the position and the small rotations of the hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration_items import REFUSED_FIX, CalibrationRefusedError
from exumi_data.model.description import CalibrationItem
from exumi_data.synchronisation.lags import Curves, lag_grid, vertex
from exumi_data.synchronisation.timing import HEADSET_LAG_RANGE_S, CameraTiming, Range

__all__ = [
    "SWEEP_METHOD",
    "MarkerTrack",
    "PoseTrack",
    "SweepLimits",
    "SweepResult",
    "estimate_sweep",
    "latency_item",
]

SWEEP_METHOD = "exumi-sweep/1"

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

_GRID_S = 0.005
_HALF_REACH_S = 0.04
# The parabola goes through lags that leave up to so many times what the best one leaves, at most so
# many on each side: a wide minimum is a ragged one.
_WIDE = 10.0
_MOST_REACH = 5
# An axis that is explained by less than this tells nothing of the lag.
_USEFUL = 0.5
_SECOND_DRAW = math.sqrt(2.0)


@dataclass(frozen=True, slots=True, eq=False)
class MarkerTrack:
    """A marker in a camera's frame.

    Attributes
    ----------
    time_ns : (N,) int64
        Stamps of the frames in which it was found, strictly increasing.
    position_m : (N, 3) float64
        Of its centre: right, down, forward, metres.
    row : (N,) float64
        In which row of the frame: 0 the first, 1 the last.
    frames : int
        How many frames were looked at.
    """

    time_ns: Int64Array
    position_m: Float64Array
    row: Float64Array
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class PoseTrack:
    """Poses of the hand.

    Attributes
    ----------
    time_ns : (M,) int64
        Strictly increasing, of the same clock as the camera's.
    poses : (M, 7) float64
        x y z qx qy qz qw, metres.
    """

    time_ns: Int64Array
    poses: Float64Array

    def curves(self, camera: str) -> Float64Array:
        """Return what the marker's position depends on, nearly linearly.

        With the hand's rotation R from its middle one and its position p, a camera on the hand sees
        a marker that stands still at C·Rᵀ·(m - p) + t; one that stands still sees a marker on the
        hand at C·(R·m + p) + t. Of R itself, the odd part is enough: hands turn little.

        Parameters
        ----------
        camera : {"hand", "room"}
            Where the camera is.

        Returns
        -------
        (M, 6) float64
            Position, metres, and the sine of the rotation about each axis.
        """
        from scipy.spatial.transform import Rotation

        rotation = Rotation.from_quat(self.poses[:, 3:].copy())
        middle = rotation.mean().inv()
        turned = middle * rotation
        position = middle.apply(self.poses[:, :3] - self.poses[:, :3].mean(axis=0))
        if camera == "hand":
            position = turned.inv().apply(position)
        entries = turned.as_matrix()
        odd = 0.5 * (entries - entries.transpose(0, 2, 1))
        return np.hstack([position, odd[:, [2, 0, 1], [1, 2, 0]]])


@dataclass(frozen=True, slots=True)
class SweepLimits:
    """What a sweep has to keep to be believed.

    Attributes
    ----------
    max_lag_s : float
        Lags that are tried, both ways.
    motion_m : float
        Least way of hand and marker, from end to end.
    frames : int
        Least number of frames with the marker.
    detected : float
        Least share of the frames in which it was found.
    seconds : float
        Least time from the first to the last of them.
    explained : float
        Least share of the best axis's motion that the poses explain.
    sigma_s : float
        Largest uncertainty by noise alone.
    runner_up : float
        What the second-best lag leaves over what the best one leaves, rms, at least.
    halves_s : float
        Largest difference of the two halves, beyond three of its standard deviations.
    """

    max_lag_s: float = 0.5
    motion_m: float = 0.04
    frames: int = 60
    detected: float = 0.4
    seconds: float = 5.0
    explained: float = 0.95
    sigma_s: float = 1e-3
    runner_up: float = 1.5
    halves_s: float = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class SweepResult:
    """What a sweep says.

    Attributes
    ----------
    latency_s : float
        By how much the poses are late, seconds; the lag of the headset is part of it.
    sigma_s : float
        Standard deviation of it, everything included that is not known.
    noise_s : float
        The part of it that noise makes.
    camera_s : float
        The part that exposure and readout make.
    headset_s : float
        The part that the headset's lag makes, which in use is another one than in the sweep.
    residual_m : float
        What is left of the best axis, rms, metres.
    residual_s : float
        The same over the speed of the marker, seconds.
    explained : (3,) float64
        Share of each axis's motion that the poses explain.
    runner_up : float
        What the second-best lag leaves over what the best one leaves, rms; infinite if none.
    runner_up_s : float or None
        The second-best lag, as a latency.
    halves_s : float or None
        Latency of the second half less that of the first.
    halves_sigma_s : float
        Standard deviation of that.
    motion_m : (float, float)
        Way of the hand and of the marker.
    frames, detected : int
        Frames looked at, and with the marker.
    refusals : tuple of str
        Why it is not to be believed; empty if it is.
    marker : MarkerTrack
        Its times are those of the events.
    pose : PoseTrack
    curves : Curves
        Marker by poses.
    lags_s, left : (L,) float64
        Lags tried, as latencies, and what each leaves, rms in units of what the best one leaves.
    """

    latency_s: float
    sigma_s: float
    noise_s: float
    camera_s: float
    headset_s: float
    residual_m: float
    residual_s: float
    explained: Float64Array
    runner_up: float
    runner_up_s: float | None
    halves_s: float | None
    halves_sigma_s: float
    motion_m: tuple[float, float]
    frames: int
    detected: int
    refusals: tuple[str, ...]
    marker: MarkerTrack
    pose: PoseTrack
    curves: Curves
    lags_s: Float64Array = field(repr=False)
    left: Float64Array = field(repr=False)


def estimate_sweep(
    marker: MarkerTrack,
    pose: PoseTrack,
    *,
    camera: CameraTiming | None = None,
    headset_lag_s: Range | None = None,
    limits: SweepLimits | None = None,
) -> SweepResult:
    """Estimate by how much poses are late relative to what a camera saw.

    Parameters
    ----------
    marker : MarkerTrack
    pose : PoseTrack
    camera : CameraTiming, optional
        Default: exposure and readout are not known.
    headset_lag_s : Range, optional
        Lag of the headset's poses. It is part of the latency, and in use another one than in the
        sweep by as much as it is not known. Default: 0 to 20 ms.
    limits : SweepLimits, optional

    Returns
    -------
    SweepResult
        Its `refusals` say why it must not be used, if it must not.

    Raises
    ------
    CalibrationRefusedError
        There is nothing to estimate from: too few detections or poses, no motion, no overlap, or
        the best lag is at the end of the range.
    """
    camera = camera or CameraTiming()
    limits = limits or SweepLimits()
    lag = Range(*HEADSET_LAG_RANGE_S) if headset_lag_s is None else headset_lag_s
    _check_readings(marker, pose, limits)
    events = MarkerTrack(
        camera.event_ns(marker.time_ns, marker.row), marker.position_m, marker.row, marker.frames
    )
    lags = lag_grid(limits.max_lag_s, _GRID_S)
    curves, power = _explained(events, pose, lags)
    best, left, explained = _chosen(power, events.position_m)
    offset = _refined(lags, left, best)
    noise = None if offset is None else curves.sigma_s(offset)
    if offset is None or noise is None:
        raise CalibrationRefusedError(
            f"the best lag is {-1e3 * lags[best]:+.0f} ms, at the end of what was tried",
            fix="Try a wider range (--max-lag); if that does not help, the two are not of one "
            "motion.",
        )
    runner_up = _runner_up(left, best)
    axis = int(explained.argmax())
    halves, halves_sigma = _halves(curves, offset, axis)
    residual = _residual_m(curves, offset, axis)
    speed = np.gradient(events.position_m[:, axis], events.time_ns * 1e-9)
    camera_s = camera.sigma_s(float(marker.row.mean()))
    headset_s = _SECOND_DRAW * lag.sigma
    result = SweepResult(
        latency_s=-offset,
        sigma_s=math.hypot(noise, camera_s, headset_s),
        noise_s=noise,
        camera_s=camera_s,
        headset_s=headset_s,
        residual_m=residual,
        residual_s=residual / float(np.sqrt(np.mean(speed**2))),
        explained=explained,
        runner_up=math.inf if runner_up is None else float(np.sqrt(left[runner_up])),
        runner_up_s=None if runner_up is None else -float(lags[runner_up]),
        halves_s=None if halves is None else -halves,
        halves_sigma_s=halves_sigma,
        motion_m=(_way_m(pose.poses[:, :3]), _way_m(marker.position_m)),
        frames=marker.frames,
        detected=len(marker.time_ns),
        refusals=(),
        marker=events,
        pose=pose,
        curves=curves,
        lags_s=-lags[::-1],
        left=np.sqrt(left[::-1]),
    )
    return _judged(result, limits)


def _check_readings(marker: MarkerTrack, pose: PoseTrack, limits: SweepLimits) -> None:
    found = len(marker.time_ns)
    share = found / max(marker.frames, 1)
    if found < limits.frames or share < limits.detected:
        raise CalibrationRefusedError(
            f"the marker was found in {found} of {marker.frames} frames",
            fix="More light, a shorter exposure, slower sweeps, or another marker id and "
            f"dictionary. Needed: {limits.frames} frames, and {limits.detected:.0%} of all.",
        )
    seconds = float(marker.time_ns[-1] - marker.time_ns[0]) * 1e-9
    if seconds < limits.seconds:
        raise CalibrationRefusedError(
            f"the marker was seen for {seconds:.1f} s",
            fix=f"Sweep for 12 s, at least for {limits.seconds:g} s.",
        )
    if len(pose.time_ns) < limits.frames:
        raise CalibrationRefusedError(f"there are {len(pose.time_ns)} poses", fix=REFUSED_FIX)
    for what, way in (
        ("hand", _way_m(pose.poses[:, :3])),
        ("marker", _way_m(marker.position_m)),
    ):
        if way < limits.motion_m:
            raise CalibrationRefusedError(
                f"the {what} moved by {1e3 * way:.0f} mm only",
                fix=f"Sweep by 24 cm from end to end, at least by {1e3 * limits.motion_m:.0f} mm. "
                "Tracking that is frozen looks the same.",
            )


def _way_m(position_m: Float64Array) -> float:
    """Return the way from end to end along the axis that moves most; single outliers left out."""
    low, high = np.percentile(position_m, (2, 98), axis=0)
    return float((high - low).max())


def _explained(
    events: MarkerTrack, pose: PoseTrack, lags_s: Float64Array
) -> tuple[Curves, Float64Array]:
    """Return the fit by the place of the camera that explains more, and what each lag leaves."""
    found: list[tuple[float, Curves, Float64Array]] = []
    for camera in ("hand", "room"):
        curves = Curves(events.time_ns, events.position_m, pose.time_ns, pose.curves(camera))
        power = curves.profile(lags_s)
        found.append((float(np.log(np.maximum(power, 1e-18)).sum(axis=1).min()), curves, power))
    _, curves, power = min(found, key=lambda one: one[0])
    if not np.isfinite(power).any():
        raise CalibrationRefusedError(
            "video and poses do not overlap in time",
            fix="Check that they are of one recording; for a clip, say where it begins.",
        )
    return curves, power


def _chosen(
    power: Float64Array, position_m: Float64Array
) -> tuple[int, Float64Array, Float64Array]:
    """Return the best lag's index, what each lag leaves in units of it, and what is explained."""
    floor = 1e-12 * np.maximum(position_m.var(axis=0), 1e-12)
    power = np.maximum(power, floor)
    # The likelihood of errors whose size on each axis is not known.
    best = int(np.log(power).sum(axis=1).argmin())
    explained = 1.0 - power[best] / np.maximum(position_m.var(axis=0), floor)
    useful = explained >= min(_USEFUL, float(explained.max()))
    left = (power / power[best])[:, useful].mean(axis=1)
    return best, left, explained


def _runner_up(left: Float64Array, best: int) -> int | None:
    inner = left[1:-1]
    minima = 1 + np.flatnonzero((inner <= left[:-2]) & (inner <= left[2:]))
    others = minima[np.abs(minima - best) > 1]
    others = others[np.isfinite(left[others])]
    return int(others[left[others].argmin()]) if len(others) else None


def _refined(lags_s: Float64Array, left: Float64Array, best: int) -> float | None:
    """Return the lag at the vertex of a parabola, as wide as the minimum is one."""
    reach = 1
    while reach < _MOST_REACH:
        wider = left[max(best - reach - 1, 0) : best + reach + 2]
        if len(wider) < 2 * reach + 3 or not (wider <= _WIDE).all():
            break
        reach += 1
    return vertex(lags_s, left, best, reach=reach)


def _halves(curves: Curves, offset_s: float, axis: int) -> tuple[float | None, float]:
    """Return how much later the lag is in the second half, and the standard deviation of that.

    With the gains of the whole: half a sweep is too short for them.
    """
    fit = curves.fitted(offset_s)
    if fit is None:
        return None, 0.0
    predicted = curves.b @ fit.gains[:, axis]
    one = Curves(curves.time_a_ns, curves.a[:, axis], curves.time_b_ns, predicted)
    middle = len(one.a) // 2
    lags = lag_grid(_HALF_REACH_S, _GRID_S, middle_s=offset_s)
    found, sigma = [], []
    for part in (one.part(0, middle), one.part(middle, len(one.a))):
        power = part.profile(lags)
        if not np.isfinite(power).all():
            return None, 0.0
        best, left, _ = _chosen(power, part.a)
        at = _refined(lags, left, best)
        noise = None if at is None else part.sigma_s(at)
        if at is None or noise is None:
            return None, 0.0
        found.append(at)
        sigma.append(noise)
    return found[1] - found[0], math.hypot(*sigma)


def _residual_m(curves: Curves, offset_s: float, axis: int) -> float:
    fit = curves.fitted(offset_s)
    return math.inf if fit is None else float(np.sqrt(fit.power[axis]))


def _judged(result: SweepResult, limits: SweepLimits) -> SweepResult:
    from dataclasses import replace

    said: list[str] = []
    explained = float(result.explained.max())
    if explained < limits.explained:
        said.append(
            f"the poses explain {explained:.0%} of the marker's motion (needed: "
            f"{limits.explained:.0%}): these are not two views of one motion, or another marker "
            "of the same id was seen"
        )
    if result.runner_up < limits.runner_up and result.runner_up_s is not None:
        said.append(
            f"a latency of {1e3 * result.runner_up_s:+.0f} ms fits nearly as well (residual "
            f"x{result.runner_up:.2f}, needed: x{limits.runner_up:g}): the sweep repeats itself; "
            "rest, change the pace, and begin and end within the recording"
        )
    if result.noise_s > limits.sigma_s:
        said.append(
            f"the noise leaves {1e3 * result.noise_s:.1f} ms (needed: "
            f"{1e3 * limits.sigma_s:g} ms): sweep faster, further or longer"
        )
    if result.halves_s is None:
        said.append("one half of the sweep alone gives no latency: sweep all the time")
    elif abs(result.halves_s) > limits.halves_s + 3.0 * result.halves_sigma_s:
        said.append(
            f"the second half of the sweep gives {1e3 * result.halves_s:+.1f} ms more than the "
            "first: a clock drifts or steps, or frames were lost without a trace"
        )
    return replace(result, refusals=tuple(said))


def latency_item(
    results: Sequence[SweepResult], *, apart_s: float | None = None
) -> CalibrationItem:
    """Make the calibration item of a stream of poses.

    Parameters
    ----------
    results : sequence of SweepResult
        One sweep; or two, of the session's start and end.
    apart_s : float, optional
        Time between two sweeps, seconds, to state the drift.

    Returns
    -------
    CalibrationItem
        Value, uncertainty and residual in ns. Of two sweeps it is the mean; half of what they
        differ by is added to the uncertainty.

    Raises
    ------
    CalibrationRefusedError
        A sweep was refused.
    """
    for number, result in enumerate(results, start=1):
        if result.refusals:
            raise CalibrationRefusedError(
                "; ".join(result.refusals),
                where=f"sweep {number}" if len(results) > 1 else None,
                fix=REFUSED_FIX,
            )
    latency = float(np.mean([result.latency_s for result in results]))
    sigma = float(np.sqrt(np.mean([result.sigma_s**2 for result in results])))
    said = [_said(result) for result in results]
    if len(results) > 1:
        change = results[-1].latency_s - results[0].latency_s
        sigma = math.hypot(sigma, 0.5 * change)
        drift = f", {1e6 * change / apart_s:+.2f} ppm" if apart_s else ""
        said.append(f"from the first to the last {1e3 * change:+.2f} ms{drift}")
    return CalibrationItem(
        value=round(latency * 1e9),
        unit="ns",
        uncertainty=round(sigma * 1e9),
        residual=round(max(result.residual_s for result in results) * 1e9),
        method=SWEEP_METHOD,
        procedure="; ".join(said),
    )


def _said(result: SweepResult) -> str:
    parts = (
        f"noise {1e3 * result.noise_s:.2f}",
        f"exposure and readout {1e3 * result.camera_s:.2f}",
        f"headset lag {1e3 * result.headset_s:.2f}",
    )
    second = (
        "no second-best lag"
        if result.runner_up_s is None
        else f"second-best lag x{result.runner_up:.1f}"
    )
    return (
        f"marker found in {result.detected} of {result.frames} frames, way of the hand "
        f"{1e3 * result.motion_m[0]:.0f} mm, residual {1e3 * result.residual_m:.2f} mm, "
        f"{second}; standard deviations in ms: {', '.join(parts)}"
    )
