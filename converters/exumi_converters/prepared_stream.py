"""One image stream of a training set: frames and reference fitted, activity measured."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from exumi_converters.frame_files import add_lossy
from exumi_converters.prepare_settings import PrepareSettings
from exumi_converters.resize import interpolation
from exumi_data import standard
from exumi_data.episode import StreamView
from exumi_data.errors import UnsupportedError
from exumi_data.model import (
    ArrayImages,
    Clock,
    EncodedImages,
    Images,
    LossyStep,
    QualityNote,
    Reference,
    TactileStream,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import DataStreamWriter, EncodedStreamWriter
from exumi_data.tactile import ACTIVITY_METHOD, ActivityMeter, to_grey

__all__ = [
    "BESIDE_TIME",
    "Making",
    "Measure",
    "carried_fields",
    "grey_step",
    "images_of_view",
    "jpeg_step",
    "measure_copied",
    "refuse_unknown_arrays",
    "resize_step",
    "write_made",
]

BESIDE_TIME = ("time_host", "time_device", "sequence", "flags")
_BATCH = 32
_OF_IMAGES = {"images", "arrays", "reference", "mm_per_px", "kind", "clock"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """How the activity of a stream's frames is to be measured.

    Attributes
    ----------
    active_above : float
        Put on record with the values.
    inputs : tuple of str
        Paths of the arrays that it is computed from.
    """

    active_above: float
    inputs: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Making:
    """An image stream that is to be made: what its frames are, and what is said of them.

    Attributes
    ----------
    name, kind : str
    time : (N,) int64
    beside : dict of str to ndarray
        Arrays beside `time`.
    frames : callable
        Yields N frames (H, W, C) uint8 in the sensor's resolution, rectified if they are to be.
    look : callable or None
        Gives an image of the parent's stream the look that `frames` have; None where they are of
        several streams.
    fit : callable
        Gives a frame the size of the training set.
    images : ImageMetadata
        Of the stream that they come from.
    channels : {1, 3}
        Of the frames as they are yielded.
    fields : dict
        The other fields of the stream's metadata.
    reference : (H, W, C) uint8 or None
        As `frames` would yield it.
    about_reference : Reference or None
    steps : tuple of LossyStep
        What is lost on the way, in order.
    measure : Measure or None
        None: activity is not measured here.
    notes : sequence of QualityNote
        What a user should know of it.
    """

    name: str
    kind: str
    time: np.ndarray
    beside: dict[str, np.ndarray]
    frames: Callable[[], Iterator[np.ndarray]]
    look: Callable[[np.ndarray], np.ndarray] | None
    fit: Callable[[np.ndarray], np.ndarray]
    images: Images
    channels: Literal[1, 3]
    fields: dict[str, Any]
    reference: np.ndarray | None
    about_reference: Reference | None
    steps: Sequence[LossyStep]
    measure: Measure | None
    notes: Sequence[QualityNote] = ()


def write_made(making: Making, writer: EpisodeWriter, settings: PrepareSettings) -> None:
    """Write a stream, and what is derived from it.

    Parameters
    ----------
    making : Making
    writer : EpisodeWriter
    settings : PrepareSettings
    """
    stream = writer.add_stream(
        making.name,
        kind=making.kind,
        images=_target(making.images, settings, making.channels),
        **making.fields,
    )
    _set_reference(making, stream)
    meter = None
    if making.measure is not None and making.reference is not None:
        meter = ActivityMeter(making.reference)
    activity: list[float] = []
    frames = making.frames()
    for rows in _batches(len(making.time)):
        batch = [next(frames) for _ in range(rows.start, rows.stop)]
        if meter is not None:
            activity += [meter.measure(to_grey(frame)) for frame in batch]
        fitted = [making.fit(frame) for frame in batch]
        extra = {name: values[rows] for name, values in making.beside.items()}
        if settings.quality is None:
            stream.append(making.time[rows], np.stack(fitted), **extra)
        else:
            files = [jpeg.encode(frame, settings.quality) for frame in fitted]
            stream.append(making.time[rows], files, **extra)
    for step in making.steps:
        add_lossy(writer, step)
    writer.metadata.quality = [*writer.metadata.quality, *making.notes]
    if meter is not None and making.measure is not None:
        _add_activity(making.name, making.measure, meter, activity, writer)


def measure_copied(view: StreamView, measure: Measure, writer: EpisodeWriter) -> None:
    """Measure the activity of a stream that is taken over as it is.

    Parameters
    ----------
    view : StreamView
        Tactile, with a reference.
    measure : Measure
    writer : EpisodeWriter
    """
    if view.reference is None:
        return
    meter = ActivityMeter(view.reference)
    activity = [meter.measure(to_grey(frame)) for frame in view.frames.iterate(grey=True)]
    _add_activity(view.name, measure, meter, activity, writer)


def _add_activity(
    name: str,
    measure: Measure,
    meter: ActivityMeter,
    activity: Sequence[float],
    writer: EpisodeWriter,
) -> None:
    writer.add_derived(
        name,
        "activity",
        np.array(activity, dtype=np.float32),
        algorithm=ACTIVITY_METHOD,
        parameters={
            "threshold": meter.threshold,
            "size": meter.size,
            "active_above": measure.active_above,
        },
        inputs=list(measure.inputs),
    )


def _batches(count: int) -> Iterator[slice]:
    for start in range(0, count, _BATCH):
        yield slice(start, min(start + _BATCH, count))


def _target(
    source: Images, settings: PrepareSettings, channels: Literal[1, 3]
) -> ArrayImages | EncodedImages:
    size = {"height": settings.size, "width": settings.size, "channels": channels}
    # Keys that we do not know are carried along.
    fields = {**size, **(source.model_extra or {})}
    context = {"newer_minor": source.is_newer_minor}
    if settings.quality is None:
        return ArrayImages.model_validate({**fields, "encoding": "array"}, context=context)
    of_files = {"encoding": "encoded", "media_type": "image/jpeg"}
    return EncodedImages.model_validate({**fields, **of_files}, context=context)


def _set_reference(making: Making, stream: DataStreamWriter | EncodedStreamWriter) -> None:
    """Store the reference, taken through the same steps as the frames."""
    image, about = making.reference, making.about_reference
    if image is None or about is None:
        return
    stream.set_reference(making.fit(image), method=about.method)
    if isinstance(stream.model, TactileStream):
        stream.model.reference = about.model_copy(deep=True)


# ------------------------------------------------------------------------------ what a parent says


def images_of_view(view: StreamView) -> Images:
    """Return how the frames of an image stream are stored."""
    images: Images = view.metadata.images  # type: ignore[attr-defined]  # the caller asked for image streams
    return images


def refuse_unknown_arrays(view: StreamView) -> None:
    """Refuse arrays of a newer version: nobody knows whether they fit to other frames.

    Raises
    ------
    UnsupportedError
        There is one.
    """
    known = {"time", "reference", *BESIDE_TIME}
    known |= standard.encodings()[images_of_view(view).encoding].arrays.keys()
    unknown = sorted(set(view.metadata.arrays) - known)
    if unknown:
        raise UnsupportedError(
            f"stream {view.name!r} has arrays that this library does not know: "
            f"{', '.join(unknown)}",
            fix='Upgrade with: pip install -U "exumi-data"',
        )


def carried_fields(view: StreamView) -> dict[str, Any]:
    """Return the fields of a stream's metadata that have nothing to do with its pixels."""
    model = view.metadata
    fields = {name: getattr(model, name) for name in model.model_fields_set - _OF_IMAGES}
    return {"clock": _carried_clock(model.clock), **fields}


