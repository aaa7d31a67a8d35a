"""A simulated sweep written as an episode or a clip, with frames in which the marker really is."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from exumi_data._version import __version__
from exumi_data.calibration import add_intrinsics
from exumi_data.camera import matrix
from exumi_data.clips.markers import MarkerSettings
from exumi_data.model import (
    Clock,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Source,
    Task,
)
from exumi_data.model.calibration import Intrinsics
from exumi_data.simulation.sweep import SimulatedSweep, SweepSettings
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["CAMERA", "sweep_frames", "write_sweep_clip", "write_sweep_episode"]

UInt8Array = NDArray[np.uint8]
Float64Array = NDArray[np.float64]

CAMERA = Intrinsics(model="pinhole", width=480, height=360, fx=330.0, fy=330.0, cx=239.5, cy=179.5)
"""How the simulated camera sees."""
_T0_NS = 1_000_000_000
_PRINT_PX = 120
_EDGE_PX = 20
_NOISE = 2.0
_BITS_PER_S = 4_000_000
_NAMESPACE = uuid.UUID("0b7f4a6e-53f1-5d51-a6ff-1d7b3f3a5c11")


def write_sweep_episode(
    path: str | os.PathLike[str],
    settings: SweepSettings,
    *,
    seed: int = 0,
    marker: MarkerSettings | None = None,
) -> Path:
    """Write the recording of a simulated sweep: streams ``pose`` and ``rgb``, stamps of one hub.

    Parameters
    ----------
    path : path-like
        ``<something>.zarr``.
    settings : SweepSettings
        `noise_m` is not used: the frames have noise of their own.
    seed : int, optional
    marker : MarkerSettings, optional

    Returns
    -------
    pathlib.Path
    """
    sweep = SimulatedSweep(settings, seed)
    printed = marker or MarkerSettings()
    said = {key: value for key, value in asdict(settings).items() if key != "noise_m"}
    metadata = EpisodeMetadata(
        id=str(uuid.uuid5(_NAMESPACE, f"{seed} {sorted(said.items())}")),
        task=Task(name="latency-sweep"),
        regime="play",
        licence="CC0-1.0",
        source=Source(
            type="simulated",
            tool="exumi-data",
            tool_version=__version__,
            settings={"seed": seed, **said},
        ),
    )
    with EpisodeWriter(path, metadata, durable=False) as writer:
        track = sweep.pose_track()
        pose = writer.add_stream(
            "pose",
            kind="pose",
            clock=_clock("kernel_rx"),
            nominal_rate=f"{round(settings.poses_per_s)}",
            frames=Frames(parent="world", child="controller"),
        )
        pose.append(track.time_ns, track.poses, time_host=track.time_ns + _T0_NS)
        camera = writer.add_stream(
            "rgb",
            kind="rgb",
            clock=_clock("buffer_soe"),
            images=EncodedImages(
                encoding="encoded",
                media_type="image/jpeg",
                height=CAMERA.height,
                width=CAMERA.width,
                channels=3,
            ),
        )
        add_intrinsics(writer, "rgb", CAMERA, method="known: it is the simulator's own")
        for stamp, frame in sweep_frames(sweep, seed=seed, marker=printed):
            time_ns = round(1e9 * stamp)
            camera.append(time_ns, jpeg.encode(frame, 90), time_host=time_ns + _T0_NS)
    return Path(path)


def sweep_frames(
    sweep: SimulatedSweep, *, seed: int = 0, marker: MarkerSettings | None = None
) -> Iterator[tuple[float, UInt8Array]]:
    """Render what the camera sees of a sweep; missing frames are left out.

    Parameters
    ----------
    sweep : SimulatedSweep
    seed : int, optional
        Of the noise, and of which frames are missing.
    marker : MarkerSettings, optional

    Yields
    ------
    float
        The frame's stamp, seconds.
    (H, W, 3) uint8
        RGB.
    """
    settings, printed = sweep.settings, marker or MarkerSettings()
    stamps = np.arange(round(settings.seconds * settings.frames_per_s)) / settings.frames_per_s
    rng = np.random.default_rng((seed, 72))
    picture = _print(printed)
    noise = _NOISE * rng.standard_normal((CAMERA.height, CAMERA.width), np.float32)
    for stamp in stamps[rng.random(len(stamps)) >= settings.missing].tolist():
        corners = _corners(sweep, stamp, printed)
        moved = np.roll(noise, rng.integers(0, 300, 2), (0, 1))
        yield stamp, _frame(picture, corners, moved)


def write_sweep_clip(
    path: str | os.PathLike[str],
    settings: SweepSettings,
    *,
    seed: int = 0,
    marker: MarkerSettings | None = None,
) -> Path:
    """Write the video of a simulated sweep: a clip of a camera without a gyroscope.

    Parameters
    ----------
    path : path-like
        ``<something>.mp4``.
    settings : SweepSettings
        `noise_m` is not used: the frames have noise of their own.
    seed : int, optional
    marker : MarkerSettings, optional

    Returns
    -------
    pathlib.Path
    """
    import av

    rate = Fraction(settings.frames_per_s).limit_denominator(1001)
    with av.open(os.fspath(path), "w", format="mp4") as container:
        video = container.add_stream("mpeg4", rate=rate)
        video.width, video.height, video.pix_fmt = CAMERA.width, CAMERA.height, "yuv420p"
        video.bit_rate = _BITS_PER_S
        sweep = SimulatedSweep(settings, seed)
        for stamp, pixels in sweep_frames(sweep, seed=seed, marker=marker):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = round(stamp * rate), 1 / rate
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    return Path(path)


def _clock(stamp_point: str) -> Clock:
    return Clock.model_validate(
        {
            "source": "hub_monotonic",
            "stamp_point": stamp_point,
            "t_ref_ns": _T0_NS,
            "raw_time": "time_host",
        }
    )


def _print(marker: MarkerSettings) -> UInt8Array:
    """Return the marker as it is printed, with its white edge."""
    own = cv2.aruco.generateImageMarker(marker.patterns, marker.number, _PRINT_PX)
    padded = np.pad(np.asarray(own, np.uint8), _EDGE_PX, constant_values=225)
    return padded.clip(25, 225)


def _corners(sweep: SimulatedSweep, stamp_s: float, marker: MarkerSettings) -> Float64Array:
    """Return where the print's corners appear: column and row, by when their rows are exposed."""
    settings = sweep.settings
    half = 0.5 * marker.side_m * (1.0 + 2.0 * _EDGE_PX / _PRINT_PX)
    square = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    row = 0.5
    pixels = np.zeros((4, 2))
    for _ in range(2):  # the row follows from the moment, the moment from the row
        moment = stamp_s + 0.5 * settings.exposure_s + settings.readout_s * row
        seen = sweep.place_m(np.array([moment]), square)
        pixels = (seen / seen[:, 2:]) @ matrix(CAMERA).T
        row = float(pixels[:, 1].mean()) / (CAMERA.height - 1)
    return pixels[:, :2]


def _frame(picture: UInt8Array, corners: Float64Array, noise: NDArray[np.float32]) -> UInt8Array:
    size = len(picture)
    own = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32) - 0.5
    turn = cv2.getPerspectiveTransform(own, corners.astype(np.float32))
    across = (CAMERA.width, CAMERA.height)
    frame = np.full((CAMERA.height, CAMERA.width), 140, np.uint8)
    cv2.warpPerspective(
        picture, turn, across, dst=frame, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_TRANSPARENT
    )
    grey = np.clip(frame + noise, 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)
