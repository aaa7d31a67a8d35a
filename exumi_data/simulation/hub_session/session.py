"""Writing a simulated session: the hub's folder, the camera's card, and what is true of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from exumi_data.simulation.demonstrations import simulate_demonstrations
from exumi_data.simulation.encoder import WidthEncoder
from exumi_data.simulation.gopro import SimulatedGoPro
from exumi_data.simulation.hub_session.files import (
    GRIPPER_FILE,
    INTRINSICS_FILE,
    chunks_of,
    write_angles,
    write_gripper_file,
    write_intrinsics_file,
    write_tactile,
)
from exumi_data.simulation.hub_session.pictures import (
    CalibrationPictures,
    FingerPictures,
    ScenePictures,
)
from exumi_data.simulation.hub_session.truth import HubTruth, hub_truth
from exumi_data.simulation.objects import Finger
from exumi_data.simulation.sweep import SimulatedSweep, SweepSettings
from exumi_data.simulation.sweep_recording import CAMERA

__all__ = ["HubSession", "HubSettings", "simulate_hub_session"]

Float64Array = NDArray[np.float64]

_SIDES: tuple[Finger, ...] = ("left", "right")
_SAVE_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HubSettings:
    """What a simulated session is like.

    Attributes
    ----------
    seed : int
    seconds : float
        About how long a demonstration is.
    start : datetime
        UTC at which the hub begins.
    zone_s : float
        Time zone that the camera's clock and the hub's folder names are in.
    camera_ahead_s : float
        By how much the camera's clock is ahead of the hub's, zone aside.
    drift_ppm : float
        By how much the camera's clock runs fast.
    pose_latency_s, pose_jitter_s : float
        How old poses are when the hub stamps them, and how much that varies.
    pose_noise_m, pose_noise_rad : float
        Of the tracker, along and about each axis: standard deviation.
    tactile_latency_s : (float, float)
        The same of the two fingers; the hub stamps a frame before it asks for it.
    rate_hz : float
        Of tactile frames and of poses.
    tactile_size, rgb_size : (int, int)
        Height and width.
    rgb_rate : Fraction
    textured : bool
        Whether demonstrations are as costly to decode as real ones.
    codec : str
        FFmpeg's name of the encoder of demonstrations.
    bit_rate : int
        Of demonstrations.
    sweep_s : float
        How long the latency clip's sweep is; 0 for a session without one.
    flexes : int
        How often the gripper shuts in that clip, after the sweep.
    telemetry : bool
        Whether the camera has a gyroscope.
    late : float
        Share of tactile frames that come late, so that the hub writes them twice.
    exposure_s, readout_s : float
        Of the camera.
    calibration_scale : int
        How many times 480 by 360 pixels the latency clip has, each way.
    """

    seed: int = 0
    seconds: float = 6.0
    start: datetime = datetime(2025, 3, 22, 13, 46, 47, 312_000, tzinfo=UTC)
    zone_s: float = 8 * 3600.0
    camera_ahead_s: float = 1.37
    drift_ppm: float = 12.0
    pose_latency_s: float = 0.062
    pose_jitter_s: float = 5e-4
    pose_noise_m: float = 1.5e-4
    pose_noise_rad: float = 8e-4
    tactile_latency_s: tuple[float, float] = (0.031, 0.019)
    rate_hz: float = 30.0
    tactile_size: tuple[int, int] = (240, 320)
    rgb_size: tuple[int, int] = (72, 96)
    rgb_rate: Fraction = Fraction(60_000, 1001)
    textured: bool = False
    codec: str = "mpeg4"
    bit_rate: int = 1_000_000
    sweep_s: float = 8.0
    flexes: int = 6
    telemetry: bool = True
    late: float = 0.02
    exposure_s: float = 0.0085
    readout_s: float = 0.012
    calibration_scale: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class HubSession:
    """What was written, and what is true of it.

    Attributes
    ----------
    root : pathlib.Path
    hub : pathlib.Path
        The hub's folder in it.
    settings : HubSettings
    truth : HubTruth
    epoch_s : float
        Unix time of the session's second 0.
    clips : dict of str to float
        Path of each clip below `root` to the second of the session at which it begins.
    captured_s : dict of str to ndarray
        Of each finger: when each frame that the sensor made was captured, seconds of the session.
        The number in a picture is the index.
    shown : dict of str to ndarray
        Of each finger, for every frame of its files in order: the number in the picture.
    encoder : WidthEncoder
    """

    root: Path
    hub: Path
    settings: HubSettings
    truth: HubTruth
    epoch_s: float
    clips: dict[str, float]
    captured_s: dict[str, Float64Array]
    shown: dict[str, NDArray[np.int64]]
    encoder: WidthEncoder = field(default_factory=WidthEncoder)

    def true_s(self, clip: str, clip_s: Float64Array) -> Float64Array:
        """Return the session's seconds of times of a clip.

        Parameters
        ----------
        clip : str
            Its path below `root`.
        clip_s : (N,) float64
            Seconds of the container.
        """
        return self.clips[clip] + clip_s / (1.0 + 1e-6 * self.settings.drift_ppm)


def simulate_hub_session(
    folder: Path, settings: HubSettings | None = None, *, demonstrations: int = 3
) -> HubSession:
    """Write a session: ``tactile_<date>_<time>``, ``raw_videos`` and ``latency_calibration``.

    Parameters
    ----------
    folder : pathlib.Path
        New, or without these folders.
    settings : HubSettings, optional
    demonstrations : int, optional

    Returns
    -------
    HubSession
    """
    chosen = settings or HubSettings()
    sweep = None
    if chosen.sweep_s:
        sweep = SimulatedSweep(_sweep_settings(chosen), chosen.seed)
    truth = hub_truth(
        simulate_demonstrations(
            demonstrations, seed=chosen.seed, seconds=chosen.seconds, pause_s=1.5
        ),
        sweep,
        lead_s=2.0,
        flexes=chosen.flexes,
    )
    local = chosen.start + timedelta(seconds=chosen.zone_s)
    hub = folder / f"tactile_{local:%Y%m%d_%H%M%S}"
    hub.mkdir(parents=True)
    writer = _Writer(chosen, truth, hub)
    writer.angles()
    captured: dict[str, Float64Array] = {}
    shown: dict[str, NDArray[np.int64]] = {}
    for side in _SIDES:
        captured[side], shown[side] = writer.finger(side)
    encoder = WidthEncoder()
    openings = [round(0.01 * cm, 2) for cm in range(11, -1, -1)]
    counts = encoder.counts(openings)
    write_gripper_file(folder / GRIPPER_FILE, openings, [int(count) for count in counts])
    if chosen.sweep_s:
        write_intrinsics_file(folder / INTRINSICS_FILE, CAMERA)
    return HubSession(
        root=folder,
        hub=hub,
        settings=chosen,
        truth=truth,
        epoch_s=chosen.start.timestamp(),
        clips=_film(folder, chosen, truth, sweep),
        captured_s=captured,
        shown=shown,
    )


def _sweep_settings(settings: HubSettings) -> SweepSettings:
    return SweepSettings(
        rate_hz=0.9,
        seconds=settings.sweep_s,
        missing=0.0,
        exposure_s=settings.exposure_s,
        readout_s=settings.readout_s,
        frames_per_s=float(settings.rgb_rate / 2),
    )


class _Writer:
    """Writes the hub's files."""

    def __init__(self, settings: HubSettings, truth: HubTruth, hub: Path) -> None:
        self._settings = settings
        self._truth = truth
        self._hub = hub
        self._epoch_s = settings.start.timestamp()
        edges = np.arange(_SAVE_S, truth.duration_s, _SAVE_S)
        self._edges_s = np.append(edges, truth.duration_s + 1.0)

    def _stamps(self, number: int) -> Float64Array:
        """Return when a loop of the hub comes round, seconds of the session."""
        rng = self._rng(number)
        steps = rng.normal(1.0 / self._settings.rate_hz, 6e-4, self._count)
        return np.asarray(rng.uniform(0.0, 0.02) + np.cumsum(steps), np.float64)

    @property
    def _count(self) -> int:
        return int(self._truth.duration_s * self._settings.rate_hz)

    def _rng(self, number: int) -> np.random.Generator:
        return np.random.default_rng((self._settings.seed, number, 91))

    def angles(self) -> None:
        settings, truth, rng = self._settings, self._truth, self._rng(4)
        stamp = self._stamps(3)
        age = settings.pose_latency_s + rng.normal(0.0, settings.pose_jitter_s, len(stamp))
        poses = truth.pose(stamp - age)
        poses[:, :3] += rng.normal(0.0, settings.pose_noise_m, (len(stamp), 3))
        noise = Rotation.from_rotvec(rng.normal(0.0, settings.pose_noise_rad, (len(stamp), 3)))
        # As SciPy gives them on the hub: the sign is whatever comes of it.
        poses[:, 3:] = Rotation.from_matrix(
            (Rotation.from_quat(poses[:, 3:]) * noise).as_matrix()
        ).as_quat()
        counts = WidthEncoder().counts(truth.width_m(stamp - 3e-4))
        for number, part in enumerate(chunks_of(stamp, self._edges_s)):
            write_angles(self._hub, number, self._epoch_s + stamp[part], counts[part], poses[part])

    def finger(self, side: Finger) -> tuple[Float64Array, NDArray[np.int64]]:
        settings, truth = self._settings, self._truth
        number = _SIDES.index(side)
        rng = self._rng(5 + number)
        stamp = self._stamps(1 + number)
        # A frame that comes late is written twice, under one stamp; the one after it is lost.
        late = np.flatnonzero(rng.random(len(stamp)) < settings.late)
        late = late[late % 2 == 1]
        kept = np.delete(np.arange(len(stamp)), late + 1 if late[-1:] < len(stamp) - 1 else late)
        stamp = stamp[kept]
        captured = stamp - settings.tactile_latency_s[number]
        depth = truth.depth_m(side, captured)
        pictures = FingerPictures(settings.tactile_size, settings.seed + number)
        repeats = np.where(np.isin(kept, late), 2, 1)
        shown: list[NDArray[np.int64]] = []
        for chunk, part in enumerate(chunks_of(stamp, self._edges_s)):
            numbers = np.repeat(np.arange(part.start, part.stop), repeats[part])
            shown.append(numbers)
            write_tactile(
                self._hub,
                side,
                chunk,
                (self._epoch_s + stamp[numbers]).tolist(),
                _drawn(pictures, numbers, depth),
            )
        return captured, np.concatenate(shown)


