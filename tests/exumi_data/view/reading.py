"""Rerun recordings read back, with Rerun's own reader."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

__all__ = ["Column", "Recording", "read_view"]


@dataclass
class Column:
    """One component of an entity.

    `values` has a list for each row: empty where the component is cleared there. `utc` is empty
    where the recording has no such timeline.
    """

    time: list[int] = field(default_factory=list)
    utc: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    @property
    def blobs(self) -> list[bytes | None]:
        """Rows of one blob each, as bytes."""
        return [np.asarray(row[0], np.uint8).tobytes() if row else None for row in self.values]


@dataclass
class Recording:
    """A recording: what changes by entity and component, and what is fixed."""

    application: str
    timed: dict[tuple[str, str], Column] = field(default_factory=dict)
    fixed: dict[tuple[str, str], Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return str(self.fixed["/__properties", "RecordingInfo:name"][0])

    @property
    def entities(self) -> set[str]:
        return {entity for entity, _ in (*self.timed, *self.fixed)}

    def column(self, entity: str, component: str) -> Column:
        """A component in the order of time."""
        column = self.timed[entity, component]
        order = np.argsort(column.time, kind="stable")
        return Column(
            [column.time[i] for i in order],
            [column.utc[i] for i in order] if column.utc else [],
            [column.values[i] for i in order],
        )


def _numbers(column: pa.Array) -> list[int]:
    return [int(n) for n in column.cast(pa.int64()).to_pylist()]


def read_view(path: Path) -> dict[str, Recording]:
    """Read a file: its recordings by id. Rows of each component are those it was sent in."""
    reader = RrdReader(path)
    found = {}
    for entry in reader.recordings():
        recording = Recording(entry.application_id)
        found[entry.recording_id] = recording
        for chunk in reader.stream(store=entry):
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if ":" not in name or name.startswith("rerun."):
                    continue
                rows = batch.column(name)
                if chunk.is_static:
                    recording.fixed[chunk.entity_path, name] = rows.to_pylist()[-1]
                    continue
                column = recording.timed.setdefault((chunk.entity_path, name), Column())
                column.time += _numbers(batch.column("time"))
                if "utc" in batch.schema.names:
                    column.utc += _numbers(batch.column("utc"))
                column.values += [row if row is not None else [] for row in rows.to_pylist()]
    return found
