"""Images of an episode of a replay buffer: decoded once, and stored with a declared codec."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exumi_converters.frame_files import FrameFiles, add_jpeg_stream, add_lossy
from exumi_converters.image_stream import StreamSpec, describe_clock
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_converters.umi.channels import DIFFERENCES_KIND, Order, differences_of, judge_content
from exumi_converters.umi.numbers import CLOCK
from exumi_converters.zarr2_files.notes import name_some, note_jpeg
from exumi_converters.zarr2_files.pictures import Pass, Reader
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.model import ArrayImages, EncodedImages, LossyStep, QualityNote
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import StreamWriter
from exumi_data.tactile import ACTIVE_THRESHOLD, ACTIVE_THRESHOLD_COMBINED, to_grey
from exumi_data.tactile.wrapping import Jumps
from exumi_data.time import nominal_times

__all__ = ["ImageSettings", "add_camera", "add_tactile"]

_SCHEMA_URL = "https://exumi-data.org/spec/differences/1"
_JPEG_CODEC = "imagecodecs_jpeg"
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


def _note(writer: EpisodeWriter, name: str, read: Pass, blank: Sequence[int]) -> None:
    """Say what is the matter with frames.

    Raises
    ------
    SourceError
        There is not one.
    """
    read.note(writer, [name])
    if blank:
        total = len(read.good) + len(read.lost)
        named = name_some(list(map(str, blank)))
        writer.metadata.quality.append(
            QualityNote(
                code="blank-frames",
                message=f"{len(blank)} of {total} frames are black throughout, as where "
                f"writing the buffer failed: {named}",
                stream=name,
            )
        )


def _blank(places: Sequence[int], frames: Sequence[np.ndarray]) -> list[int]:
    return [place for place, pixels in zip(places, frames, strict=True) if not pixels.any()]


def _times(rows: Rows, settings: ImageSettings) -> np.ndarray:
    return nominal_times(len(rows), settings.rate)


def _describe(stream: StreamWriter, read: Pass, settings: ImageSettings) -> None:
    times = _times(read.rows, settings)[read.good]
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
    times, read, blank = _times(rows, settings), Pass(rows), []
    for places, frames in read:
        blank += _blank(places, frames)
        stream.append(times[places], _stored(frames, settings))
    _note(writer, name, read, blank)
    _describe(stream, read, settings)
    if not settings.lossless:
        note_jpeg(writer, name, rows.meta, settings.quality, channels)
    return len(read.good)


def _stored(frames: Sequence[np.ndarray], settings: ImageSettings) -> Any:
    if settings.lossless:
        return np.stack(frames)
    return [jpeg.encode(pixels, settings.quality, chroma="444") for pixels in frames]


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
    analysis = TactileAnalysis(active_above=_active_above(name))
    times, read, blank = _times(rows, settings), Pass(rows), []
    for places, frames in read:
        blank += _blank(places, frames)
        for pixels in frames:
            analysis.add(to_grey(pixels).copy())
        stream.append(times[places], np.stack(frames))
    _note(writer, name, read, blank)
    _describe(stream, read, settings)
    analysis.finish(writer, stream, Reader(rows, read.good, lambda pixels: pixels))
    return len(read.good)


def _active_above(name: str) -> float:
    return ACTIVE_THRESHOLD_COMBINED if "combined" in name else ACTIVE_THRESHOLD


def _content(rows: Rows, settings: ImageSettings) -> Order | str:
    if settings.content == "pictures" or rows.meta.shape[3] != 3:
        return "pictures"
    places = np.unique(np.linspace(0, len(rows) - 1, min(_SAMPLES, len(rows))).astype(int))
    samples = [block.values for i in places for block in rows.slice(i, i + 1).blocks()]
    found = judge_content([values[0] for values in samples if values is not None])
    if settings.content == "channels" and not isinstance(found, Order):
        return Order(concave=0, convex=1, grey=2)
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
        differences_of(name),
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
    analysis = TactileAnalysis(active_above=_active_above(name))
    jumps = Jumps(_JUMP_ROWS, _JUMP_APART_PX)
    times, read, blank = _times(rows, settings), Pass(rows), []
    for places, frames in read:
        blank += _blank(places, frames)
        for pixels in frames:
            analysis.add(np.ascontiguousarray(pixels[..., order.grey]))
            if not settings.exported and _is_strong(pixels, order):
                jumps.add(pixels[..., [order.concave, order.convex, order.grey]])
        whole = np.stack(frames)
        grey_stream.append(times[places], whole[..., order.grey, None])
        differences.append(times[places], whole[..., [order.concave, order.convex]])
    _note(writer, name, read, blank)
    for stream in (grey_stream, differences):
        _describe(stream, read, settings)
    again = Reader(rows, read.good, lambda row: row[..., order.grey, None], order.grey)
    analysis.finish(writer, grey_stream, again)
    if not settings.exported:
        _note_released(writer, name, order, jumps)
    return len(read.good)


def _names(order: Order) -> list[str]:
    found = {order.concave: "concave", order.convex: "convex", order.grey: "grey"}
    return [found[channel] for channel in range(3)]


def _is_strong(pixels: np.ndarray, order: Order) -> bool:
    """Whether a frame has differences that could have wrapped."""
    return bool(max(pixels[..., order.concave].max(), pixels[..., order.convex].max()) > 128)


def _note_released(writer: EpisodeWriter, name: str, order: Order, jumps: Jumps) -> None:
    """Say what exUMI's released pipeline did to these images, and what of it shows."""
    by = "exUMI's released pipeline"
    differences = differences_of(name)
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