def _drawn(
    pictures: FingerPictures, numbers: NDArray[np.int64], depth_m: Float64Array
) -> Iterator[NDArray[np.uint8]]:
    last, picture = -1, np.empty((0, 0, 3), np.uint8)
    for number in numbers.tolist():
        if number != last:
            last, picture = number, pictures.draw(number, float(depth_m[number]))
        yield picture


def _film(
    folder: Path, settings: HubSettings, truth: HubTruth, sweep: SimulatedSweep | None
) -> dict[str, float]:
    """Write the camera's clips; return when each begins."""
    camera = SimulatedGoPro(
        rate=settings.rgb_rate,
        drift_ppm=settings.drift_ppm,
        clock_s=settings.zone_s + settings.camera_ahead_s,
        codec=settings.codec,
        bit_rate=settings.bit_rate,
    )
    rng = np.random.default_rng((settings.seed, 97))
    starts: dict[str, float] = {}
    if sweep is not None and truth.calibration_s is not None:
        name = "latency_calibration/GX010001.MP4"
        starts[name] = truth.calibration_s[0]
        _film_calibration(folder / name, settings, truth, sweep)
    (folder / "raw_videos").mkdir()
    for number, (start, stop) in enumerate(truth.spans_s):
        name = f"raw_videos/GX01{number + 2:04d}.MP4"
        starts[name] = start + float(rng.uniform(-0.3, 0.1))
        camera.film(
            folder / name,
            truth,
            (starts[name], stop + float(rng.uniform(-0.1, 0.3))),
            session_start=settings.start,
            seed=settings.seed + number,
            telemetry=settings.telemetry,
            pictures=ScenePictures(
                settings.rgb_size, textured=settings.textured, seed=settings.seed + number
            ),
        )
    return starts


