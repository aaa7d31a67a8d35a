"""Images of an episode of a store: decoded once, stored as pixels or as JPEG."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from exumi_converters.oxt.layout import picture_shape
from exumi_converters.oxt.stamps import Timeline
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_converters.zarr2_files.notes import note_damaged, note_jpeg
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.errors import SourceError
from exumi_data.model import ArrayImages, EncodedImages, Sensor
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import to_grey

__all__ = ["add_camera", "add_pads"]

_BATCH_BYTES = 8 << 20


@dataclass(slots=True)
class _Pad:
    """One stream of images that is being written."""

    name: str
    stream: Any
    quality: int | None
    analysis: TactileAnalysis | None
    frames: list[np.ndarray] = field(default_factory=list)

    def add(self, frame: np.ndarray) -> None:
        if self.analysis is not None:
            self.analysis.add(to_grey(frame).copy())
        self.frames.append(frame)

    def flush(self, time: np.ndarray, flags: np.ndarray | None) -> None:
        data: Any = (
            np.stack(self.frames)
            if self.quality is None
            else [jpeg.encode(frame, self.quality, chroma="444") for frame in self.frames]
        )
        self.stream.append(time, data, **({} if flags is None else {"flags": flags}))
        self.frames = []


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
    pad = _open(writer, name, "rgb", shape, timeline, quality, None)
    count = _write(writer, [pad], rows, timeline)
    if quality is not None:
        note_jpeg(writer, name, rows.meta, quality, 3 if shape is None else shape[2])
    return count


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
    pads = [
        _open(writer, name, "tactile", shape, timeline, None, sensor)
        for name, sensor in zip(names, sensors, strict=True)
    ]
    count = _write(writer, pads, rows, timeline)
    for number, pad in enumerate(pads):
        if pad.analysis is not None:
            pad.analysis.finish(writer, pad.stream, _Reader(rows, number))
    return count * len(pads)


def _open(
    writer: EpisodeWriter,
    name: str,
    kind: str,
    shape: tuple[int, int, int] | None,
    timeline: Timeline,
    quality: int | None,
    sensor: Sensor | None,
) -> _Pad:
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
    stream = writer.add_stream(name, kind=kind, images=images, **fields)
    return _Pad(name, stream, quality, TactileAnalysis() if kind == "tactile" else None)


def _write(writer: EpisodeWriter, pads: list[_Pad], rows: Rows, timeline: Timeline) -> int:
    """Write all frames that can be decoded; say which cannot."""
    places: list[int] = []
    lost: list[tuple[int, str]] = []
    count = waiting = 0
    tactile = pads[0].analysis is not None
    flags = timeline.flags()

    def flush() -> None:
        if places:
            for pad in pads:
                pad.flush(timeline.time_ns[places], None if flags is None else flags[places])
            places.clear()

    for block in rows.blocks():
        if block.values is None:
            lost += [(block.first + i, block.reason) for i in range(block.rows)]
            continue
        for offset, row in enumerate(block.values):
            for number, pad in enumerate(pads):
                pad.add(_picture(row[number] if tactile else row))
            places.append(block.first + offset)
            waiting += row.nbytes
            count += 1
            if waiting >= _BATCH_BYTES:
                flush()
                waiting = 0
    flush()
    note_damaged(writer, [pad.name for pad in pads], lost, count, rows.meta)
    return count


def _picture(row: np.ndarray) -> np.ndarray:
    """Return (H, W, C), however the axes lie."""
    if row.ndim == 2:
        return row[..., None]
    return row if row.shape[2] in (1, 3) else np.ascontiguousarray(np.moveaxis(row, 0, 2))


class _Reader:
    """The frames of a pad that can be decoded, again."""

    def __init__(self, rows: Rows, pad: int) -> None:
        self._rows = rows
        self._pad = pad

    def _frames(self) -> Iterator[np.ndarray]:
        for block in self._rows.blocks():
            for row in () if block.values is None else block.values:
                yield _picture(row[self._pad])

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every frame, (H, W) uint8."""
        return (to_grey(frame) for frame in self._frames())

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Return some frames, ascending."""
        wanted = set(indices)
        return [frame for i, frame in enumerate(self._frames()) if i in wanted]
