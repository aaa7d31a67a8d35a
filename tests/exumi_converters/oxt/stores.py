"""Small stores of Open-X-Tactile, written by zarr itself as FTP-1's own parsers write them."""

from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numcodecs import Blosc

__all__ = ["episode", "pictures", "write_store"]

SIZE = 24


def pictures(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Images of noise about a level, uint8."""
    return rng.integers(90, 140, (*shape, SIZE, SIZE, 3)).astype(np.uint8)


def episode(steps: int = 12, seed: int = 0, words: str = "wipe the table") -> dict[str, np.ndarray]:
    """What an episode of a gripper with two GelSight Minis holds, by key."""
    rng = np.random.default_rng(seed)
    pose = np.concatenate(
        [
            np.cumsum(rng.normal(0, 1e-3, (steps, 3)), axis=0),
            rng.normal(0, 0.3, (1, 3)).repeat(steps, 0),
        ],
        axis=1,
    )
    return {
        "timestamps": np.arange(steps) / 30.0,
        "sub_task_instruction": np.array([words.ljust(40)] * steps),
        "right_wrist_camera_rgb": pictures(rng, steps),
        "right_wrist_pose": pose.astype(np.float32),
        "right_arm_joints": rng.normal(0, 1, (steps, 7)).astype(np.float32),
        "right_hand_joints": np.linspace(0.01, 0.08, steps, dtype=np.float32)[:, None],
        "right_hand_joints_idx": np.full((steps, 1), 28, np.int32),
        **group(steps, pictures(rng, steps, 2)),
    }


def group(
    steps: int,
    data: np.ndarray,
    *,
    name: str = "gripper",
    side: str = "right",
    areas: tuple[int, ...] = (0, 1),
    sensor: str = "GelSightMini",
    kind: str = "image",
) -> dict[str, np.ndarray]:
    """The four arrays of a tactile group."""
    return {
        f"{side}_tactile_data_{name}": data,
        f"{side}_tactile_area_{name}": np.tile(np.array([areas], np.int64), (steps, 1)),
        f"{side}_tactile_sensor_{name}": np.array([sensor] * steps),
        f"{side}_tactile_type_{name}": np.array([kind] * steps),
    }


def write_store(path: Path, *episodes: dict[str, np.ndarray], rows: int = 5, **arrays: Any) -> Path:
    """Write a store with chunks of several steps, compressed as FTP-1's replay buffer is.

    Parameters
    ----------
    path : pathlib.Path
    *episodes : dict
    rows : int
        Steps a chunk.
    **arrays
        Instead of what the episodes hold; None leaves an array out.
    """
    root = zarr.open_group(str(path), mode="w", zarr_format=2)
    data, meta = root.create_group("data"), root.create_group("meta")
    ends = np.cumsum([len(one["timestamps"]) for one in episodes]).astype(np.int64)
    put(meta, "episode_ends", ends, len(ends))
    joined = {key: np.concatenate([one[key] for one in episodes]) for key in episodes[0]}
    for key, values in {**joined, **arrays}.items():
        if values is not None:
            put(data, key, values, rows)
    return path


def put(group: zarr.Group, name: str, values: np.ndarray, rows: int) -> None:
    """Write one array."""
    array = group.create_array(
        name,
        shape=values.shape,
        dtype=values.dtype,
        chunks=(min(rows, len(values)), *values.shape[1:]),
        compressors=Blosc("zstd", clevel=5, shuffle=Blosc.BITSHUFFLE),
        fill_value="" if values.dtype.kind == "U" else 0,
    )
    array[:] = values
