"""One episode of a LeRobotDataset becomes an episode of ours."""

from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exumi_converters.converter import EpisodeSource
from exumi_converters.image_stream import find_gaps
from exumi_converters.lerobot_dataset.layout import label
from exumi_converters.lerobot_dataset.mapping import FeatureMap, ImageStream, NumberStream
from exumi_converters.lerobot_dataset.mapping import stream_values as values_of
from exumi_converters.lerobot_dataset.parquet_files import numbers_of, rows_of_episode
from exumi_converters.lerobot_dataset.pictures import Pictures, add_embedded, add_pictures
from exumi_data.errors import SourceError
from exumi_data.model import Annotations, Clock, Device, QualityNote, Segment
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import format_rate, nominal_times, parse_rate

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["LeRobotEpisode"]

_TOLERANCE_S = 1e-4
_NUMBERS = ("timestamp", "frame_index", "index", "task_index")


class LeRobotEpisode:
    """One episode that is being read.

    Parameters
    ----------
    item : EpisodeSource
    writer : EpisodeWriter
    """

    def __init__(self, item: EpisodeSource, writer: EpisodeWriter) -> None:
        self._settings = item.settings
        self._paths = {file.name: file.path for file in item.files}
        self._writer = writer
        self._map = FeatureMap.from_json(item.settings["map"])
        self._rate = parse_rate(item.settings["fps"])
        self._count = int(item.settings["length"])

    @cached_property
    def _time(self) -> np.ndarray:
        """The times of the frames, once it is known that there are as many rows."""
        return nominal_times(self._count, self._rate)

    @property
    def _rows(self) -> Path:
        return self._paths[self._settings["rows"]]

    def write(self) -> int:
        """Write the streams; return the number of frames.

        Raises
        ------
        SourceError
            Rows or frames are missing, or not those of the episode.
        """
        features = dict.fromkeys(stream.feature for stream in self._map.numbers)
        table = rows_of_episode(self._rows, self._settings["episode"], [*_NUMBERS, *features])
        self._check_rows(table)
        frames = 0
        for image in self._map.images:
            self._add_image(image)
            frames += self._count
        arrays = {key: numbers_of(table, key, self._rows) for key in features}
        for stream in self._map.numbers:
            self._add_numbers(stream, arrays[stream.feature])
        self._describe(numbers_of(table, "task_index", self._rows))
        return frames or self._count

    def _check_rows(self, table: "pa.Table") -> None:
        """Refuse rows of which nothing says where they belong; note what is merely wrong."""
        if table.num_rows != self._count:
            raise SourceError(
                f"holds {table.num_rows} rows of the episode, which has {self._count} frames",
                where=self._rows,
            )
        number = numbers_of(table, "frame_index", self._rows)
        if not np.array_equal(number, np.arange(self._count)):
            raise SourceError(
                f"frames are not numbered 0 to {self._count - 1} in order", where=self._rows
            )
        index = numbers_of(table, "index", self._rows)
        if not np.array_equal(index, self._settings["first"] + number):
            self._note(
                "wrong-index",
                "rows bear other numbers than the table of episodes gives them, as after a merge "
                "that went wrong; they were found by episode and frame",
            )
        stamps = numbers_of(table, "timestamp", self._rows).astype(np.float64)
        off = np.abs(stamps - self._time * 1e-9)
        if not (off <= _TOLERANCE_S).all():
            worst = float(np.nanmax(off)) if np.isfinite(off).any() else float("nan")
            self._note(
                "timestamps-off",
                f"timestamps are up to {worst:.6f} s away from frame number by rate; the latter "
                "were kept, as the frames of the videos are found by them",
            )

    def _note(self, code: str, message: str, **fields: Any) -> None:
        note = QualityNote(code=code, message=message, **fields)
        self._writer.metadata.quality.append(note)

    def _add_image(self, image: ImageStream) -> None:
        if image.kind == "tactile" and self._settings["sensor"] and "sensor" not in image.fields:
            image.fields["sensor"] = {"model": self._settings["sensor"]}
        said = self._settings["videos"].get(image.feature)
        if said is None:
            episode = self._settings["episode"]
            count = add_embedded(self._writer, image, self._rows, episode, self._rate)
            if count != self._count:
                raise SourceError(
                    f"{count} of {self._count} pictures of {image.feature!r} can be read",
                    where=self._rows,
                )
            return
        inputs = {file.name: file for file in self._writer.metadata.source.inputs or []}
        source = Pictures(
            path=self._paths[said["file"]],
            file=inputs[said["file"]],
            begin_s=said["begin_s"],
            alone=said["alone"],
            count=self._count,
            rate=self._rate,
        )
        add_pictures(self._writer, image, source)

    def _add_numbers(self, stream: NumberStream, numbers: np.ndarray) -> None:
        if numbers.ndim == 1:
            numbers = numbers[:, None]
        if numbers.shape[1] <= max(stream.columns):
            raise SourceError(
                f"{stream.feature!r} has {numbers.shape[1]} numbers, fewer than info.json says",
                where=self._rows,
            )
        values, usable = values_of(stream, numbers)
        if not len(values):
            self._note(
                "not-converted", f"{stream.feature}: no value of stream {stream.name} is usable"
            )
            return
        time = self._time[usable]
        fields: dict[str, Any] = dict(stream.fields)
        gaps = find_gaps(time, self._rate)
        if not usable.all():
            fields["gaps"] = gaps
            self._note(
                "dropped",
                f"{int((~usable).sum())} of {self._count} values are not finite or hold no "
                "rotation, and were left out",
                stream=stream.name,
            )
        said = fields.pop("description", None) or f"feature {stream.feature}"
        writer = self._writer.add_stream(
            stream.name,
            kind=stream.kind,
            clock=Clock(source="none", stamp_point="nominal_rate"),
            nominal_rate=format_rate(self._rate),
            description=said,
            **fields,
        )
        kept = np.float32 if stream.kind in {"taxels", "wrench", "width"} else np.float64
        writer.append(time, values.astype(kept))

    def _describe(self, tasks: np.ndarray) -> None:
        metadata = self._writer.metadata
        robot = label(self._settings["robot_type"] or "")
        if robot:
            metadata.device = Device(name=robot)
        segments = self._segments(tasks)
        if segments:
            metadata.annotations = (metadata.annotations or Annotations()).model_copy(
                update={"segments": segments}
            )
        if self._map.unread:
            named = "; ".join(f"{key} ({why})" for key, why in self._map.unread.items())
            self._note("not-converted", f"features that were not read: {named}", severity="info")

    def _segments(self, tasks: np.ndarray) -> list[Segment]:
        """Return a segment for each stretch of one task, where there are several."""
        texts = self._settings["tasks"]
        if not texts:
            return []
        edges = [0, *(np.flatnonzero(np.diff(tasks)) + 1).tolist(), len(tasks)]
        period = round(1e9 / float(self._rate))
        return [
            Segment(
                name=label(texts.get(str(int(tasks[start])), f"task {int(tasks[start])}")),
                start_ns=int(self._time[start]),
                end_ns=int(self._time[stop - 1]) + period,
            )
            for start, stop in pairwise(edges)
        ]
