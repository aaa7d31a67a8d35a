"""The program, started as users start it, and small data for it."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import (
    Annotations,
    Clock,
    DatasetMetadata,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Label,
    LossyStep,
    QualityNote,
    Source,
    Task,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter

Program = Callable[..., subprocess.CompletedProcess[str]]

IDS = ("0190a1b2-4c5d-7e8f-9a0b-1c2d3e4f5001", "0190a1b2-4c5d-7e8f-9a0b-1c2d3e4f5002")


@pytest.fixture(scope="session")
def plain_environment() -> dict[str, str]:
    """The environment, without what changes how programs print."""
    loud = ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "TERM", "EXUMI_DEBUG", "GITHUB_ACTIONS")
    return {key: value for key, value in os.environ.items() if key not in loud}


@pytest.fixture(scope="session")
def exumi(plain_environment: dict[str, str]) -> Program:
    """Run the program in a process of its own, away from any terminal."""

    def run(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "exumi_data.cli", *map(str, arguments)],
            check=False,
            capture_output=True,
            text=True,
            timeout=120,
            env={**plain_environment, **environment},
            stdin=subprocess.DEVNULL,
        )

    return run


def write_small_episode(path: Path, episode_id: str, *, frames: int = 6) -> Path:
    """Write an episode with a tactile stream of JPEGs, and poses."""
    metadata = EpisodeMetadata(
        id=episode_id,
        task=Task(name="feel [it]"),
        regime="touch",
        licence="CC0-1.0",
        annotations=Annotations(
            object_id="egg",
            labels=[
                Label(property="hardness", value=3.5, scale=[0, 10], raters=3, provenance="human")
            ],
        ),
        source=Source(
            type="simulated",
            tool="test",
            tool_version="1",
            lossy=[LossyStep(step="jpeg", stream="tactile", detail="quality 95")],
        ),
        quality=[QualityNote(code="short", message="only [a few] frames", stream="tactile")],
    )
    clock = Clock(source="hub_monotonic", stamp_point="kernel_rx")
    images = EncodedImages(
        encoding="encoded", media_type="image/jpeg", height=48, width=64, channels=3
    )
    random = np.random.default_rng(5)
    time = np.arange(frames) * 40_000_000
    with EpisodeWriter(path, metadata, durable=False) as writer:
        tactile = writer.add_stream("tactile", kind="tactile", clock=clock, images=images)
        for stamp in time:
            frame = random.integers(80, 100, (48, 64, 3)).astype(np.uint8)
            tactile.append(int(stamp), jpeg.encode(frame, 95))
        tactile.set_reference(np.full((48, 64, 3), 90, np.uint8), method="captured")
        pose = writer.add_stream(
            "pose", kind="pose", clock=clock, frames=Frames(parent="world", child="tcp")
        )
        pose.append(time, np.tile([0, 0, 0, 0, 0, 0, 1.0], (frames, 1)))
        writer.add_derived(
            "tactile",
            "activity",
            np.linspace(0, 0.01, frames).astype(np.float32),
            algorithm="exumi-activity/1",
            parameters={"threshold": 5.83, "size": 224, "active_above": 1e-3},
            inputs=["streams/tactile/data", "streams/tactile/reference"],
        )
    return path


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """A dataset of two episodes, with its catalog."""
    root = create_dataset(
        tmp_path / "my-dataset", DatasetMetadata(name="my-dataset", licence="CC0-1.0")
    )
    for episode_id in IDS:
        write_small_episode(root / episode_path(episode_id), episode_id)
    write_catalog(root, build_catalog(root)[0])
    return root


@pytest.fixture
def episode(dataset: Path) -> Path:
    """The folder of one episode."""
    return dataset / episode_path(IDS[0])
