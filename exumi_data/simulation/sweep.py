"""A hand that sweeps its camera before a marker, with known truth: for tests and benchmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.sweep import MarkerTrack, PoseTrack

__all__ = ["SimulatedSweep", "SweepSettings", "simulate_sweep"]

Float64Array = NDArray[np.float64]

_REST_S = 0.7
_MARGIN_S = 1.5
# Nobody sweeps like a machine: of half a period, and of the way.
_PACE, _REACH = 0.05, 0.08
_MARKER_M = np.array([0.0, 0.02, 0.45])
_WANDER_M = 0.012
_WANDER_RAD = 0.05
_WANDER_HZ = (0.15, 0.6)


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """What a simulated sweep is like.

    Attributes
    ----------
    rate_hz : float
        Of the sweeping.
    delay_s : float
        By how much the poses are late by what carries them, against the frames' stamps.
    seconds : float
    reach_m : float
        Of the sweeping, to each side.
    noise_m : float
        Of the marker's position, each axis.
    missing : float
        Share of frames in which the marker is not found.
    exposure_s, readout_s : float
        Of the camera, which stamps the start of its first row's exposure.
    headset_lag_s : float
        Of the poses: part of their latency.
    frames_per_s, poses_per_s : float
    regular : bool
        Sweep like a machine, without rest or change: then nothing tells the periods apart.
    """

    rate_hz: float = 1.0
    delay_s: float = 0.0
    seconds: float = 12.0
    reach_m: float = 0.12
    noise_m: float = 1.5e-3
    missing: float = 0.15
    exposure_s: float = 0.0
    readout_s: float = 0.0
    headset_lag_s: float = 0.0
    frames_per_s: float = 60_000 / 1001
    poses_per_s: float = 90.0
    regular: bool = False


class SimulatedSweep:
    """The way of a hand that sweeps; times are seconds from the start of the video.

    Parameters
    ----------
    settings : SweepSettings
    seed : int
    """

    def __init__(self, settings: SweepSettings, seed: int) -> None:
        self.settings = settings
        self._rng = np.random.default_rng((seed, 71))
        self._turns_s, self._turns_m = self._turns()
        self._waves = [self._wave() for _ in range(5)]

    def _turns(self) -> tuple[Float64Array, Float64Array]:
        """Return when the hand turns round, and where it is then."""
        settings = self.settings
        half = 0.5 / settings.rate_hz
        pace, reach = (0.0, 0.0) if settings.regular else (_PACE, _REACH)
        begin = -_MARGIN_S if settings.regular else _REST_S
        end = settings.seconds + (_MARGIN_S if settings.regular else -_REST_S)
        count = int((end - begin) / half) + 2
        steps = half * (1.0 + pace * self._rng.standard_normal(count).clip(-2.5, 2.5))
        moments = begin + np.concatenate(([0.0], np.cumsum(steps)))
        moments = moments[moments < end]
        way = settings.reach_m * (1.0 + reach * self._rng.standard_normal(len(moments)))
        way[1::2] *= -1.0
        if not settings.regular:
            way[0] = way[-1] = 0.0
        return moments, way

    def _wave(self) -> tuple[Float64Array, Float64Array]:
        return self._rng.uniform(*_WANDER_HZ, 4), self._rng.uniform(0, 2 * np.pi, 4)

    def position_m(self, time_s: Float64Array) -> Float64Array:
        """Return where the hand is, (N, 3), metres."""
        step = np.searchsorted(self._turns_s, time_s, side="right") - 1
        inside = (step >= 0) & (step < len(self._turns_s) - 1)
        step = step.clip(0, len(self._turns_s) - 2)
        begin, end = self._turns_s[step], self._turns_s[step + 1]
        progress = ((time_s - begin) / (end - begin)).clip(0.0, 1.0)
        progress = np.where(inside, 0.5 - 0.5 * np.cos(np.pi * progress), progress.round())
        swept = self._turns_m[step] + progress * (self._turns_m[step + 1] - self._turns_m[step])
        return np.stack([swept, self._wander(0, time_s), self._wander(1, time_s)], axis=1)

    def _wander(self, number: int, time_s: Float64Array, size: float = _WANDER_M) -> Float64Array:
        if self.settings.regular:
            return np.zeros(len(time_s))
        frequency, phase = self._waves[number]
        return np.asarray(
            size * np.sin(2 * np.pi * frequency * time_s[:, None] + phase).mean(axis=1)
        )

    def poses(self, time_s: Float64Array) -> Float64Array:
        """Return the poses of the hand, whose frame is the camera's, (N, 7)."""
        from scipy.spatial.transform import Rotation

        turn = np.stack([self._wander(i, time_s, _WANDER_RAD) for i in (2, 3, 4)], axis=1)
        # The wrist turns with the arm.
        turn[:, 1] += 0.6 * self.position_m(time_s)[:, 0]
        return np.hstack([self.position_m(time_s), Rotation.from_rotvec(turn).as_quat()])

    def marker_m(self, time_s: Float64Array) -> Float64Array:
        """Return where the marker is in the camera's frame, (N, 3), metres."""
        from scipy.spatial.transform import Rotation

        poses = self.poses(time_s)
        rotation = Rotation.from_quat(poses[:, 3:])
        return np.asarray(rotation.inv().apply(_MARKER_M - poses[:, :3]))

    def place_m(self, time_s: Float64Array, points_m: Float64Array) -> Float64Array:
        """Return where points of the marker are in the camera's frame, at one moment.

        Parameters
        ----------
        time_s : (1,) float64
        points_m : (K, 3) float64
            In the marker's frame, which is turned like the world's; metres.

        Returns
        -------
        (K, 3) float64
        """
        from scipy.spatial.transform import Rotation

        pose = self.poses(time_s)[0]
        rotation = Rotation.from_quat(pose[3:])
        return np.asarray(rotation.inv().apply(_MARKER_M + points_m - pose[:3]))

    def marker_track(self) -> MarkerTrack:
        """Return what a detector makes of the video."""
        settings = self.settings
        stamp = np.arange(round(settings.seconds * settings.frames_per_s)) / settings.frames_per_s
        # Rows follow from where the marker is; the moment from the row.
        at = self.marker_m(stamp)
        row = (0.5 + 0.6 * at[:, 1] / at[:, 2]).clip(0.0, 1.0)
        moment = stamp + 0.5 * settings.exposure_s + settings.readout_s * row
        position = self.marker_m(moment)
        position += settings.noise_m * self._rng.standard_normal(position.shape)
        found = self._rng.random(len(stamp)) >= settings.missing
        time_ns = np.rint(stamp[found] * 1e9).astype(np.int64)
        return MarkerTrack(time_ns, position[found], row[found], len(stamp))

    def pose_track(self) -> PoseTrack:
        """Return what the tracker says."""
        settings = self.settings
        step = 1.0 / settings.poses_per_s
        moment = np.arange(-_MARGIN_S, settings.seconds + _MARGIN_S, step)
        moment += 3e-4 * self._rng.standard_normal(len(moment))
        poses = self.poses(moment)
        poses[:, :3] += 3e-4 * self._rng.standard_normal((len(poses), 3))
        stamp = moment + settings.headset_lag_s + settings.delay_s
        return PoseTrack(np.rint(stamp * 1e9).astype(np.int64), poses)


def simulate_sweep(settings: SweepSettings, seed: int) -> tuple[MarkerTrack, PoseTrack]:
    """Simulate a sweep.

    Parameters
    ----------
    settings : SweepSettings
    seed : int
        Chooses everything that is left to chance.

    Returns
    -------
    MarkerTrack
    PoseTrack
    """
    sweep = SimulatedSweep(settings, seed)
    return sweep.marker_track(), sweep.pose_track()
