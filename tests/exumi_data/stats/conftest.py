"""Tiny episodes whose numbers can be worked out by hand."""

import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

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

MS = 1_000_000
MEASURED = Clock(source="hub", stamp_point="user_rx")

WriteEpisode = Callable[..., Path]


def _metadata(fields: dict[str, Any]) -> EpisodeMetadata:
    given = {
        "id": str(uuid.uuid4()),
        "task": Task(name="test"),
        "regime": "play",
        "licence": "CC0-1.0",
        "source": Source(type="simulated", tool="test", tool_version="1"),
    }
    return EpisodeMetadata(**{**given, **fields})


def _add(writer: EpisodeWriter, name: str, times_ms: list[int], spec: dict[str, Any]) -> None:
    kind = spec.pop("kind")
    activity = spec.pop("activity", None)
    above = spec.pop("above", 0.1)
    time = np.array(times_ms, np.int64) * MS
    clock = spec.pop("clock", MEASURED)
    if kind in ("tactile", "rgb"):
        spec["images"] = ArrayImages(encoding="array", height=4, width=4, channels=1)
        data: Any = np.zeros((len(time), 4, 4, 1), np.uint8)
    elif kind == "pose":
        spec["frames"] = Frames(parent="world", child="tcp")
        data = np.tile([0, 0, 0, 0, 0, 0, 1.0], (len(time), 1))
    else:
        data = np.zeros(len(time), np.float32)
    writer.add_stream(name, kind=kind, clock=clock, **spec).append(time, data)
    if activity is not None:
        writer.add_derived(
            name,
            "activity",
            np.array(activity, np.float32),
            algorithm="test/1",
            parameters={"active_above": above},
        )


@pytest.fixture
def write_episode(tmp_path: Path) -> WriteEpisode:
    """Write an episode: streams by name, each (times in ms, fields); other fields of metadata."""

    def write(
        streams: dict[str, tuple[list[int], dict[str, Any]]],
        *,
        folder: Path | None = None,
        **fields: Any,
    ) -> Path:
        metadata = _metadata(fields)
        path = (folder or tmp_path) / episode_path(metadata.id)
        with EpisodeWriter(path, metadata, durable=False) as writer:
            for name, (times_ms, spec) in streams.items():
                _add(writer, name, times_ms, dict(spec))
        return path

    return write


@pytest.fixture
def small_dataset(tmp_path: Path, write_episode: WriteEpisode) -> Dataset:
    """Three episodes of 1 s: two of play with labels, one touch clip with a quality note."""
    root = create_dataset(tmp_path / "ds", DatasetMetadata(name="ds", licence="CC0-1.0"))
    every_100 = list(range(0, 1001, 100))
    tactile = {"kind": "tactile", "activity": [0.0] * 6 + [1.0] * 5}
    for part, hardness in (("egg", 3.0), ("rice", 7.5)):
        write_episode(
            {"tactile": (every_100, tactile), "pose": (every_100, {"kind": "pose"})},
            folder=root,
            annotations=Annotations(
                object_id=part,
                part_id=part,
                labels=[
                    Label(property="hardness", value=hardness, scale=[0, 10], provenance="human"),
                    Label(property="words", value=["smooth", part], provenance="model"),
                ],
            ),
        )
    write_episode(
        {"tactile": (every_100, {"kind": "tactile"})},
        folder=root,
        regime="touch",
        licence="CC-BY-4.0",
        quality=[QualityNote(code="truncated", message="ends early")],
    )
    write_catalog(root, build_catalog(root)[0])
    return open_dataset(root)
