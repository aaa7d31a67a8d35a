"""Tiny valid episodes and datasets, and ways to spoil them."""

import functools
import hashlib
import io
import json
import shutil
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.episode import open_episode
from exumi_data.model import (
    ArrayImages,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    RawData,
    Source,
    Task,
    VideoFile,
    VideoImages,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter

HEIGHT, WIDTH = 24, 32
FRAMES = 5
CLOCK = Clock(source="simulation", stamp_point="simulated")


def episode_id(number: int = 0) -> str:
    """The id of a numbered episode: always the same."""
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"test episode {number}"))


def metadata(number: int = 0, **changes: Any) -> EpisodeMetadata:
    """Metadata without streams."""
    values: dict[str, Any] = {
        "id": episode_id(number),
        "task": Task(name="press"),
        "regime": "touch",
        "licence": "CC0-1.0",
        "source": Source(type="simulated", tool="tests", tool_version="1"),
    }
    return EpisodeMetadata(**{**values, **changes})


def pictures(
    count: int = FRAMES, channels: int = 3, *, height: int = HEIGHT, width: int = WIDTH
) -> np.ndarray:
    """Smooth frames, (N, H, W, C) uint8, each different."""
    y, x = np.mgrid[:height, :width]
    frames = [
        np.stack([(x * 5 + y * 3 + 17 * i + 60 * c) % 256 for c in range(channels)], axis=-1)
        for i in range(count)
    ]
    return np.array(frames, dtype=np.uint8).reshape(count, height, width, channels)


@functools.cache
def jpegs(count: int = FRAMES, channels: int = 3) -> tuple[bytes, ...]:
    """The same frames as JPEG files."""
    return tuple(jpeg.encode(frame, 95) for frame in pictures(count, channels))


def times(count: int = FRAMES) -> np.ndarray:
    """Strictly increasing times, the first one negative."""
    return np.arange(count, dtype=np.int64) * 100_000_000 - 50_000_000


def encoded_images(channels: int = 3) -> EncodedImages:
    """Metadata of a stream of JPEG files."""
    size: Any = {"height": HEIGHT, "width": WIDTH, "channels": channels}
    return EncodedImages(encoding="encoded", media_type="image/jpeg", **size)


def array_images(channels: int = 3) -> ArrayImages:
    """Metadata of a stream of raw frames."""
    size: Any = {"height": HEIGHT, "width": WIDTH, "channels": channels}
    return ArrayImages(encoding="array", **size)


@functools.cache
def clip(count: int = FRAMES) -> tuple[bytes, tuple[int, ...], tuple[int, ...], str]:
    """A small MPEG-4 file: its bytes, the pts of its frames, their keyframes, its time base."""
    return clip_of(pictures(count))


def clip_of(frames: np.ndarray) -> tuple[bytes, tuple[int, ...], tuple[int, ...], str]:
    """An MPEG-4 file of frames, (N, H, W, 3) uint8, as `clip` gives it."""
    import av

    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as out:
        stream = out.add_stream("mpeg4", rate=10)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"
        stream.gop_size = 2
        for picture in frames:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        out.mux(stream.encode())
    content = buffer.getvalue()
    pts: list[int] = []
    keyframes: list[int] = []
    with av.open(io.BytesIO(content), "r") as file:
        for frame in file.decode(video=0):
            keyframes.append(len(pts) if frame.key_frame else keyframes[-1])
            pts.append(int(frame.pts or 0))
        base = file.streams.video[0].time_base
    assert base is not None
    return content, tuple(pts), tuple(keyframes), f"{base.numerator}/{base.denominator}"


def video_file(content: bytes, time_base: str, name: str = "clip.mp4") -> VideoFile:
    """Metadata of a video file."""
    return VideoFile(
        name=name,
        media_type="video/mp4",
        codec="mpeg4",
        time_base=time_base,
        sha256=hashlib.sha256(content).hexdigest(),
        bytes=len(content),
    )


