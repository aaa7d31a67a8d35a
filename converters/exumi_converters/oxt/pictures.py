"""Images of an episode of a store: decoded once, stored as pixels or as JPEG."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from exumi_converters.oxt.layout import picture_shape
from exumi_converters.oxt.stamps import Timeline
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_converters.zarr2_files.notes import note_jpeg
from exumi_converters.zarr2_files.pictures import Pass, Reader
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.errors import SourceError
from exumi_data.model import ArrayImages, EncodedImages, Sensor
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import to_grey

__all__ = ["add_camera", "add_pads"]


def add_camera(
    writer: EpisodeWriter, name: str, rows: Rows, timeline: Timeline, quality: int | None
) -> int:
    """Store the images of a camera.

    Parameters
    ----------
    writer : EpisodeWriter
    name : str
    rows : Rows
        (T, H, W, 3) or (T, 3, H, W) uint8.
    timeline : Timeline
    quality : int or None
        Of JPEG; None stores pixels.

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    SourceError
        Not one can be decoded.
    """
    shape = picture_shape(rows.meta.shape[1:])
    stream = _open(writer, name, "rgb", shape, timeline, quality, None)
    read = Pass(rows)
    for places, values in read:
        frames = list(map(_picture, values))
        data: Any = (
            np.stack(frames)
            if quality is None
            else [jpeg.encode(frame, quality, chroma="444") for frame in frames]
        )
        stream.append(timeline.time_ns[places], data, flags=_flags(timeline, places))
    read.note(writer, [name])
    if quality is not None:
        note_jpeg(writer, name, rows.meta, quality, 3 if shape is None else shape[2])
    return len(read.good)


def add_pads(
    writer: EpisodeWriter,
    names: Sequence[str],
    sensors: Sequence[Sensor],
    rows: Rows,
    timeline: Timeline,
) -> int:
    """Store the images of a tactile group, a stream a pad, pixel for pixel.

    Parameters
    ----------
    writer : EpisodeWriter
    names : sequence of str
    sensors : sequence of Sensor
    rows : Rows
        (T, N, H, W, 3) or (T, N, H, W) uint8.
    timeline : Timeline

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    SourceError
        Not one can be decoded.
    """
    shape = picture_shape(rows.meta.shape[2:])
    streams = [
        _open(writer, name, "tactile", shape, timeline, None, sensor)
        for name, sensor in zip(names, sensors, strict=True)
    ]
    analyses = [TactileAnalysis() for _ in streams]
    read = Pass(rows)
    for places, values in read:
        flags = _flags(timeline, places)
        for number, (stream, analysis) in enumerate(zip(streams, analyses, strict=True)):
            frames = [_pad(number, row) for row in values]
            for frame in frames:
                analysis.add(to_grey(frame).copy())
            stream.append(timeline.time_ns[places], np.stack(frames), flags=flags)
    read.note(writer, names)
    for number, (stream, analysis) in enumerate(zip(streams, analyses, strict=True)):
        analysis.finish(writer, stream, Reader(rows, read.good, partial(_pad, number)))
    return len(read.good) * len(streams)


def _flags(timeline: Timeline, places: Sequence[int]) -> np.ndarray | None:
    flags = timeline.flags()
    return None if flags is None else flags[places]


def _open(
    writer: EpisodeWriter,
    name: str,
    kind: str,
    shape: tuple[int, int, int] | None,
    timeline: Timeline,
    quality: int | None,
    sensor: Sensor | None,
) -> Any:
    if shape is None:
        raise SourceError(f"stream {name!r}: these are no images")
    height, width, channels = shape
    size: dict[str, Any] = {"height": height, "width": width, "channels": channels}
    images = (
        ArrayImages(encoding="array", **size)
        if quality is None
        else EncodedImages(encoding="encoded", media_type="image/jpeg", **size)
    )
    fields = timeline.fields() if sensor is None else {**timeline.fields(), "sensor": sensor}
    return writer.add_stream(name, kind=kind, images=images, **fields)


def _picture(row: np.ndarray) -> np.ndarray:
    """Return (H, W, C), however the axes lie."""
    if row.ndim == 2:
        return row[..., None]
    return row if row.shape[2] in (1, 3) else np.ascontiguousarray(np.moveaxis(row, 0, 2))


def _pad(number: int, row: np.ndarray) -> np.ndarray:
    return _picture(row[number])
