"""Images of an episode of a replay buffer: decoded once, and stored with a declared codec."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from exumi_converters.frame_files import FrameFiles, add_jpeg_stream, add_lossy
from exumi_converters.image_stream import StreamSpec, describe_clock
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_converters.umi.channels import DIFFERENCES_KIND, Order, judge_content
from exumi_converters.umi.numbers import CLOCK
from exumi_converters.zarr2_files.metadata import ArrayMeta
from exumi_converters.zarr2_files.notes import name_some, note_damaged, note_jpeg
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.model import ArrayImages, EncodedImages, LossyStep, QualityNote
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import StreamWriter
from exumi_data.tactile import ACTIVE_THRESHOLD, ACTIVE_THRESHOLD_COMBINED, to_grey
from exumi_data.tactile.wrapping import Jumps
from exumi_data.time import nominal_times

__all__ = ["DIFFERENCES", "ImageSettings", "add_camera", "add_tactile"]

DIFFERENCES = "differences"
"""What the stream of concave and convex is called, after that of the grey image."""

_SCHEMA_URL = "https://exumi-data.org/spec/differences/1"
_JPEG_CODEC = "imagecodecs_jpeg"
_BATCH_BYTES = 8 << 20
_SAMPLES = 9
# As rule TACT-011 of the standard has them.
_JUMP_ROWS, _JUMP_APART_PX = 16, 2
_JUMPS, _JUMPS_PER_10000, _JUMPS_PER_STEP = 10, 2.0, 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageSettings:
    """How images are stored.

    Attributes
    ----------
    rate : Fraction
        Rows a second.
    lossless : bool
        Pixels instead of JPEG, for cameras; tactile images are always pixels.
    quality : int
        Of JPEG.
    content : {"auto", "channels", "pictures"}
        What tactile images of three channels hold.
    exported : bool
        Whether this package made the buffer: then its tactile channels are known to be sound.
    """

    rate: Fraction
    lossless: bool
    quality: int
    content: str
    exported: bool


class _Frame(NamedTuple):
    place: int
    pixels: np.ndarray | None
    reason: str


def _frames(rows: Rows, *, channel: int | None = None) -> Iterator[_Frame]:
    for block in rows.blocks(channel=channel):
        for offset in range(block.rows):
            pixels = None if block.values is None else block.values[offset]
            yield _Frame(block.first + offset, pixels, block.reason)


@dataclass(slots=True)
class _Found:
    """What a pass over the frames found out."""

    good: list[int] = field(default_factory=list)
    lost: list[tuple[int, str]] = field(default_factory=list)
    blank: list[int] = field(default_factory=list)

    def good_frames(self, rows: Rows) -> Iterator[np.ndarray]:
        for frame in _frames(rows):
            if frame.pixels is None:
                self.lost.append((frame.place, frame.reason))
                continue
            self.good.append(frame.place)
            if not frame.pixels.any():
                self.blank.append(frame.place)
            yield frame.pixels

    def note(self, writer: EpisodeWriter, stream: str, meta: ArrayMeta) -> None:
        """Say what is the matter with frames.

        Raises
        ------
        SourceError
            There is not one.
        """
        note_damaged(writer, [stream], self.lost, len(self.good), meta)
        if self.blank:
            total = len(self.good) + len(self.lost)
            named = name_some(list(map(str, self.blank)))
            writer.metadata.quality.append(
                QualityNote(
                    code="blank-frames",
                    message=f"{len(self.blank)} of {total} frames are black throughout, as where "
                    f"writing the buffer failed: {named}",
                    stream=stream,
                )
            )


class _Batch:
    """Frames are handed over some at a time."""

    def __init__(self, times: np.ndarray, found: _Found, append: Callable[..., Any]) -> None:
        self._times = times
        self._found = found
        self._append = append
        self._items: list[Any] = []
        self._bytes = 0

    def add(self, item: Any, size: int) -> None:
        self._items.append(item)
        self._bytes += size
        if self._bytes >= _BATCH_BYTES:
            self.flush()

    def flush(self) -> None:
        if self._items:
            indices = self._found.good[-len(self._items) :]
            self._append(self._times[indices], self._items)
            self._items, self._bytes = [], 0


def _times(rows: Rows, settings: ImageSettings) -> np.ndarray:
    return nominal_times(len(rows), settings.rate)


def _describe(stream: StreamWriter, found: _Found, rows: Rows, settings: ImageSettings) -> None:
    times = _times(rows, settings)[found.good]
    describe_clock(stream, times, settings.rate, 1 / settings.rate, source="none")


def add_camera(writer: EpisodeWriter, name: str, rows: Rows, settings: ImageSettings) -> int:
    """Store the images of a camera.

    Parameters
    ----------
    writer : EpisodeWriter
    name : str
    rows : Rows
    settings : ImageSettings

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    SourceError
        Not one can be decoded.
    """
    if _has_jpeg(rows, settings):
        return _keep_jpeg(writer, name, rows, settings)
    height, width, channels = rows.meta.shape[1:]
    size: dict[str, Any] = {"height": height, "width": width, "channels": channels}
    images = (
        ArrayImages(encoding="array", **size)
        if settings.lossless
        else EncodedImages(encoding="encoded", media_type="image/jpeg", **size)
    )
    stream = writer.add_stream(name, kind="rgb", clock=CLOCK, images=images)
    found = _Found()
    batch = _Batch(_times(rows, settings), found, _appender(stream, lossless=settings.lossless))
    for pixels in found.good_frames(rows):
        item: Any = pixels
        if not settings.lossless:
            item = jpeg.encode(pixels, settings.quality, chroma="444")
        batch.add(item, pixels.nbytes)
    batch.flush()
    found.note(writer, name, rows.meta)
    _describe(stream, found, rows, settings)
    if not settings.lossless:
        note_jpeg(writer, name, rows.meta, settings.quality, channels)
    return len(found.good)


def _appender(stream: Any, *, lossless: bool) -> Callable[[np.ndarray, list[Any]], None]:
    if not lossless:
        append: Callable[[np.ndarray, list[Any]], None] = stream.append
        return append
    return lambda times, frames: stream.append(times, np.stack(frames))


def _has_jpeg(rows: Rows, settings: ImageSettings) -> bool:
    """Whether the buffer holds JPEG files that can be kept as they are."""
    if rows.meta.codec != _JPEG_CODEC or rows.meta.filters or not rows.is_chunk_a_row:
        return False
    if settings.lossless or not len(rows):
        return False
    first = rows.stored(0)
    try:
        return first is not None and jpeg.size_of(first) == rows.meta.shape[1:]
    except Exception:  # noqa: BLE001  # then it is decoded like any other
        return False


def _keep_jpeg(writer: EpisodeWriter, name: str, rows: Rows, settings: ImageSettings) -> int:
    def read() -> Iterator[tuple[int, bytes]]:
        for index in range(len(rows)):
            yield index, rows.stored(index) or b""

    files = FrameFiles(read, 1 / settings.rate, settings.rate, rows.meta.path, clock="none")
    return add_jpeg_stream(writer, StreamSpec(name=name, kind="rgb"), files).stream.count


def add_tactile(writer: EpisodeWriter, name: str, rows: Rows, settings: ImageSettings) -> int:
    """Store tactile images: pixel for pixel, whatever they hold.

    Of exUMI's three channels the grey one is an image of the two fingers: a tactile stream. Concave
    and convex were computed, and cannot be computed again without the reference that nobody kept:
    they go beside it, into a stream of a kind of their own.

    Parameters
    ----------
    writer : EpisodeWriter
    name : str
    rows : Rows
    settings : ImageSettings

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    SourceError
        Not one can be decoded.
    """
    content = _content(rows, settings)
    if isinstance(content, Order):
        return _add_channels(writer, name, rows, settings, content)
    height, width, channels = rows.meta.shape[1:]
    stream = writer.add_stream(
        name,
        kind="tactile",
        clock=CLOCK,
        images=ArrayImages(
            encoding="array", height=height, width=width, channels=1 if channels == 1 else 3
        ),
    )
    found, analysis = _Found(), TactileAnalysis(active_above=_active_above(name))
    batch = _Batch(_times(rows, settings), found, _appender(stream, lossless=True))
    for pixels in found.good_frames(rows):
        analysis.add(to_grey(pixels).copy())
        batch.add(pixels, pixels.nbytes)
    batch.flush()
    found.note(writer, name, rows.meta)
    _describe(stream, found, rows, settings)
    analysis.finish(writer, stream, _Reader(rows, found.good))
    return len(found.good)


def _active_above(name: str) -> float:
    return ACTIVE_THRESHOLD_COMBINED if "combined" in name else ACTIVE_THRESHOLD


def _content(rows: Rows, settings: ImageSettings) -> Order | str:
    if settings.content == "pictures" or rows.meta.shape[3] != 3:
        return "pictures"
    places = np.unique(np.linspace(0, len(rows) - 1, min(_SAMPLES, len(rows))).astype(int))
    samples = [frame.pixels for i in places for frame in _frames(rows.slice(i, i + 1))]
    found = judge_content([pixels for pixels in samples if pixels is not None])
    if settings.content == "channels" and not isinstance(found, Order):
        return Order(concave=0, convex=1, grey=2)
    return found


class _Reader:
    """The good frames again; of exUMI's channels, the grey one."""

    def __init__(self, rows: Rows, good: Sequence[int], channel: int | None = None) -> None:
        self._rows = rows
        self._good = good
        self._channel = channel

    def _picture(self, pixels: np.ndarray) -> np.ndarray:
        return pixels if self._channel is None else pixels[..., self._channel, None]

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every frame, (H, W) uint8."""
        good = set(self._good)
        for frame in _frames(self._rows, channel=self._channel):
            if frame.place in good and frame.pixels is not None:
                yield to_grey(np.ascontiguousarray(self._picture(frame.pixels)))

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Return some frames, ascending."""
        found = []
        for index in sorted(set(indices)):
            place = self._good[index]
            (frame,) = _frames(self._rows.slice(place, place + 1), channel=self._channel)
            if frame.pixels is not None:
                found.append(np.ascontiguousarray(self._picture(frame.pixels)))
        return found


