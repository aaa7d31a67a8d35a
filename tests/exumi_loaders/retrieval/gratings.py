"""A dataset of gratings pressed into a gel: each part has a period of its own."""

import uuid
from pathlib import Path

import numpy as np

import exumi_data
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import (
    Annotations,
    ArrayImages,
    Clock,
    DatasetMetadata,
    EpisodeMetadata,
    Label,
    Source,
    Task,
)
from exumi_data.model.dataset import SplitDocument
from exumi_data.model.documents import dump
from exumi_data.model.streams import Sensor

SIDE = 32
FRAMES = 3
REST = np.full((SIDE, SIDE, 1), 120, np.uint8)
PERIODS = (3, 5, 8, 13, 21, 34)
CLIPS = 3


def pressed(period: int, seed: int) -> np.ndarray:
    """Frames (FRAMES, SIDE, SIDE, 1) of a grating with that period, somewhere else each time."""
    random = np.random.default_rng(seed)
    x = np.arange(SIDE) + random.integers(0, period, (FRAMES, 1, 1))
    wave = 120 + (30 + 3 * random.random()) * np.sin(2 * np.pi * x / period)
    noisy = wave + random.normal(0, 1.5, (FRAMES, SIDE, SIDE))
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)[..., None]


def grating_id(part: int, trial: int) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"grating-{part}-{trial}"))


def _write(root: Path, part: int, trial: int) -> None:
    episode_id = grating_id(part, trial)
    ratings = [
        Label(property="hardness", value=float(part), scale=[0.0, 10.0], provenance="human"),
        Label(property="roughness", value=float(9 - part), scale=[0.0, 10.0], provenance="human"),
        Label(property="adjectives", value=["ribbed", f"p{PERIODS[part]}"], provenance="human"),
    ]
    metadata = EpisodeMetadata(
        id=episode_id,
        task=Task(name="touch"),
        regime="touch",
        licence="CC0-1.0",
        source=Source(type="simulated", tool="tests", tool_version="1"),
        annotations=Annotations(
            object_id=f"object_{part // 2}",
            object=f"a comb {part // 2}",
            part_id=f"part_{part}",
            trial=trial,
            pad_type="plain",
            labels=ratings,
        ),
    )
    path = root / episode_path(episode_id)
    with exumi_data.EpisodeWriter(path, metadata, durable=False) as writer:
        stream = writer.add_stream(
            "tactile",
            kind="tactile",
            clock=Clock(source="test", stamp_point="simulated"),
            images=ArrayImages(encoding="array", height=SIDE, width=SIDE, channels=1),
            sensor=Sensor(model="gelsight-mini"),
        )
        stream.append(np.arange(FRAMES) * 40_000_000, pressed(PERIODS[part], 10 * part + trial))
        stream.set_reference(REST, method="captured")
        writer.add_derived(
            "tactile",
            "salient",
            np.arange(FRAMES),
            algorithm="octopi-salience/1",
            parameters={"k": 10},
        )


def write_gratings(root: Path) -> Path:
    """Write a dataset of 6 parts with 3 clips each; the split ``mine`` keeps one clip for test."""
    import json

    create_dataset(root, DatasetMetadata(name="gratings", licence="CC0-1.0", splits=["mine"]))
    numbers = [(part, trial) for part in range(len(PERIODS)) for trial in range(CLIPS)]
    for part, trial in numbers:
        _write(root, part, trial)
    lists = {
        "train": [grating_id(part, trial) for part, trial in numbers if trial],
        "test": [grating_id(part, trial) for part, trial in numbers if not trial],
    }
    split = SplitDocument(name="mine", level="episode", method="first trial", lists=lists)
    (root / "splits").mkdir()
    (root / "splits" / "mine.json").write_text(json.dumps(dump(split)))
    table, failed = build_catalog(root)
    assert not failed
    write_catalog(root, table)
    return root
