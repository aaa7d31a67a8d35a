"""One episode made ready for training: frames resized once, everything else carried along."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from exumi_converters.frame_files import add_lossy
from exumi_converters.resize import interpolation, resize
from exumi_data import standard
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UnsupportedError
from exumi_data.model import (
    ArrayImages,
    EncodedImages,
    Images,
    LossyStep,
    TactileStream,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import DataStreamWriter, EncodedStreamWriter
from exumi_data.tactile import to_grey

__all__ = ["PrepareSettings", "write_prepared"]

_BATCH = 32
_BESIDE_TIME = ("time_host", "time_device", "sequence", "flags")
_OF_IMAGES = {"images", "arrays", "reference", "mm_per_px", "kind", "clock"}


@dataclass(frozen=True, slots=True)
class PrepareSettings:
    """How frames are made ready.

    Attributes
    ----------
    size : int
        Edge of the square frames, pixels.
    gray : bool
        Keep the luma of tactile streams only.
    quality : int or None
        Of the JPEGs; None stores pixels without loss.
    """

    size: int
    gray: bool
    quality: int | None

    def to_json(self) -> dict[str, Any]:
        """Return the settings as they are put on record."""
        how = {"lossless": True} if self.quality is None else {"quality": self.quality}
        return {"size": self.size, "gray": self.gray, **how}


def write_prepared(parent: Episode, writer: EpisodeWriter, settings: PrepareSettings) -> int:
    """Write the streams of a prepared episode.

    Parameters
    ----------
    parent : Episode
        Complete (`Episode.check_complete`).
    writer : EpisodeWriter
    settings : PrepareSettings

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    DamagedDataError
        A frame of the parent cannot be read.
    UnsupportedError
        A stream whose frames are written anew has an array of a newer version.
    """
    frames = 0
    for name, view in parent.streams.items():
        if view.is_image:
            frames += len(view)
        if not view.is_image or _is_ready(view, settings):
            writer.copy_stream(parent, name)
        else:
            _write_frames(view, writer, settings)
    groups = {path.partition("/")[0] for path in parent.store.paths()}
    if "calibration" in groups:
        writer.copy_group(parent, "calibration")
    if "annotations" in groups:
        writer.copy_group(parent, "annotations")
    _carry_derived(parent, writer)
    return frames


def _images(view: StreamView) -> Images:
    images: Images = view.metadata.images  # type: ignore[attr-defined]  # the caller asked for image streams
    return images


def _channels(view: StreamView, settings: PrepareSettings) -> Literal[1, 3]:
    drop_colour = settings.gray and view.kind == "tactile"
    return 1 if drop_colour else _images(view).channels


def _is_ready(view: StreamView, settings: PrepareSettings) -> bool:
    """Whether a stream is as it should be: it is copied then, for every coding loses something."""
    images = _images(view)
    size = images.height == images.width == settings.size
    if not size or images.channels != _channels(view, settings):
        return False
    return images.encoding == "encoded" or (images.encoding == "array" and settings.quality is None)


def _write_frames(view: StreamView, writer: EpisodeWriter, settings: PrepareSettings) -> None:
    _refuse_unknown_arrays(view)
    source, channels = _images(view), _channels(view, settings)
    drop_colour = channels < source.channels
    stream = writer.add_stream(
        view.name,
        kind=view.kind,
        clock=view.metadata.clock,
        images=_target(source, settings, channels),
        **_carried_fields(view, settings),
    )
    _set_reference(view, stream, settings, grey=drop_colour)
    frames = view.frames.iterate(grey=drop_colour)
    beside = {name: view.array(name) for name in _BESIDE_TIME if name in view.metadata.arrays}
    for rows in _batches(len(view)):
        resized = [resize(next(frames), settings.size) for _ in range(rows.start, rows.stop)]
        extra = {name: values[rows] for name, values in beside.items()}
        if settings.quality is None:
            stream.append(view.time[rows], np.stack(resized), **extra)
        else:
            files = [jpeg.encode(frame, settings.quality) for frame in resized]
            stream.append(view.time[rows], files, **extra)
    _note_losses(view, writer, settings, drop_colour=drop_colour)


def _batches(count: int) -> Iterator[slice]:
    for start in range(0, count, _BATCH):
        yield slice(start, min(start + _BATCH, count))


def _refuse_unknown_arrays(view: StreamView) -> None:
    """Refuse arrays of a newer version: nobody knows whether they fit to resized frames."""
    known = {"time", "reference", *_BESIDE_TIME}
    known |= standard.encodings()[_images(view).encoding].arrays.keys()
    unknown = sorted(set(view.metadata.arrays) - known)
    if unknown:
        raise UnsupportedError(
            f"stream {view.name!r} has arrays that this library does not know: "
            f"{', '.join(unknown)}",
            fix='Upgrade with: pip install -U "exumi-data"',
        )


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


def _carried_fields(view: StreamView, settings: PrepareSettings) -> dict[str, Any]:
    """Return the fields of a stream's metadata that its frames' size does not change."""
    model, images = view.metadata, _images(view)
    fields = {name: getattr(model, name) for name in model.model_fields_set - _OF_IMAGES}
    if isinstance(model, TactileStream) and model.mm_per_px is not None:
        across, down = model.mm_per_px
        fields["mm_per_px"] = [
            across * images.width / settings.size,
            down * images.height / settings.size,
        ]
    return fields


def _set_reference(
    view: StreamView,
    stream: DataStreamWriter | EncodedStreamWriter,
    settings: PrepareSettings,
    *,
    grey: bool,
) -> None:
    """Store the parent's reference, taken through the same steps as the frames."""
    image = view.reference if view.kind == "tactile" else None
    model = view.metadata
    if image is None or not isinstance(model, TactileStream) or model.reference is None:
        return
    if grey:
        image = to_grey(image)[..., None]
    stream.set_reference(resize(image, settings.size), method=model.reference.method)
    if isinstance(stream.model, TactileStream):
        stream.model.reference = model.reference.model_copy(deep=True)


