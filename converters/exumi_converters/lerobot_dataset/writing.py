"""``--to lerobot``: a LeRobotDataset v3.0 on one declared timeline."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.exporter import ExportItem, ExportOptions, ExportPlan, Part
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.lerobot_dataset.assembling import ROWS, STATISTICS, assemble
from exumi_converters.lerobot_dataset.encoding import check_encoder, encode_frames
from exumi_converters.lerobot_dataset.features import Features, VectorFeature
from exumi_converters.lerobot_dataset.layout import ACTION, ACTIVITY
from exumi_converters.lerobot_dataset.options import LeRobotOptions
from exumi_converters.lerobot_dataset.planning import LOSES, make_plan
from exumi_converters.lerobot_dataset.statistics import Statistics, vector_statistics
from exumi_converters.lerobot_dataset.tables import vector_column
from exumi_converters.lerobot_dataset.ticks import frames_at, tick_times, values_at
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import DamagedDataError
from exumi_data.time import parse_rate

__all__ = ["LeRobotExporter"]


class LeRobotExporter:
    """Parquet and MP4 as the package ``lerobot`` writes them; a video file an episode."""

    name = "lerobot"
    version = "1"
    describes = "a LeRobotDataset v3.0: Parquet and MP4 on one timeline"
    keeps: tuple[str, ...] = (
        "cameras and tactile sensors as videos of one rate: the frames nearest in time",
        "poses and widths as observation.state, wrenches and taxels as features of their own",
        "the activity of tactile frames; the task as a sentence; the device's name as robot_type",
    )
    loses: Mapping[str, str] = LOSES
    options: type[FormatOptions] = LeRobotOptions

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        """Choose streams and timeline; refuse episodes that have gaps or lack a stream."""
        told = parse_options(LeRobotOptions, options.settings, self.name)
        check_encoder(told.codec, told.crf)
        return make_plan(dataset, told)

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        """Write the videos, the rows and their statistics."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        features = Features.from_json(plan.shared["features"])
        fps = parse_rate(plan.shared["fps"])
        frames = int(item.settings["frames"])
        at = tick_times(int(item.settings["start_ns"]), 0, frames, fps)
        columns: dict[str, np.ndarray] = {}
        for vector in features.vectors:
            columns[vector.key] = _vector(episode, vector, at)
        if plan.shared["action"]:
            state = columns[features.state.key]  # type: ignore[union-attr]  # an action has one
            columns[ACTION] = np.concatenate((state[1:], state[-1:]))
        if features.activity:
            columns[ACTIVITY] = _activity(episode, features.activity, at)
        # As LeRobot makes them: the quotient in double precision, then float32.
        index = np.arange(frames, dtype=np.int64)
        columns["timestamp"] = np.array([float(i / fps) for i in range(frames)], np.float32)
        columns["frame_index"] = index
        statistics = {key: vector_statistics(values) for key, values in columns.items()}
        for number, image in enumerate(features.images):
            stream = episode[image.stream]
            path = folder / f"{number:03d}.mp4"
            rows = frames_at(stream, at)
            statistics[image.key] = encode_frames(stream, rows, path, fps, plan.shared)
        arrays = {key: vector_column(values) for key, values in columns.items()}
        pq.write_table(pa.table(arrays), folder / ROWS)
        _save(statistics, folder / STATISTICS)
        task = episode.metadata.task
        return {"frames": frames, "task": task.instruction or task.name}

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        """Move the videos and write the tables, with every episode's number."""
        assemble(parts, target, plan.shared)


def _vector(episode: Episode, vector: VectorFeature, at: np.ndarray) -> np.ndarray:
    values = np.concatenate([values_at(episode[name], at) for name in vector.streams], axis=1)
    return values.astype(np.float32)


def _activity(episode: Episode, streams: Sequence[str], at: np.ndarray) -> np.ndarray:
    found = []
    for name in streams:
        activity = episode[name].activity
        if activity is None or not np.isfinite(activity).all():
            raise DamagedDataError(f"stream {name!r}: its activity is missing or not finite")
        found.append(activity[frames_at(episode[name], at)])
    return np.stack(found, axis=1).astype(np.float32)


def _save(statistics: Mapping[str, Statistics], path: Path) -> None:
    path.write_text(json.dumps(statistics, allow_nan=False), encoding="utf-8")
