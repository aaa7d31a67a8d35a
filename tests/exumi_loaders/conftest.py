"""Small datasets whose frames tell their own index."""

import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exumi_data
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import (
    Annotations,
    ArrayImages,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Label,
    Sensor,
    Source,
    Task,
)
from exumi_data.store import jpeg

SIDE = 8
CLOCK = Clock(source="test", stamp_point="simulated")


@dataclass
class Recipe:
    """What one episode of a test dataset holds. Times in seconds."""

    tactile_s: Sequence[float] | None = None
    tactile: str = "tactile"
    rgb_s: Sequence[float] | None = None
    pose_s: Sequence[float] | None = None
    width_s: Sequence[float] | None = None
    activity: Sequence[float] | None = None
    part: str | None = None
    object: str | None = None
    encoded: bool = False
    channels: int = 1
    side: int = SIDE
    poses: Any = None
    """(N, 7), or by the name of the stream."""
    extra: dict[str, Sequence[float]] = field(default_factory=dict)
    extra_rgb: dict[str, Sequence[float]] = field(default_factory=dict)
    headset: bool = False
    """Whether the headset's own poses are there, too."""
    grippers: dict[str, float] = field(default_factory=dict)
    """Of each side: how far its poses lie beside the known motion, metres."""
    parents: dict[str, str] = field(default_factory=dict)
    child: str = "tcp"
    calibration: dict[str, Any] = field(default_factory=dict)
    """Values of calibration items."""
    active_above: float | None = None
    revision: int = 1
    shift: int = 0
    """Added to all pixels."""


def numbered(count: int, channels: int = 1, side: int = SIDE) -> np.ndarray:
    """Frames that are filled with their own index."""
    values = np.arange(count, dtype=np.uint8)
    return np.broadcast_to(values[:, None, None, None], (count, side, side, channels)).copy()


def nanoseconds(seconds: Sequence[float]) -> np.ndarray:
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def smooth_poses(seconds: Sequence[float] | np.ndarray) -> np.ndarray:
    """A motion that is known at any time."""
    from scipy.spatial.transform import Rotation

    time = np.asarray(seconds)
    position = np.stack((0.1 * time, 0.2 * np.sin(time), 0.05 * time), axis=1)
    turn = Rotation.from_rotvec(np.stack((0.3 * time, 0 * time, 0.1 * time), axis=1))
    return np.concatenate((position, turn.as_quat()), axis=1)


def width_m(seconds: Sequence[float] | np.ndarray) -> np.ndarray:
    return 0.05 + 0.01 * np.asarray(seconds)


def _images(writer: Any, name: str, kind: str, seconds: Sequence[float], recipe: Recipe) -> None:
    frames = numbered(len(seconds), recipe.channels, recipe.side) + np.uint8(recipe.shift)
    size: Any = {"height": recipe.side, "width": recipe.side, "channels": recipe.channels}
    if recipe.encoded:
        images: Any = EncodedImages(encoding="encoded", media_type="image/jpeg", **size)
    else:
        images = ArrayImages(encoding="array", **size)
    stream = writer.add_stream(name, kind=kind, clock=CLOCK, images=images)
    values = [jpeg.encode(frame, 95) for frame in frames] if recipe.encoded else frames
    stream.append(nanoseconds(seconds), values)
    if kind == "tactile":
        shape = (recipe.side, recipe.side, recipe.channels)
        stream.set_reference(np.full(shape, 7, np.uint8), method="captured")


def write_episode(root: Path, number: int, recipe: Recipe) -> str:
    episode_id = str(uuid.uuid5(uuid.NAMESPACE_OID, str(number)))
    metadata = EpisodeMetadata(
        id=episode_id,
        revision=recipe.revision,
        task=Task(name="test"),
        regime="play",
        licence="CC0-1.0",
        source=Source(type="simulated", tool="tests", tool_version="1"),
        calibration={
            name: CalibrationItem(value=value, method="known")
            for name, value in recipe.calibration.items()
        },
        annotations=Annotations(part_id=recipe.part, object_id=recipe.object),
    )
    with exumi_data.EpisodeWriter(
        root / episode_path(episode_id), metadata, overwrite=True, durable=False
    ) as writer:
        if recipe.tactile_s is not None:
            _images(writer, recipe.tactile, "tactile", recipe.tactile_s, recipe)
            if recipe.activity is not None:
                values = np.asarray(recipe.activity, dtype=np.float32)
                known = {} if recipe.active_above is None else {"active_above": recipe.active_above}
                writer.add_derived(
                    recipe.tactile, "activity", values, algorithm="test/1", parameters=known
                )
        for name, seconds in recipe.extra.items():
            _images(writer, name, "tactile", seconds, recipe)
        if recipe.rgb_s is not None:
            _images(writer, "rgb", "rgb", recipe.rgb_s, recipe)
        for name, seconds in recipe.extra_rgb.items():
            _images(writer, name, "rgb", seconds, recipe)
        if recipe.headset and recipe.pose_s is not None:
            frames = Frames(parent="world", child="headset")
            head = writer.add_stream("headset", kind="pose", clock=CLOCK, frames=frames)
            head.append(nanoseconds(recipe.pose_s), smooth_poses(recipe.pose_s))
        for side, offset in (recipe.grippers or {"": 0.0}).items():
            _gripper(writer, f"_{side}" if side else "", offset, recipe)
    return episode_id