def _carried_clock(clock: Clock) -> Clock:
    """Return a clock for times that are kept without the pts that they were computed from.

    Where a video's frames are stored one by one, its times follow from nothing any more: how they
    were had, and how well, still holds.
    """
    if clock.raw_time is not None:
        return clock
    return clock.model_copy(
        update={"t_ref_ns": 0, "offset_ns": 0, "drift_ppm": 0.0, "latency_ns": 0}
    )


# --------------------------------------------------------------------------------- what is lost


def grey_step(stream: str) -> LossyStep:
    """Return the step at which colour is dropped."""
    detail = "colour was dropped: the frames' luma was kept"
    return LossyStep(step="grey", stream=stream, detail=detail)


def resize_step(stream: str, height: int, width: int, size: int) -> LossyStep | None:
    """Return the step at which frames are resized to a square; None if they are one."""
    if (height, width) == (size, size):
        return None
    method = interpolation(height, width, size)
    return LossyStep(
        step="resize",
        stream=stream,
        detail=f"frames and reference were resized from {width}x{height} to {size}x{size} pixels "
        f"({method})",
        parameters={"from": [width, height], "to": [size, size], "interpolation": method},
    )


def jpeg_step(
    stream: str, encoding: str, channels: int, settings: PrepareSettings
) -> LossyStep | None:
    """Return the step at which frames become JPEG; None if they are stored without loss."""
    if settings.quality is None:
        return None
    colour = {} if channels == 1 else {"subsampling": "4:2:0"}
    chroma = "" if not colour else ", chroma subsampled 4:2:0"
    was = {"video": "decoded from video and ", "encoded": "decoded from JPEG and "}
    return LossyStep(
        step="jpeg-encode",
        stream=stream,
        detail=f"frames were {was.get(encoding, '')}encoded as JPEG, quality "
        f"{settings.quality}{chroma}",
        parameters={"quality": settings.quality, **colour},
    )