def _enlarged(picture: NDArray[np.uint8], scale: int) -> NDArray[np.uint8]:
    if scale == 1:
        return picture
    size = picture.shape[1] * scale, picture.shape[0] * scale
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR), np.uint8)


def _film_calibration(
    path: Path, settings: HubSettings, truth: HubTruth, sweep: SimulatedSweep
) -> None:
    assert truth.calibration_s is not None  # noqa: S101  # the caller looked
    path.parent.mkdir()
    start, stop = truth.calibration_s
    rate = settings.rgb_rate / 2
    at = start + np.arange(int((stop - start) * rate) + 2) / float(rate)
    seen = at + 0.5 * settings.exposure_s + settings.readout_s * (1 - 30 / CAMERA.height)
    camera = SimulatedGoPro(
        rate=rate,
        drift_ppm=settings.drift_ppm,
        clock_s=settings.zone_s + settings.camera_ahead_s,
        bit_rate=2_400_000 * settings.calibration_scale**2,
        codec=settings.codec,
    )
    draw = CalibrationPictures(sweep, truth.width_m(seen), settings.seed)
    camera.film(
        path,
        truth,
        (start, stop),
        session_start=settings.start,
        seed=settings.seed + 1000,
        telemetry=settings.telemetry,
        pictures=lambda index: _enlarged(draw(index), settings.calibration_scale),
    )
