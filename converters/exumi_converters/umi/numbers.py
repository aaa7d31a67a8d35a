"""Poses, widths and sound of an episode of a replay buffer."""

from collections.abc import Mapping
from fractions import Fraction

import numpy as np

from exumi_converters.frame_files import add_lossy
from exumi_converters.zarr2_files.numbers import (
    are_float32,
    note_not_finite,
    read_numbers,
    to_poses,
)
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.model import Clock, Frames, LossyStep, QualityNote
from exumi_data.standard import flags
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import format_rate, nominal_times

__all__ = ["CLOCK", "add_pose", "add_sound", "add_width"]

CLOCK = Clock(source="none", stamp_point="nominal_rate")
"""A replay buffer has no times."""

_ENDS = ("demo_start_pose", "demo_end_pose")
_FULL_SCALE = 32768
_BLOCKS = 512


def add_pose(
    writer: EpisodeWriter,
    name: str,
    parts: Mapping[str, Rows],
    rate: Fraction,
    frames: Frames,
) -> None:
    """Store the pose of a gripper.

    Parameters
    ----------
    writer : EpisodeWriter
    name : str
    parts : mapping of str to Rows
        ``eef_pos``, ``eef_rot_axis_angle``, and where there are, ``demo_start_pose`` and
        ``demo_end_pose``.
    rate : Fraction
    frames : Frames

    Raises
    ------
    SourceError
        A chunk is missing or damaged.
    """
    position, rotation = (
        read_numbers(writer, parts[part], name) for part in ("eef_pos", "eef_rot_axis_angle")
    )
    poses, valid = to_poses(position, rotation)
    said: dict[str, object] = {}
    for end in _ENDS:
        if end in parts:
            value = _one_pose(writer, name, end, read_numbers(writer, parts[end], name))
            if value is not None:
                said[f"umi:{end}"] = value
    stream = writer.add_stream(
        name, kind="pose", clock=CLOCK, nominal_rate=format_rate(rate), frames=frames, **said
    )
    stream.append(nominal_times(len(poses), rate), poses, flags=_flags_of(writer, name, valid))


def _one_pose(writer: EpisodeWriter, stream: str, end: str, rows: np.ndarray) -> list[float] | None:
    """Return the pose that an array repeats in every row."""
    finite = rows[np.isfinite(rows).all(axis=1)]
    if not len(finite):
        return None
    if (finite != finite[0]).any():
        writer.metadata.quality.append(
            QualityNote(
                code="demo-pose-varies",
                message=f"{end} is not the same in all rows; the first one was kept",
                stream=stream,
                severity="info",
            )
        )
    return [float(number) for number in finite[0]]


def _flags_of(writer: EpisodeWriter, stream: str, valid: np.ndarray) -> np.ndarray | None:
    """Return the flags of samples that are no numbers; None where there are none."""
    if valid.all():
        return None
    note_not_finite(writer, stream, valid)
    return np.where(valid, 0, flags()["invalid"].mask).astype(np.uint32)


def add_width(writer: EpisodeWriter, name: str, rows: Rows, rate: Fraction) -> None:
    """Store the opening of a gripper, metres.

    Raises
    ------
    SourceError
        A chunk is missing or damaged.
    """
    values = read_numbers(writer, rows, name).reshape(len(rows))
    valid = are_float32(values)
    stream = writer.add_stream(name, kind="width", clock=CLOCK, nominal_rate=format_rate(rate))
    width = np.where(valid, values, np.nan).astype(np.float32)
    if (width[valid] != values[valid]).any():
        add_lossy(
            writer,
            LossyStep(step="float32", stream=name, detail=f"widths of {values.dtype} were rounded"),
        )
    stream.append(nominal_times(len(width), rate), width, flags=_flags_of(writer, name, valid))


def add_sound(writer: EpisodeWriter, name: str, rows: Rows, rate: Fraction) -> None:
    """Store sound, a block for each frame.

    Parameters
    ----------
    writer : EpisodeWriter
    name : str
    rows : Rows
        (N, samples) or (N, samples, channels).
    rate : Fraction
        Of the frames.

    Raises
    ------
    SourceError
        A chunk is missing or damaged.
    """
    samples = rows.meta.shape[1]
    channels = rows.meta.shape[2] if len(rows.meta.shape) == 3 else 1
    stream = writer.add_stream(
        name,
        kind="audio",
        clock=CLOCK,
        nominal_rate=format_rate(rate),
        rate=format_rate(rate * samples),
        channels=channels,
    )
    times = nominal_times(len(rows), rate)
    clipped = no_numbers = 0
    for first in range(0, len(rows), _BLOCKS):
        stop = min(first + _BLOCKS, len(rows))
        values = read_numbers(writer, rows.slice(first, stop), name)
        values = values.reshape(stop - first, samples, channels)
        if values.dtype != np.int16:
            finite = np.isfinite(values)
            no_numbers += int(np.count_nonzero(~finite))
            scaled = np.rint(np.where(finite, values, 0.0).clip(-2, 2) * _FULL_SCALE)
            clipped += int(np.count_nonzero((scaled < -_FULL_SCALE) | (scaled > _FULL_SCALE)))
            values = scaled.clip(-_FULL_SCALE, _FULL_SCALE - 1).astype(np.int16)
        stream.append(times[first:stop], list(values))
    if rows.meta.dtype != np.int16:
        add_lossy(
            writer,
            LossyStep(
                step="int16",
                stream=name,
                detail="sound of floating point, 1.0 taken for full scale, was rounded to 16 bits",
                parameters={
                    "dtype": rows.meta.dtype.name,
                    "clipped": clipped,
                    "not_finite": no_numbers,
                },
            ),
        )
