"""Poses, widths, cells, forces and words of an episode of a store."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from exumi_converters.frame_files import add_lossy
from exumi_converters.oxt.contract import GRIPPER_SLOT
from exumi_converters.oxt.stamps import Timeline
from exumi_converters.zarr2_files.numbers import (
    are_float32,
    note_not_finite,
    read_numbers,
    to_poses,
)
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.model import Annotations, Frames, LossyStep, QualityNote, Segment, Sensor, Task
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["add_cells", "add_pose", "add_width", "add_words", "read_text"]

_MOST_SEGMENTS = 1000
_TURNED_DEG = 90  # about z, where the exporter was told that the axes are UMI's
_LONGEST_NAME = 255
_MOST_OFFSET = 1e300
_DEFAULT_CHILD = {"camera_ego_pose": "oxt_camera_ego"}


def read_text(rows: Rows) -> np.ndarray:
    """Read an array of strings of fixed width, (T,), without what pads them."""
    values = rows.read(fill=True).reshape(len(rows), -1)[:, 0]
    if values.dtype.kind == "S":
        values = np.char.decode(values, "utf-8", "replace")
    return np.char.strip(values)


def add_pose(
    writer: EpisodeWriter,
    name: str,
    rows: Rows,
    timeline: Timeline,
    about: Mapping[str, Any],
) -> None:
    """Store poses: position and rotation vector become position and quaternion."""
    from scipy.spatial.transform import Rotation

    values = read_numbers(writer, rows, name).astype(np.float64)
    turned = about.get("turned_about_z_deg") == _TURNED_DEG
    valid = are_float32(values).all(axis=1)
    if turned:
        rotation = Rotation.from_rotvec(values[valid, 3:])
        back = rotation * Rotation.from_euler("z", -_TURNED_DEG, degrees=True)
        values[valid, 3:] = back.as_rotvec()
    poses, valid = to_poses(values[:, :3], values[:, 3:])
    child = _DEFAULT_CHILD.get(rows.name, "oxt_wrist")
    stream = writer.add_stream(
        name,
        kind="pose",
        frames=Frames(
            parent=_identifier(about.get("parent"), "world"),
            child=_identifier(about.get("child"), child),
        ),
        **timeline.fields(),
    )
    stream.append(timeline.time_ns, poses, flags=timeline.flags(valid))
    note_not_finite(writer, name, valid)


def _identifier(value: object, default: str) -> str:
    """Return a word that a store states, if it is one."""
    if not isinstance(value, str) or value != " ".join(value.split()):
        return default
    return value if 0 < len(value) <= _LONGEST_NAME else default


def add_width(
    writer: EpisodeWriter,
    name: str,
    rows: Rows,
    slots: Rows | None,
    timeline: Timeline,
    scale: float,
) -> None:
    """Store the opening of a gripper, if that is what the hand's one joint is.

    Parameters
    ----------
    writer : EpisodeWriter
    name : str
    rows : Rows
    slots : Rows or None
        Which joint it is; None where the array's name says it.
    timeline : Timeline
    scale : float
        Metres a unit.
    """
    if slots is not None:
        found = np.unique(read_numbers(writer, slots, None))
        if found.tolist() != [GRIPPER_SLOT]:
            writer.metadata.quality.append(
                QualityNote(
                    code="not-converted",
                    message=f"{rows.name} is joint {', '.join(map(str, found[:5]))}, no gripper "
                    f"(slot {GRIPPER_SLOT}), and was left out",
                    severity="info",
                )
            )
            return
    values = read_numbers(writer, rows, name).reshape(len(rows)).astype(np.float64) * scale
    valid = are_float32(values)
    stream = writer.add_stream(name, kind="width", **timeline.fields())
    width = np.where(valid, values, np.nan).astype(np.float32)
    stream.append(timeline.time_ns, width, flags=timeline.flags(valid))
    note_not_finite(writer, name, valid)


def add_cells(
    writer: EpisodeWriter,
    names: Sequence[str],
    sensors: Sequence[Sensor],
    rows: Rows,
    timeline: Timeline,
    about: Mapping[str, Any],
) -> int:
    """Store tactile numbers: a stream a pad of cells, or one of forces where the store says so.

    Returns
    -------
    int
        Samples written.
    """
    values = read_numbers(writer, rows, names[0])
    components = about.get("components")
    if isinstance(components, list):
        flat = values.reshape(len(rows), -1)
        valid = np.isfinite(flat).all(axis=1)
        stream = writer.add_stream(
            names[0], kind="wrench", components=components, sensor=sensors[0], **timeline.fields()
        )
        stream.append(timeline.time_ns, flat, flags=timeline.flags(valid))
        note_not_finite(writer, names[0], valid)
        return len(rows)
    values = _cell_type(writer, values, names)
    for number, (name, sensor) in enumerate(zip(names, sensors, strict=True)):
        cells = values[:, number]
        stream = writer.add_stream(
            name,
            kind="taxels",
            grid=list(cells.shape[1:]),
            sensor=sensor,
            **_cell_fields(about),
            **timeline.fields(),
        )
        valid = np.isfinite(cells).all(axis=(1, 2))
        stream.append(timeline.time_ns, cells, flags=timeline.flags(valid))
        note_not_finite(writer, name, valid)
    return len(rows) * len(names)


def _cell_fields(about: Mapping[str, Any]) -> dict[str, Any]:
    unit, sign, offset = (about.get(key) for key in ("unit", "sign", "offset"))
    if not isinstance(offset, int | float) or abs(offset) > _MOST_OFFSET:
        offset = 0.0
    return {
        "unit": _identifier(unit, "oxt:unstated"),
        "sign": sign if sign in (-1, 1) else 1,
        "offset": float(offset),
    }


def _cell_type(writer: EpisodeWriter, values: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return cells as int16 where that holds them, else as float32."""
    if values.dtype.kind in "biu":
        limits = np.iinfo(np.int16)
        if values.min(initial=0) >= limits.min and values.max(initial=0) <= limits.max:
            return values.astype(np.int16)
    if values.dtype == np.float32:
        return values
    with np.errstate(over="ignore"):
        found = values.astype(np.float32)
    if (found.astype(np.float64) != values).any():
        for name in names:
            detail = f"cells of {values.dtype} were rounded"
            add_lossy(writer, LossyStep(step="float32", stream=name, detail=detail))
    return found


def add_words(writer: EpisodeWriter, rows: Rows, timeline: Timeline) -> None:
    """Keep the instruction; where it changes, each becomes a segment."""
    words = read_text(rows)
    changes = np.flatnonzero(np.concatenate(([True], words[1:] != words[:-1])))
    first = str(words[0])
    task = writer.metadata.task
    same = not first or first == task.name
    writer.metadata.task = Task(name=task.name, instruction=None if same else first)
    if len(changes) == 1:
        return
    if len(changes) > _MOST_SEGMENTS:
        message = f"the instruction changes {len(changes) - 1} times; only the first was kept"
        writer.metadata.quality.append(QualityNote(code="instructions", message=message))
        return
    time = timeline.time_ns
    stops = [*time[changes[1:]].tolist(), int(time[-1])]
    segments = [
        Segment(name=name, start_ns=int(time[place]), end_ns=stop)
        for place, stop in zip(changes.tolist(), stops, strict=True)
        if (name := " ".join(str(words[place]).split())[:_LONGEST_NAME].strip())
    ]
    annotations = writer.metadata.annotations or Annotations()
    writer.metadata.annotations = annotations.model_copy(update={"segments": segments})
