"""Small episodes of a gripper, with known truth, that are written as replay buffers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import (
    Annotations,
    ArrayImages,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    EncodedImages,
    Frames,
    Gap,
    QualityNote,
    RawData,
    Sensor,
    Task,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_converters.umi.buffers import gel, smooth
from tests.exumi_data.builders import episode_id, metadata

__all__ = [
    "CLOCK",
    "EVERYTHING",
    "FRAMES",
    "PERIOD_NS",
    "add_camera",
    "add_gripper",
    "add_tactile",
    "dataset_of",
    "frame_times",
    "motion",
    "write_everything",
]

CLOCK = Clock(source="hub_monotonic", stamp_point="kernel_rx")
FRAMES = 20
PERIOD_NS = 16_683_333
HEIGHT, WIDTH = 40, 60


def frame_times(count: int = FRAMES) -> np.ndarray:
    """Times of the camera's frames."""
    return 1_000_000_000 + np.arange(count, dtype=np.int64) * PERIOD_NS


def motion(time_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, rotation and width at any time: straight, turning evenly, closing evenly."""
    t = (np.asarray(time_ns) - 1_000_000_000) / 1e9
    position = np.stack([0.3 * t, 0.1 - 0.2 * t, 0.5 + 0.1 * t], axis=-1)
    rotation = Rotation.from_rotvec(np.stack([0 * t, 2.5 + 6 * t, 0 * t], axis=-1)).as_quat()
    return position, np.asarray(rotation), 0.08 - 0.1 * t


def add_gripper(writer: EpisodeWriter, suffix: str = "", *, hole: bool = False) -> None:
    """Add a pose at 120 Hz and a width at 90 Hz, from before the first frame to after the last."""
    end = int(frame_times()[-1]) + 50_000_000
    for kind, rate in (("pose", 120), ("width", 90)):
        time = np.arange(950_000_000, end, 1_000_000_000 // rate, dtype=np.int64)
        if hole:
            time = time[(time < 1_050_000_000) | (time > 1_200_000_000)]
        position, rotation, width = motion(time)
        fields = {"frames": Frames(parent="world", child="tcp")} if kind == "pose" else {}
        stream = writer.add_stream(f"{kind}{suffix}", kind=kind, clock=CLOCK, **fields)
        stream.append(time, np.hstack([position, rotation]) if kind == "pose" else width)


def add_camera(
    writer: EpisodeWriter, name: str = "rgb", *, seed: int = 0, keep: Any = None, **fields: Any
) -> np.ndarray:
    """Add a camera of 60x40 pixels; return its frames."""
    keep = np.arange(FRAMES) if keep is None else keep
    pictures = np.asarray(smooth(np.random.default_rng(seed), FRAMES, WIDTH)[:, :HEIGHT][keep])
    images = ArrayImages(encoding="array", height=HEIGHT, width=WIDTH, channels=3)
    stream = writer.add_stream(name, kind="rgb", clock=CLOCK, images=images, **fields)
    stream.append(frame_times()[keep], pictures)
    return pictures


def add_tactile(writer: EpisodeWriter, *, reference: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Add a left and a right finger at half the camera's rate; return their grey frames."""
    found = []
    for number, side in enumerate(("left", "right")):
        frames = gel(FRAMES // 2, 32, depth=60 - 20 * number)
        images = ArrayImages(encoding="array", height=32, width=32, channels=1)
        stream = writer.add_stream(
            f"tactile_{side}", kind="tactile", clock=CLOCK, images=images, sensor=_sensor(side)
        )
        stream.append(frame_times()[::2] + 1_000_000, frames[..., None])
        if reference:
            stream.set_reference(frames[0][..., None], method="captured", contact_free=True)
        found.append(frames)
    return found[0], found[1]


def _sensor(side: Any) -> Sensor:
    return Sensor(model="9dtact", side=side)


def dataset_of(root: Path, *write: Callable[[EpisodeWriter], object], **changes: Any) -> Path:
    """Write a dataset; each function adds the streams of one episode."""
    create_dataset(root, DatasetMetadata(name="grasps", licence="CC0-1.0"))
    described = {"regime": "demonstration", **changes}
    for number, add in enumerate(write):
        path = root / episode_path(episode_id(number))
        with EpisodeWriter(path, metadata(number, **described), durable=False) as writer:
            add(writer)
    table, failed = build_catalog(root)
    assert not failed
    write_catalog(root, table)
    return root


def write_everything(writer: EpisodeWriter) -> None:
    """Add streams that have whatever a replay buffer cannot keep."""
    end = int(frame_times()[-1]) + 20_000_000
    time = np.arange(980_000_000, end, 10_000_000, dtype=np.int64)
    position, rotation, width = motion(time)
    pose = writer.add_stream(
        "arm", kind="pose", clock=CLOCK, frames=Frames(parent="base", child="tcp")
    )
    pose.append(
        time,
        np.hstack([position, rotation]),
        flags=np.zeros(len(time), np.uint32),
        sequence=np.arange(len(time), dtype=np.uint64),
        time_host=time + 5,
    )
    counts = RawData(unit="count", transform="encoder")
    opening = writer.add_stream("width", kind="width", clock=CLOCK, raw=counts)
    opening.append(time, width, raw=np.arange(len(time), dtype=np.uint16))
    images = EncodedImages(
        encoding="encoded", media_type="image/jpeg", height=HEIGHT, width=WIDTH, channels=3
    )
    rgb = writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=images, gaps=[Gap(after=-1)])
    pictures = smooth(np.random.default_rng(1), FRAMES, WIDTH)[:, :HEIGHT]
    rgb.append(frame_times(), [jpeg.encode(frame, 90) for frame in pictures])
    grey = gel(FRAMES, 32)[..., None]
    tactile = writer.add_stream(
        "tactile_combined",
        kind="tactile",
        clock=CLOCK,
        images=ArrayImages(encoding="array", height=32, width=32, channels=1),
        sensor=Sensor(model="9dtact"),
    )
    tactile.append(frame_times(), grey)
    tactile.set_reference(grey[1], method="captured", contact_free=True)
    force = writer.add_stream("force", kind="wrench", clock=CLOCK, components=["f_grip"])
    force.append(time, np.zeros((len(time), 1), np.float32))
    activity = np.linspace(0, 0.02, FRAMES, dtype=np.float32)
    writer.add_derived("tactile_combined", "activity", activity, algorithm="exumi-activity/1")


EVERYTHING: dict[str, Any] = {
    "start": "2026-01-02T03:04:05Z",
    "task": Task(name="stack", instruction="Stack the cups."),
    "success": True,
    "operator": "p1",
    "annotations": Annotations(object_id="cup"),
    "calibration": {"encoder": CalibrationItem(value=1.0, method="made up")},
    "quality": [QualityNote(code="odd", message="something is odd")],
}
