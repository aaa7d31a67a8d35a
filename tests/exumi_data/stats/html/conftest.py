"""A small dataset of two fingers whose touches are known, and whose names are hostile."""

import uuid
from pathlib import Path

import numpy as np
import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import Dataset, create_dataset, open_dataset
from exumi_data.model import (
    Annotations,
    ArrayImages,
    Clock,
    DatasetMetadata,
    EpisodeMetadata,
    Frames,
    Label,
    QualityNote,
    Source,
    Task,
)
from exumi_data.store.episode_writer import EpisodeWriter

HOSTILE = "<script>alert('x')</script>\" onload=\"y"
FRAMES = 8
HEIGHT, WIDTH = 64, 96
PERIOD_NS = 100_000_000
CLOCK = Clock(
    source="hub",
    stamp_point="user_rx",
    latency_ns=30_000_000,
    latency_sigma_ns=2e6,
    raw_time="time_host",
    method="grasps: of one episode",
)


def pressed(amount: float, *, left: bool) -> np.ndarray:
    """A grey gel that is pressed at its left or its right, (H, W, 1) uint8."""
    frame = np.full((HEIGHT, WIDTH, 1), 100, np.uint8)
    columns = slice(8, 32) if left else slice(64, 88)
    frame[20:44, columns] += np.uint8(amount)
    return frame


def write_touch(root: Path, number: int, *, activity: bool = True, reference: bool = True) -> Path:
    """Write an episode: both fingers touched in its second half, most in its last frame."""
    meta = EpisodeMetadata(
        id=str(uuid.uuid5(uuid.NAMESPACE_OID, f"page {number}")),
        task=Task(name=HOSTILE if number == 0 else f"task {number}", instruction=HOSTILE),
        regime="play",
        licence="CC0-1.0",
        source=Source(type="simulated", tool="test", tool_version="1"),
        annotations=Annotations(
            object_id=HOSTILE,
            labels=[
                Label(property="hardness", value=2.0 + number, scale=[0, 10], provenance="human"),
                Label(property="feel", value=["smooth", HOSTILE], provenance="model"),
            ],
        ),
        quality=[QualityNote(code=HOSTILE, message="told")],
    )
    path = root / episode_path(meta.id)
    time = np.arange(FRAMES, dtype=np.int64) * PERIOD_NS
    amounts = np.array([0, 0, 0, 0, 10, 20, 30, 40.0])
    host = {"time_host": time + CLOCK.latency_ns}
    with EpisodeWriter(path, meta, durable=False) as writer:
        images = ArrayImages(encoding="array", height=HEIGHT, width=WIDTH, channels=1)
        for name in ("tactile_left", "tactile_right"):
            frames = np.stack([pressed(a, left=name == "tactile_left") for a in amounts])
            stream = writer.add_stream(name, kind="tactile", clock=CLOCK, images=images)
            stream.append(time, frames, **host)
            if reference:
                stream.set_reference(pressed(0, left=True), method="captured")
            if activity:
                share = np.where(amounts > 0, 0.09 + amounts / 1000, 0).astype(np.float32)
                writer.add_derived(
                    name, "activity", share, algorithm="test/1", parameters={"active_above": 1e-3}
                )
        rgb = writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=images)
        rgb.append(time, np.stack([pressed(0, left=True)] * FRAMES), **host)
        width = writer.add_stream("width", kind="width", clock=CLOCK)
        width.append(
            time, np.array([0, 0.01, 0.01, 0.02, 0.02, 0.02, 0.08, np.nan], np.float32), **host
        )
        pose = writer.add_stream(
            "pose", kind="pose", clock=CLOCK, frames=Frames(parent="world", child="tcp")
        )
        poses = np.zeros((FRAMES, 7))
        poses[:, 0], poses[:, 2], poses[:, 6] = np.arange(FRAMES) * 0.05 + 0.005, 0.305, 1
        invalid = np.zeros(FRAMES, np.uint32)
        invalid[-1] = 1 << 3
        pose.append(time, poses, flags=invalid, **host)
        force = writer.add_stream("force", kind="wrench", clock=CLOCK, components=["fz", "tz"])
        force.append(time, np.stack([amounts, amounts / 100], axis=1).astype(np.float32), **host)
    return path


@pytest.fixture(scope="session")
def touched(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three such episodes; nobody changes them."""
    root = create_dataset(
        tmp_path_factory.mktemp("page") / "ds",
        DatasetMetadata(name=HOSTILE, description=HOSTILE, authors=[HOSTILE], licence="CC0-1.0"),
    )
    for number in range(3):
        write_touch(root, number)
    write_catalog(root, build_catalog(root)[0])
    return open_dataset(root)