def add_low_dimensional(writer: EpisodeWriter) -> None:
    """Add a pose, a width, a wrench, taxels and a third party's stream."""
    count, time = FRAMES, times()
    poses = np.zeros((count, 7))
    poses[:, 0], poses[:, 6] = np.linspace(0, 0.1, count), 1
    pose = writer.add_stream(
        "pose", kind="pose", clock=CLOCK, frames=Frames(parent="world", child="tcp")
    )
    pose.append(time, poses, sequence=np.arange(count), flags=np.zeros(count, np.int64))
    counts = RawData(unit="count", transform="encoder")
    width = writer.add_stream("width", kind="width", clock=CLOCK, raw=counts)
    width.append(time, np.linspace(0.02, 0.08, count), raw=np.arange(count, dtype=np.uint16))
    wrench = writer.add_stream("force", kind="wrench", clock=CLOCK, components=["fx", "fy", "fz"])
    wrench.append(time, np.arange(3 * count, dtype=np.float32).reshape(count, 3))
    taxels = writer.add_stream("taxels", kind="taxels", clock=CLOCK, grid=[2, 3], unit="adc")
    taxels.append(time, np.arange(6 * count, dtype=np.int16).reshape(count, 2, 3))
    taxels.set_valid(np.array([[True, True, False], [True, True, True]]))
    other = writer.add_stream(
        "smell",
        kind="acme:smell",
        clock=CLOCK,
        extension_version="1",
        time_device_unit="ns",
        schema_url="https://acme.example/smell.json",
    )
    other.append(time, np.arange(count, dtype=np.float64), time_device=time * 2)


def add_images(writer: EpisodeWriter) -> None:
    """Add one stream in each encoding."""
    tactile = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=encoded_images())
    tactile.append(times(), jpegs())
    tactile.set_reference(pictures()[0], method="captured", contact_free=True)
    rgb = writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=array_images())
    rgb.append(times(), pictures())
    content, pts, keyframes, base = clip()
    images: Any = {"encoding": "video", "height": HEIGHT, "width": WIDTH, "channels": 3}
    video = writer.add_stream("gopro", kind="rgb", clock=CLOCK, images=VideoImages(**images))
    video.append_file(
        content, video_file(content, base), pts=np.array(pts), keyframe=np.array(keyframes)
    )
    activity = np.linspace(0, 0.02, FRAMES, dtype=np.float32)
    writer.add_derived(
        "tactile",
        "activity",
        activity,
        algorithm="exumi-activity/1",
        parameters={"threshold": 5.8, "size": 224, "active_above": 1e-3},
    )
    writer.add_derived(
        "tactile", "salient", np.array([1, 3], np.int64), algorithm="octopi-salience/1"
    )


def write_episode(path: Path, number: int = 0, **changes: Any) -> Path:
    """Write an episode that has everything: all kinds, all encodings, derived arrays."""
    item = CalibrationItem(value={"m_per_count": 0.015, "zero_m": 0.02}, method="made up")
    values = {"calibration": {"encoder": item}, **changes}
    with EpisodeWriter(path, metadata(number, **values), durable=False) as writer:
        add_low_dimensional(writer)
        add_images(writer)
    return path


def write_small(path: Path, number: int = 0, **changes: Any) -> Path:
    """Write an episode with one low-dimensional and one image stream."""
    with EpisodeWriter(path, metadata(number, **changes), durable=False) as writer:
        width = writer.add_stream("width", kind="width", clock=CLOCK)
        width.append(times(), np.linspace(0, 0.05, FRAMES))
        tactile = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=encoded_images())
        tactile.append(times(), jpegs())
        activity = np.linspace(0, 0.02, FRAMES, dtype=np.float32)
        writer.add_derived("tactile", "activity", activity, algorithm="exumi-activity/1")
    return path


def write_dataset(root: Path, count: int = 3, *, catalog: bool = True, **changes: Any) -> Path:
    """Write a dataset of small episodes."""
    create_dataset(root, DatasetMetadata(name="tests", licence="CC0-1.0", **changes))
    for number in range(count):
        write_small(root / episode_path(episode_id(number)), number)
    if catalog:
        table, failed = build_catalog(root)
        assert not failed
        write_catalog(root, table)
    return root


def edit_json(path: Path, change: Callable[[Any], object]) -> None:
    """Change a JSON document in place."""
    document = json.loads(path.read_bytes())
    change(document)
    path.write_text(json.dumps(document), "utf-8")


def edit_metadata(episode: Path, change: Callable[[Any], object]) -> None:
    """Change the metadata of an episode's folder in place."""
    edit_json(episode / "zarr.json", lambda document: change(document["attributes"]["exumi"]))


def copy_of(episode: Path, target: Path) -> Path:
    """Copy an episode's folder."""
    shutil.copytree(episode, target)
    return target


def read_everything(path: Path) -> None:
    """Open an episode and read all that is in it."""
    with open_episode(path) as episode:
        episode.check_complete()
        for stream in episode.streams.values():
            _ = stream.time
            for name in stream.metadata.arrays:
                stream.array(name)
            if stream.is_image:
                _ = stream.frames[:]
            images = getattr(stream.metadata, "images", None)
            if isinstance(images, EncodedImages) and len(stream):
                stream.encoded(-1)
            if isinstance(images, VideoImages):
                stream.container()
            _ = stream.activity
        if episode.derived is not None:
            for key in episode.derived.items:
                episode.derived_array(key)
        episode.digest()
