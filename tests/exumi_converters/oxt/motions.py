"""Episodes whose values say at what time they were: what a timeline is judged by."""

import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data import EpisodeWriter
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import (
    ArrayImages,
    Clock,
    DatasetMetadata,
    EpisodeMetadata,
    Frames,
    Sensor,
    Source,
    Task,
)
from exumi_data.standard import flags

__all__ = ["NS", "SIZE", "motion", "write_motion", "write_motions"]

NS = 1_000_000_000
SIZE = 8
_CLOCK = Clock(source="hub_monotonic", stamp_point="kernel_rx")


def times(rate: float, stop: float, start: float = 0.0) -> np.ndarray:
    """Times from start to stop, ns."""
    return np.round(np.arange(start, stop, 1 / rate) * NS).astype(np.int64)


def motion(time_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the gripper is, (n, 7), and how wide, (n,): smooth, and turning far."""
    t = time_ns / NS
    angle = 2.5 * np.sin(1.3 * t) + 0.4
    poses = np.zeros((len(t), 7))
    poses[:, 0], poses[:, 1] = 0.2 * np.sin(2 * t), 0.1 * t
    poses[:, 5], poses[:, 6] = np.sin(angle / 2), np.cos(angle / 2)
    return poses, (0.04 + 0.03 * np.sin(3 * t)).astype(np.float32)


def numbered(time: np.ndarray, channels: int) -> np.ndarray:
    """Frames that bear their own numbers."""
    number = np.arange(len(time), dtype=np.uint8)
    return np.broadcast_to(number[:, None, None, None], (len(time), SIZE, SIZE, channels)).copy()


def write_motion(
    path: Path,
    *,
    number: int = 0,
    seconds: float = 2.0,
    task: str = "turn",
    instruction: str | None = "turn it",
    camera: np.ndarray | None = None,
    pads: dict[str, Any] | None = None,
    keep: Callable[[np.ndarray], np.ndarray] = lambda time: np.ones(len(time), bool),
    invalid: Callable[[np.ndarray], np.ndarray] = lambda time: np.zeros(len(time), bool),
    with_pose: bool = True,
    with_width: bool = True,
    channels: int = 3,
    nan_at: tuple[int, ...] = (),
) -> Path:
    """Write one episode: camera 30 Hz, two pads 25 Hz, pose 90 Hz, width 200 Hz.

    Parameters
    ----------
    path : pathlib.Path
    number : int
        Makes the id.
    seconds : float
    task, instruction : str
    camera : (n,) int64, optional
        Times of the camera's frames.
    pads : dict, optional
        Name of each tactile stream to its sensor's side.
    keep, invalid : callable
        Which samples of the pose there are, and which are flagged invalid, by time.
    with_pose, with_width : bool
    channels : int
        Of the pads' images.
    nan_at : tuple of int
        Samples of the pose that are no numbers.
    """
    metadata = EpisodeMetadata(
        id=str(uuid.uuid5(uuid.NAMESPACE_URL, f"motion-{number}")),
        start=None,
        task=Task(name=task, instruction=instruction),
        regime="demonstration",
        licence="CC-BY-4.0",
        source=Source(type="simulated", tool="tests", tool_version="1"),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, metadata, durable=False) as writer:
        if camera is None:
            camera = times(30.0, seconds)
        _add_frames(writer, "rgb", "rgb", camera, 3, None)
        fingers: dict[str, Any] = {"tactile_left": "left", "tactile_right": "right"}
        sides = fingers if pads is None else pads
        for name, side in sides.items():
            sensor = Sensor(model="gelsight-mini", side=side)
            _add_frames(writer, name, "tactile", times(25.0, seconds, 0.003), channels, sensor)
        time = times(90.0, seconds, 0.001)
        time = time[keep(time)]
        if with_pose:
            frames = Frames(parent="world", child="tcp")
            pose = writer.add_stream("pose", kind="pose", clock=_CLOCK, frames=frames)
            bits = np.where(invalid(time), flags()["invalid"].mask, 0).astype(np.uint32)
            values = motion(time)[0]
            values[list(nan_at)] = np.nan
            pose.append(time, values, **({"flags": bits} if bits.any() else {}))
        if with_width:
            time = times(200.0, seconds)
            writer.add_stream("width", kind="width", clock=_CLOCK).append(time, motion(time)[1])
    return path


def _add_frames(
    writer: EpisodeWriter,
    name: str,
    kind: str,
    time: np.ndarray,
    channels: int,
    sensor: Sensor | None,
) -> None:
    images = ArrayImages(encoding="array", height=SIZE, width=SIZE, channels=channels)  # type: ignore[arg-type]  # 1 or 3
    fields: dict[str, Any] = {} if sensor is None else {"sensor": sensor}
    stream = writer.add_stream(name, kind=kind, clock=_CLOCK, images=images, **fields)
    stream.append(time, numbered(time, channels))
    if kind == "tactile":
        writer.add_derived(
            name,
            "activity",
            np.zeros(len(time), np.float32),
            algorithm="exumi-activity/1",
            parameters={"threshold": 5.83, "size": SIZE, "active_above": 1e-3},
            inputs=[f"streams/{name}/data"],
        )


def write_motions(root: Path, *given: dict[str, Any]) -> Path:
    """Write a dataset of such episodes."""
    create_dataset(root, DatasetMetadata(name=root.name, licence="CC-BY-4.0"))
    for number, fields in enumerate(given):
        name = str(uuid.uuid5(uuid.NAMESPACE_URL, f"motion-{number}"))
        write_motion(root / episode_path(name), number=number, **fields)
    write_catalog(root, build_catalog(root)[0])
    return root
