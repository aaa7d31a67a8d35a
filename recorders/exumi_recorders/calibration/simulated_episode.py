"""A simulated sweep written as an episode, with frames in which the marker really is."""

from __future__ import annotations

import os
import uuid
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from exumi_data._version import __version__
from exumi_data.calibration import add_intrinsics
from exumi_data.camera import matrix
from exumi_data.model import (
    Clock,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Source,
    Task,
)
from exumi_data.model.calibration import Intrinsics
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_recorders.calibration.markers import MarkerSettings
from exumi_recorders.calibration.simulated_sweep import SimulatedSweep, SweepSettings

__all__ = ["write_sweep_episode"]

UInt8Array = NDArray[np.uint8]
Float64Array = NDArray[np.float64]

_CAMERA = Intrinsics(model="pinhole", width=480, height=360, fx=330.0, fy=330.0, cx=239.5, cy=179.5)
_T0_NS = 1_000_000_000
_PRINT_PX = 120
_EDGE_PX = 20
_NOISE = 2.0
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
                height=_CAMERA.height,
                width=_CAMERA.width,
                channels=3,
            ),
        )
        add_intrinsics(writer, "rgb", _CAMERA, method="known: it is the simulator's own")
        stamps = np.arange(round(settings.seconds * settings.frames_per_s)) / settings.frames_per_s
        rng = np.random.default_rng((seed, 72))
        picture = _print(printed)
        noise = _NOISE * rng.standard_normal((_CAMERA.height, _CAMERA.width), np.float32)
        for stamp in stamps[rng.random(len(stamps)) >= settings.missing].tolist():
            time_ns = round(1e9 * stamp)
            corners = _corners(sweep, stamp, printed)
            frame = _frame(picture, corners, np.roll(noise, rng.integers(0, 300, 2), (0, 1)))
            camera.append(time_ns, jpeg.encode(frame, 90), time_host=time_ns + _T0_NS)
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
        pixels = (seen / seen[:, 2:]) @ matrix(_CAMERA).T
        row = float(pixels[:, 1].mean()) / (_CAMERA.height - 1)
    return pixels[:, :2]


def _frame(picture: UInt8Array, corners: Float64Array, noise: NDArray[np.float32]) -> UInt8Array:
    size = len(picture)
    own = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32) - 0.5
    turn = cv2.getPerspectiveTransform(own, corners.astype(np.float32))
    across = (_CAMERA.width, _CAMERA.height)
    frame = np.full((_CAMERA.height, _CAMERA.width), 140, np.uint8)
    cv2.warpPerspective(
        picture, turn, across, dst=frame, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_TRANSPARENT
    )
    grey = np.clip(frame + noise, 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)