def _note_losses(
    view: StreamView, writer: EpisodeWriter, settings: PrepareSettings, *, drop_colour: bool
) -> None:
    images, size = _images(view), settings.size
    if drop_colour:
        detail = "colour was dropped: the frames' luma was kept"
        add_lossy(writer, LossyStep(step="grey", stream=view.name, detail=detail))
    if (images.height, images.width) != (size, size):
        method = interpolation(images.height, images.width, size)
        add_lossy(
            writer,
            LossyStep(
                step="resize",
                stream=view.name,
                detail=f"frames and reference were resized from {images.width}x{images.height} to "
                f"{size}x{size} pixels ({method})",
                parameters={
                    "from": [images.width, images.height],
                    "to": [size, size],
                    "interpolation": method,
                },
            ),
        )
    if settings.quality is not None:
        colour = {} if _channels(view, settings) == 1 else {"subsampling": "4:2:0"}
        chroma = "" if not colour else ", chroma subsampled 4:2:0"
        was = {"video": "decoded from video and ", "encoded": "decoded from JPEG and "}
        add_lossy(
            writer,
            LossyStep(
                step="jpeg-encode",
                stream=view.name,
                detail=f"frames were {was.get(images.encoding, '')}encoded as JPEG, quality "
                f"{settings.quality}{chroma}",
                parameters={"quality": settings.quality, **colour},
            ),
        )


def _carry_derived(parent: Episode, writer: EpisodeWriter) -> None:
    """Carry derived arrays along: they say something of the frames as they were."""
    if parent.derived is None:
        return
    writer.derived = parent.derived.model_copy(deep=True)
    for key, item in parent.derived.items.items():
        values = parent.derived_array(key)
        if values is None:
            continue
        stream, _, name = key.partition("/")
        writer.add_derived(
            stream,
            name,
            values,
            algorithm=item.algorithm,
            parameters=item.parameters,
            inputs=[f"{parent.id}/{path}" for path in item.inputs],
            **(item.model_extra or {}),
        )