def _gripper(writer: Any, suffix: str, offset: float, recipe: Recipe) -> None:
    if recipe.pose_s is not None:
        name = f"pose{suffix}"
        frames = Frames(parent=recipe.parents.get(name, "world"), child=recipe.child)
        stream = writer.add_stream(name, kind="pose", clock=CLOCK, frames=frames)
        if isinstance(recipe.poses, dict):
            poses = recipe.poses[name]
        else:
            poses = smooth_poses(recipe.pose_s) if recipe.poses is None else recipe.poses
            poses = poses + np.array([offset, 0, 0, 0, 0, 0, 0])
        stream.append(nanoseconds(recipe.pose_s), poses)
    if recipe.width_s is not None:
        stream = writer.add_stream(f"width{suffix}", kind="width", clock=CLOCK)
        stream.append(nanoseconds(recipe.width_s), width_m(recipe.width_s) + offset / 10)


def write_dataset(root: Path, recipes: Sequence[Recipe]) -> exumi_data.Dataset:
    create_dataset(root, DatasetMetadata(name="test", licence="CC0-1.0"))
    for number, recipe in enumerate(recipes):
        write_episode(root, number, recipe)
    table, failed = build_catalog(root)
    assert not failed
    write_catalog(root, table)
    opened = exumi_data.open(root)
    assert isinstance(opened, exumi_data.Dataset)
    # Episodes lie in the order of their paths; tests want the order of their recipes.
    ids = [str(uuid.uuid5(uuid.NAMESPACE_OID, str(n))) for n in range(len(recipes))]
    return opened.select(ids)


MakeDataset = Callable[..., exumi_data.Dataset]


@pytest.fixture
def make_dataset(tmp_path: Path) -> MakeDataset:
    def make(*recipes: Recipe, name: str = "set") -> exumi_data.Dataset:
        return write_dataset(tmp_path / name, recipes)

    return make


@pytest.fixture
def recipe() -> type[Recipe]:
    return Recipe


@dataclass
class Touch:
    """A touch clip of a test dataset: frames of one brightness each."""

    part: str | None = None
    object: str | None = None
    brightness: Sequence[int] = (0, 3, 6, 9)
    labels: Sequence[Label] = ()
    sensor: str | None = "gelsight-mini"
    pad: Any = "plain"
    trial: int | None = None
    procedure: str | None = None
    stored: int | None = None
    salient: Sequence[int] | None = None
    streams: Sequence[str] = ("tactile",)
    side: int = SIDE
    channels: int = 1
    words: tuple[str | None, str | None] = (None, None)


def rated(**ratings: float) -> list[Label]:
    """Labels that persons gave, from 0 to 10."""
    return [
        Label(property=name, value=float(value), scale=[0.0, 10.0], provenance="human")
        for name, value in ratings.items()
    ]


def write_touch(root: Path, number: int, touch: Touch) -> str:
    episode_id = str(uuid.uuid5(uuid.NAMESPACE_OID, str(number)))
    metadata = EpisodeMetadata(
        id=episode_id,
        task=Task(name="touch"),
        regime="touch",
        licence="CC0-1.0",
        source=Source(type="simulated", tool="tests", tool_version="1"),
        annotations=Annotations(
            part_id=touch.part,
            object_id=touch.object,
            object=touch.words[0],
            part=touch.words[1],
            trial=touch.trial,
            procedure=touch.procedure,
            pad_type=touch.pad,
            labels=list(touch.labels) or None,
        ),
    )
    size: Any = {"height": touch.side, "width": touch.side, "channels": touch.channels}
    with exumi_data.EpisodeWriter(
        root / episode_path(episode_id), metadata, overwrite=True, durable=False
    ) as writer:
        for name in touch.streams:
            stream = writer.add_stream(
                name,
                kind="tactile",
                clock=CLOCK,
                images=ArrayImages(encoding="array", **size),
                sensor=None if touch.sensor is None else Sensor(model=touch.sensor),
            )
            shape = (touch.side, touch.side, touch.channels)
            frames = [np.full(shape, value, np.uint8) for value in touch.brightness]
            values = np.asarray(frames, np.uint8).reshape(-1, *shape)
            stream.append(np.arange(len(frames)) * 40_000_000, values)
            stream.set_reference(np.full(shape, 7, np.uint8), method="captured")
            if touch.stored is not None:
                last = range(max(len(frames) - touch.stored, 0), len(frames))
                writer.add_derived(
                    name,
                    "salient",
                    np.asarray(touch.salient or last, np.int64),
                    algorithm="octopi-salience/1",
                    parameters={"k": touch.stored},
                )
    return episode_id


@pytest.fixture
def make_touches(tmp_path: Path) -> MakeDataset:
    def make(*touches: Touch, name: str = "touches") -> exumi_data.Dataset:
        root = tmp_path / name
        create_dataset(root, DatasetMetadata(name="test", licence="CC0-1.0"))
        ids = [write_touch(root, number, touch) for number, touch in enumerate(touches)]
        table, failed = build_catalog(root)
        assert not failed
        write_catalog(root, table)
        opened = exumi_data.open(root)
        assert isinstance(opened, exumi_data.Dataset)
        return opened.select(ids)

    return make


@pytest.fixture
def touch() -> type[Touch]:
    return Touch


@pytest.fixture(name="rated")
def rated_labels() -> Callable[..., list[Label]]:
    return rated


@pytest.fixture
def rewrite() -> Callable[[Path, int, Recipe], str]:
    """Write an episode in the place of the one with the same number."""
    return write_episode
