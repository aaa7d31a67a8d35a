"""Small replay buffers, written by zarr and imagecodecs themselves, as UMI and exUMI write them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zarr
from imagecodecs.numcodecs import Jpegxl, register_codecs
from scipy.spatial.transform import Rotation
from zarr.storage import LocalStore, ZipStore

__all__ = ["Episode", "make_episode", "wrapped_channels", "write_buffer"]

register_codecs(verbose=False)

SIZE = 48


@dataclass(slots=True)
class Episode:
    """Rows of one episode, by array."""

    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.arrays.values())))


def smooth(rng: np.random.Generator, count: int, size: int) -> np.ndarray:
    """Pictures that change slowly, (N, size, size, 3) uint8."""
    coarse = rng.integers(40, 215, (2, 6, 6, 3)).astype(np.uint8)
    first, last = (cv2.resize(c, (size, size), interpolation=cv2.INTER_CUBIC) for c in coarse)
    share = np.linspace(0, 1, count)[:, None, None, None]
    return np.asarray((first * (1 - share) + last * share).astype(np.uint8))


def gel(count: int, size: int, depth: float = 60.0, quiet: float = 0.4) -> np.ndarray:
    """Grey images of a gel that is pressed after a while, (N, size, size) uint8."""
    y, x = np.mgrid[:size, :size].astype(np.float64)
    base = 110 + 20 * x / size
    blob = np.exp(-((x - size / 2) ** 2 + (y - size / 2) ** 2) / (size / 6) ** 2)
    press = np.clip(np.linspace(-quiet, 1 - quiet, count), 0, None) / (1 - quiet)
    frames = base - depth * press[:, None, None] * blob
    frames += np.random.default_rng(5).normal(0, 0.4, frames.shape)
    return np.asarray(frames.clip(0, 255), np.uint8)


def wrapped_channels(grey: np.ndarray, gain: int = 7) -> np.ndarray:
    """What exUMI's released code makes of grey frames: wrapped, and read in the other order."""
    reference = grey[0].astype(np.int64)
    convex = np.clip(grey - reference, 0, None) * gain % 256
    concave = np.clip(reference - grey, 0, None) * gain % 256
    return np.stack([concave, convex, grey], axis=-1).astype(np.uint8)


def make_episode(
    count: int = 24,
    seed: int = 0,
    *,
    robots: int = 1,
    cameras: int = 1,
    tactile: bool = True,
    size: int = SIZE,
) -> Episode:
    """Make the rows of an episode."""
    rng = np.random.default_rng(seed)
    arrays: dict[str, np.ndarray] = {}
    for robot in range(robots):
        # Turns by more than half a turn: the rotation vector changes sides on the way.
        turn = np.linspace(0.2, 4.4, count)[:, None] * np.array([[0.3, 0.4, 0.866]])
        vectors = np.asarray(Rotation.from_rotvec(turn).as_rotvec())
        position = np.cumsum(rng.normal(0, 1e-3, (count, 3)), axis=0)
        name = f"robot{robot}"
        arrays[f"{name}_eef_pos"] = position.astype(np.float32)
        arrays[f"{name}_eef_rot_axis_angle"] = vectors.astype(np.float32)
        width = 0.05 + 0.03 * np.cos(np.linspace(0, 3, count) + robot)
        arrays[f"{name}_gripper_width"] = width[:, None].astype(np.float32)
        for end, at in (("start", 0), ("end", -1)):
            pose = np.concatenate([position[at], vectors[at]])
            arrays[f"{name}_demo_{end}_pose"] = np.tile(pose, (count, 1))
    for camera in range(cameras):
        arrays[f"camera{camera}_rgb"] = smooth(rng, count, size)
    if tactile:
        arrays["tactile_combined"] = wrapped_channels(gel(count, size))
    return Episode(arrays)


def write_buffer(
    path: Path,
    episodes: list[Episode],
    *,
    codec: Any = "jpegxl",
    low_dim_rows: int | None = None,
    attributes: dict[str, Any] | None = None,
) -> Path:
    """Write a replay buffer: a zip if its name ends in .zip, else a folder."""
    if codec == "jpegxl":
        codec = Jpegxl(level=99, lossless=False, numthreads=1)
    store: Any = ZipStore(path, mode="w") if path.suffix == ".zip" else LocalStore(path)
    root = zarr.create_group(store, zarr_format=2, attributes=attributes or {})
    data, meta = root.create_group("data"), root.create_group("meta")
    for name in episodes[0].arrays:
        values = np.concatenate([episode.arrays[name] for episode in episodes])
        is_image = values.ndim == 4 and values.dtype == np.uint8
        chunks = (low_dim_rows or len(episodes[0]), *values.shape[1:])
        if is_image:
            chunks = (1, *values.shape[1:3], 1 if name == "tactile_combined" else values.shape[3])
        array = data.create_array(
            name,
            shape=values.shape,
            chunks=chunks,
            dtype=values.dtype,
            compressors=codec if is_image else None,
            config={"write_empty_chunks": True},
        )
        array[...] = values
    ends = np.cumsum([len(episode) for episode in episodes]).astype(np.int64)
    meta.create_array("episode_ends", data=ends, chunks=(max(1, 2 * len(ends)),), compressors=None)
    store.close()
    return path
