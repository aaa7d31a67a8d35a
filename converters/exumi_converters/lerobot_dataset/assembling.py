"""The parts of an export become one dataset: numbered, moved, and described in its tables."""

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exumi_converters.exporter import Part
from exumi_converters.lerobot_dataset.encoding import video_info
from exumi_converters.lerobot_dataset.features import Features
from exumi_converters.lerobot_dataset.layout import (
    CHUNK_FILES,
    DATA_PATH,
    DECLARATION,
    EPISODES_FOLDER,
    INFO,
    STATS,
    TASKS,
    VERSION,
    VIDEO_PATH,
    fps_number,
    place,
)
from exumi_converters.lerobot_dataset.statistics import Statistics, Totals, vector_statistics
from exumi_converters.lerobot_dataset.tables import vector_column, write_tasks
from exumi_data.time import parse_rate

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

__all__ = ["ROWS", "STATISTICS", "assemble"]

ROWS = "rows.parquet"
STATISTICS = "statistics.json"

_FILE_MB = 100
_VIDEO_MB = 200
_EPISODES_AT_ONCE = 100


def assemble(parts: Sequence[Part], target: Path, shared: Mapping[str, Any]) -> None:
    """Put the parts together.

    Parameters
    ----------
    parts : sequence of Part
    target : pathlib.Path
        A new, empty folder.
    shared : mapping
        What the plan shares.
    """
    features = Features.from_json(shared["features"])
    fps = parse_rate(shared["fps"])
    tasks = {name: i for i, name in enumerate(dict.fromkeys(p.result["task"] for p in parts))}
    totals: dict[str, Totals] = {}
    first = 0
    with ExitStack() as stack:
        data = _Files(target, DATA_PATH, stack)
        episodes = _Files(target, f"{EPISODES_FOLDER}/{DATA_PATH.partition('/')[2]}", stack)
        waiting: list[dict[str, Any]] = []
        for number, part in enumerate(parts):
            frames = int(part.result["frames"])
            rows, statistics = _numbered(part, number, first, tasks[part.result["task"]])
            chunk, file = data.write(rows)
            row: dict[str, Any] = {
                "episode_index": number,
                "tasks": [part.result["task"]],
                "length": frames,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": first,
                "dataset_to_index": first + frames,
            }
            for image, feature in enumerate(features.images):
                name = f"{image:03d}.mp4"
                _move_video(part.folder / name, target, feature.key, number)
                row |= _video_row(feature.key, number, float(frames / fps))
            for key, found in statistics.items():
                totals.setdefault(key, Totals()).add(found)
                row |= {f"stats/{key}/{name}": value for name, value in found.items()}
            waiting.append(row)
            first += frames
            if len(waiting) == _EPISODES_AT_ONCE:
                _write_episodes(episodes, waiting)
        _write_episodes(episodes, waiting)
    write_tasks(list(tasks), target / TASKS)
    _write_json(target / STATS, {key: total.finish() for key, total in totals.items()})
    _write_json(target / INFO, _info(features, shared, len(parts), first, len(tasks)))
    _write_json(target / DECLARATION, shared["declaration"])


def _numbered(
    part: Part, number: int, first: int, task: int
) -> tuple["pa.Table", dict[str, Statistics]]:
    """Return an episode's rows and statistics, with the numbers that it has in the dataset."""
    import pyarrow.parquet as pq

    rows = pq.read_table(part.folder / ROWS)
    statistics = json.loads((part.folder / STATISTICS).read_bytes())
    count = rows.num_rows
    numbers = {
        "episode_index": np.full(count, number, np.int64),
        "index": np.arange(first, first + count, dtype=np.int64),
        "task_index": np.full(count, task, np.int64),
    }
    for name, values in numbers.items():
        rows = rows.append_column(name, vector_column(values))
        statistics[name] = vector_statistics(values)
    return rows, statistics


class _Files:
    """Parquet files one after the other, none much larger than LeRobot's limit."""

    def __init__(self, root: Path, pattern: str, stack: ExitStack) -> None:
        self._root = root
        self._pattern = pattern
        self._number = 0
        self._path: Path | None = None
        self._writer: pq.ParquetWriter | None = None
        stack.callback(self._close)

    @property
    def place(self) -> tuple[int, int]:
        """Chunk and file that the next rows go to."""
        if self._path is not None and self._path.stat().st_size >= _FILE_MB << 20:
            self._close()
            self._number += 1
        return place(self._number)

    def write(self, table: "pa.Table") -> tuple[int, int]:
        """Write rows as a group of their own; return chunk and file."""
        import pyarrow.parquet as pq

        chunk, file = self.place
        if self._writer is None:
            name = self._pattern.format(chunk_index=chunk, file_index=file)
            self._path = self._root / name
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(self._path, table.schema, compression="snappy")
        self._writer.write_table(table)
        return chunk, file

    def _close(self) -> None:
        if self._writer is not None:
            self._writer.close()
        self._writer = self._path = None


def _move_video(source: Path, target: Path, key: str, number: int) -> None:
    chunk, file = place(number)
    path = target / VIDEO_PATH.format(video_key=key, chunk_index=chunk, file_index=file)
    path.parent.mkdir(parents=True, exist_ok=True)
    source.rename(path)


def _video_row(key: str, number: int, seconds: float) -> dict[str, Any]:
    chunk, file = place(number)
    return {
        f"videos/{key}/chunk_index": chunk,
        f"videos/{key}/file_index": file,
        f"videos/{key}/from_timestamp": 0.0,
        f"videos/{key}/to_timestamp": seconds,
    }


def _write_episodes(files: _Files, waiting: list[dict[str, Any]]) -> None:
    import pyarrow as pa

    if not waiting:
        return
    chunk, file = files.place
    at = {"meta/episodes/chunk_index": chunk, "meta/episodes/file_index": file}
    files.write(pa.Table.from_pylist([row | at for row in waiting]))
    waiting.clear()


def _info(
    features: Features, shared: Mapping[str, Any], episodes: int, frames: int, tasks: int
) -> dict[str, Any]:
    fps = fps_number(parse_rate(shared["fps"]))
    return {
        "codebase_version": VERSION,
        "robot_type": shared["robot_type"],
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": _FILE_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if features.images else None,
        "features": features.document(
            action=shared["action"], video=video_info(shared["codec"], fps)
        ),
    }


def _write_json(path: Path, value: object) -> None:
    text = json.dumps(value, indent=4, ensure_ascii=False, allow_nan=False)
    path.write_text(text, encoding="utf-8")