def _add_channels(
    writer: EpisodeWriter, name: str, rows: Rows, settings: ImageSettings, order: Order
) -> int:
    height, width = rows.meta.shape[1:3]
    grey_stream = writer.add_stream(
        name,
        kind="tactile",
        clock=CLOCK,
        images=ArrayImages(encoding="array", height=height, width=width, channels=1),
        description="Both fingers in one image, left beside right.",
    )
    differences = writer.add_stream(
        f"{name}_{DIFFERENCES}",
        kind=DIFFERENCES_KIND,
        clock=CLOCK,
        extension_version="1",
        schema_url=_SCHEMA_URL,
        description=f"How much darker (concave) and brighter (convex) than a reference each pixel "
        f"of {name} was, times 7, as the buffer has it.",
        **{
            "exumi:of": name,
            "exumi:channels": ["concave", "convex"],
            "exumi:stored_order": _names(order),
        },
    )
    found, analysis = _Found(), TactileAnalysis(active_above=_active_above(name))
    jumps = Jumps(_JUMP_ROWS, _JUMP_APART_PX)

    def append(times: np.ndarray, frames: list[np.ndarray]) -> None:
        whole = np.stack(frames)
        grey_stream.append(times, whole[..., order.grey, None])
        differences.append(times, whole[..., [order.concave, order.convex]])

    batch = _Batch(_times(rows, settings), found, append)
    for pixels in found.good_frames(rows):
        analysis.add(np.ascontiguousarray(pixels[..., order.grey]))
        if not settings.exported and _is_strong(pixels, order):
            jumps.add(pixels[..., [order.concave, order.convex, order.grey]])
        batch.add(pixels, pixels.nbytes)
    batch.flush()
    found.note(writer, name, rows.meta)
    for stream in (grey_stream, differences):
        _describe(stream, found, rows, settings)
    analysis.finish(writer, grey_stream, _Reader(rows, found.good, order.grey))
    if not settings.exported:
        _note_released(writer, name, order, jumps)
    return len(found.good)


