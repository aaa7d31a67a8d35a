"""Datasets as LeRobot's own recorder writes them: all episodes in one file of rows and videos."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

HEIGHT, WIDTH = 48, 64
FRONT, GEL = "observation.images.front", "observation.images.gel"
NAMES = ["pose.x", "pose.y", "pose.z", "pose.qx", "pose.qy", "pose.qz", "pose.qw", "grip.width_m"]
ROWS = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"


@dataclass(frozen=True, kw_only=True)
class Theirs:
    """What a dataset is made from."""

    lengths: tuple[int, ...] = (12, 15, 11)
    fps: int = 30
    gop: int | None = 2  # None: only the first frame of each episode is sure to be a keyframe
    names: Any = field(default_factory=lambda: list(NAMES))
    videos: tuple[str, ...] = (FRONT, GEL)


def level(episode: int, index: int) -> int:
    """Return the grey level of a frame."""
    return 60 + 3 * index + 40 * episode


def picture(episode: int, index: int) -> np.ndarray:
    x = np.arange(WIDTH)[None, :, None] // 8 % 2
    return np.broadcast_to(level(episode, index) + 8 * x, (HEIGHT, WIDTH, 3)).astype(np.uint8)


def states(episode: int, count: int) -> np.ndarray:
    values = np.zeros((count, len(NAMES)), np.float32)
    turn = np.linspace(0, 0.5, count) + episode
    values[:, 0] = 0.01 * np.arange(count)
    values[:, 5], values[:, 6] = np.sin(turn / 2), np.cos(turn / 2)
    values[:, 7] = 0.05
    return values


def write_theirs(root: Path, made: Theirs | None = None) -> Path:
    """Write a dataset."""
    made = made or Theirs()
    for name in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / name).mkdir(parents=True)
    for key in made.videos:
        write_video(root / f"videos/{key}/chunk-000/file-000.mp4", made)
    _write_rows(root, made)
    _write_episodes(root, made)
    tasks = {"task_index": [0, 1], "__index_level_0__": ["lift the cup", "put it down"]}
    pq.write_table(pa.table(tasks), root / "meta/tasks.parquet")
    numbers = {"timestamp": "float32"} | dict.fromkeys(
        ("frame_index", "episode_index", "index", "task_index"), "int64"
    )
    count = len(NAMES)
    features: dict[str, Any] = {
        "observation.state": {"dtype": "float32", "shape": [count], "names": made.names},
        "action": {"dtype": "float32", "shape": [2], "names": None},
    }
    for key in made.videos:
        shape = [HEIGHT, WIDTH, 3]
        features[key] = {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}
    for name, dtype in numbers.items():
        features[name] = {"dtype": dtype, "shape": [1], "names": None}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "so100",
        "total_episodes": len(made.lengths),
        "total_frames": sum(made.lengths),
        "fps": made.fps,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": features,
    }
    (root / "meta/info.json").write_text(json.dumps(info))
    return root


def write_video(path: Path, made: Theirs) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        options = {"crf": "18", "g": str(made.gop or 250), "sc_threshold": "0"}
        stream = container.add_stream("libx264", rate=made.fps, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for episode, count in enumerate(made.lengths):
            for index in range(count):
                frame = av.VideoFrame.from_ndarray(picture(episode, index), format="rgb24")
                if made.gop is not None and index == 0:
                    frame.pict_type = av.video.frame.PictureType.I
                container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _write_rows(root: Path, made: Theirs) -> None:
    columns: dict[str, list[Any]] = {}
    first = 0
    for episode, count in enumerate(made.lengths):
        index = np.arange(count)
        said = {
            "observation.state": states(episode, count).tolist(),
            "action": np.zeros((count, 2), np.float32).tolist(),
            "timestamp": (index / made.fps).astype(np.float32).tolist(),
            "frame_index": index.tolist(),
            "episode_index": [episode] * count,
            "index": (first + index).tolist(),
            "task_index": [episode % 2] * count,
        }
        first += count
        for name, values in said.items():
            columns.setdefault(name, []).extend(values)
    pq.write_table(pa.table(columns), root / ROWS)


def _write_episodes(root: Path, made: Theirs) -> None:
    rows, first = [], 0
    for episode, count in enumerate(made.lengths):
        row: dict[str, Any] = {
            "episode_index": episode,
            "tasks": [("lift the cup", "put it down")[episode % 2]],
            "length": count,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": first,
            "dataset_to_index": first + count,
        }
        for key in made.videos:
            row[f"videos/{key}/chunk_index"] = row[f"videos/{key}/file_index"] = 0
            row[f"videos/{key}/from_timestamp"] = first / made.fps
            row[f"videos/{key}/to_timestamp"] = (first + count) / made.fps
        rows.append(row)
        first += count
    pq.write_table(pa.Table.from_pylist(rows), root / EPISODES)


def edit_rows(root: Path, change: Callable[[list[dict[str, Any]]], Any], name: str = ROWS) -> None:
    """Change the rows of a table in place."""
    rows = pq.read_table(root / name).to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows), root / name)


def edit_info(root: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change ``info.json`` in place."""
    path = root / "meta/info.json"
    info = json.loads(path.read_text())
    change(info)
    path.write_text(json.dumps(info))