def _names(order: Order) -> list[str]:
    found = {order.concave: "concave", order.convex: "convex", order.grey: "grey"}
    return [found[channel] for channel in range(3)]


def _is_strong(pixels: np.ndarray, order: Order) -> bool:
    """Whether a frame has differences that could have wrapped."""
    return bool(max(pixels[..., order.concave].max(), pixels[..., order.convex].max()) > 128)


def _note_released(writer: EpisodeWriter, name: str, order: Order, jumps: Jumps) -> None:
    """Say what exUMI's released pipeline did to these images, and what of it shows."""
    by = "exUMI's released pipeline"
    differences = f"{name}_{DIFFERENCES}"
    steps = {
        name: (
            ("blend", "frames of the sensors were blended linearly at the times of the camera's"),
            ("video-encode", "written as MPEG-4 video, 4:2:0, together with the differences, at 59 "
             "instead of 59.94 frames/s (frames were then counted, so times did not move)"),
            ("combine", "rectified, cropped, turned by 90 degrees, left beside right, and resized"),
        ),
        differences: (
            ("difference", "the reference was the first frame of the video, whether it touched or "
             "not, and was not kept; differences were multiplied by 7 in 8 bits without clamping: "
             "those above 36 grey levels wrapped"),
            ("video-encode", "written as the chroma of 4:2:0 video: half the resolution"),
        ),
    }  # fmt: skip
    for stream, found in steps.items():
        for step, detail in found:
            add_lossy(writer, LossyStep(step=step, stream=stream, detail=detail, by=by))
    add = writer.metadata.quality.append
    if order.grey == 2:
        add(
            QualityNote(
                code="reversed-channels",
                message="the buffer has concave, convex, grey: the order was reversed when it was "
                "made (written as BGR, read as RGB); here each has its name",
                stream=differences,
                severity="info",
            )
        )
    per_pair, per_step = jumps.rates()
    if (
        int(jumps.jumps.max()) >= _JUMPS
        and per_pair > _JUMPS_PER_10000
        and per_step > _JUMPS_PER_STEP
    ):
        add(
            QualityNote(
                code="wrapped-differences",
                message=f"the level jumps by more than 128 between {per_pair:.1f} of 10,000 near "
                "pixels: differences wrapped in 8 bits. The grey image is not affected",
                stream=differences,
            )
        )
