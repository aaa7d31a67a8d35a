"""How each image stream of an episode becomes one of a training set, by itself."""

import hashlib
from collections.abc import Iterator
from functools import partial
from typing import Any, Literal

import numpy as np

from exumi_converters.prepare_settings import PrepareSettings
from exumi_converters.prepared_reference import find_reference
from exumi_converters.prepared_stream import (
    BESIDE_TIME,
    Making,
    Measure,
    carried_fields,
    grey_step,
    images_of_view,
    jpeg_step,
    refuse_unknown_arrays,
    resize_step,
)
from exumi_converters.resize import resize
from exumi_data.calibration import intrinsics_of, rectification_of
from exumi_data.camera import Undistorter, pinhole, resized
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UsageError
from exumi_data.model import LossyStep, TactileStream
from exumi_data.model.calibration import RECTIFICATION, Intrinsics
from exumi_data.tactile import ACTIVE_THRESHOLD, to_grey
from exumi_data.tactile.rectification import PixelMap, Rectifier

__all__ = [
    "camera_afterwards",
    "channels_of",
    "is_ready",
    "making_of",
    "measure_of",
    "measured_anew",
    "rectify_step",
    "scale_of",
]


def channels_of(view: StreamView, settings: PrepareSettings) -> Literal[1, 3]:
    """Return how many channels the frames of a stream will have."""
    drop_colour = settings.gray and view.kind == "tactile"
    return 1 if drop_colour else images_of_view(view).channels


def measured_anew(parent: Episode, view: StreamView, settings: PrepareSettings) -> bool:
    """Whether activity is measured: there is none yet, or frames are rectified and it changes."""
    if view.kind != "tactile":
        return False
    if "reference" not in view.metadata.arrays and (
        is_ready(parent, view, settings) or not len(view)
    ):
        return False  # what is copied gets no reference
    stored = parent.derived is not None and f"{view.name}/activity" in parent.derived.items
    return not stored or RECTIFICATION + view.name in parent.metadata.calibration


def is_ready(parent: Episode, view: StreamView, settings: PrepareSettings) -> bool:
    """Whether a stream is as it should be: it is copied then, for every coding loses something."""
    images = images_of_view(view)
    size = images.height == images.width == settings.size
    if not size or images.channels != channels_of(view, settings):
        return False
    if view.kind == "tactile" and RECTIFICATION + view.name in parent.metadata.calibration:
        return False
    if view.kind == "rgb" and settings.rgb == "rectify":
        camera = intrinsics_of(parent, view.name)
        if camera is None or not _is_alike(camera, pinhole(settings.size, settings.fov_deg)):
            return False
    return images.encoding == "encoded" or (images.encoding == "array" and settings.quality is None)


def _is_alike(camera: Intrinsics, other: Intrinsics) -> bool:
    """Whether two cameras see the same, to a hundredth of a pixel."""
    one, two = (np.array([c.fx, c.fy, c.cx, c.cy, c.skew, *c.distortion]) for c in (camera, other))
    return one.shape == two.shape and bool(np.allclose(one, two, rtol=0, atol=0.01))


def camera_afterwards(
    parent: Episode, view: StreamView, settings: PrepareSettings
) -> Intrinsics | None:
    """Return the intrinsics of a stream once it is prepared; None where they are not known.

    Raises
    ------
    MetadataError
        The item is none, or holds for images of another size.
    """
    camera = intrinsics_of(parent, view.name)
    if camera is None or RECTIFICATION + view.name in parent.metadata.calibration:
        return None
    if view.kind == "rgb" and settings.rgb == "rectify":
        return pinhole(settings.size, settings.fov_deg)
    return resized(camera, settings.size, settings.size)


def making_of(parent: Episode, view: StreamView, settings: PrepareSettings) -> Making:
    """Return how a stream of frames is made, with each its own.

    Tactile frames are rectified and cropped where the episode holds a map of their sensor. Camera
    frames lose their distortion if that is asked for.

    Raises
    ------
    UsageError
        A camera's frames are to be rectified, but its intrinsics are not known.
    MetadataError, DamagedDataError
        A calibration item is none, or its array does not fit.
    UnsupportedError
        The stream has an array of a newer version.
    """
    refuse_unknown_arrays(view)
    images, channels = images_of_view(view), channels_of(view, settings)
    drop_colour = channels < images.channels
    pixel_map = rectification_of(parent, view.name) if view.kind == "tactile" else None
    rectify = None if pixel_map is None else Rectifier(pixel_map)
    height, width = (images.height, images.width) if pixel_map is None else pixel_map.crop_px
    look = partial(_look, rectify=rectify, grey=drop_colour)
    steps = [grey_step(view.name)] if drop_colour else []
    fit = partial(resize, size=settings.size)
    fitted: LossyStep | None = resize_step(view.name, height, width, settings.size)
    if pixel_map is not None:
        steps.append(rectify_step(view.name, view.name, pixel_map))
    elif view.kind == "rgb" and settings.rgb == "rectify":
        undistorter, fitted = _undistorted(parent, view, settings)
        fit = undistorter  # type: ignore[assignment]  # both take a frame and give one
    coded = jpeg_step(view.name, images.encoding, channels, settings)
    fields, model = carried_fields(view), view.metadata
    if isinstance(model, TactileStream):
        scale = scale_of(model, pixel_map)
        if scale is not None:
            fields["mm_per_px"] = _scaled(scale, width, height, settings.size)
    found = find_reference(view)
    return Making(
        name=view.name,
        kind=view.kind,
        time=view.time,
        beside={n: view.array(n) for n in BESIDE_TIME if n in model.arrays},
        frames=lambda: _frames(view, rectify, grey=drop_colour),
        look=look,
        fit=fit,
        images=images,
        channels=channels,
        fields=fields,
        reference=None if found.image is None else look(found.image),
        about_reference=found.about,
        notes=[found.note] if found.note else [],
        steps=[*steps, *(step for step in (fitted, coded) if step is not None)],
        measure=measure_of(parent, view) if measured_anew(parent, view, settings) else None,
    )


def measure_of(parent: Episode, view: StreamView) -> Measure:
    """Return how the activity of one finger is measured."""
    base = f"{parent.id}/streams/{view.name}"
    inputs = [f"{base}/data", f"{base}/reference"]
    if RECTIFICATION + view.name in parent.metadata.calibration:
        inputs.append(f"{parent.id}/calibration/{RECTIFICATION}{view.name}")
    return Measure(active_above=ACTIVE_THRESHOLD, inputs=tuple(inputs))


def _frames(view: StreamView, rectify: Rectifier | None, *, grey: bool) -> Iterator[np.ndarray]:
    frames = view.frames.iterate(grey=grey)
    return frames if rectify is None else map(rectify, frames)


def _look(image: np.ndarray, rectify: Rectifier | None, *, grey: bool) -> np.ndarray:
    if grey:
        image = to_grey(image)[..., None]
    return image if rectify is None else rectify(image)


def scale_of(model: TactileStream, pixel_map: PixelMap | None) -> tuple[float, float] | None:
    """Return the scale of a stream's frames once they are rectified, across and down."""
    if pixel_map is not None:
        return pixel_map.mm_per_px
    return None if model.mm_per_px is None else (model.mm_per_px[0], model.mm_per_px[1])


def _scaled(scale: tuple[float, float], width: int, height: int, size: int) -> list[float]:
    return [scale[0] * width / size, scale[1] * height / size]


def rectify_step(stream: str, finger: str, pixel_map: PixelMap) -> LossyStep:
    """Return the step at which a finger's frames are rectified and cropped."""
    crop = pixel_map.crop
    digest = hashlib.sha256(pixel_map.index.astype("<u2").tobytes()).hexdigest()
    parameters: dict[str, Any] = {
        "map": f"{RECTIFICATION}{finger}",
        "map_sha256": digest,
        "crop": [crop.top, crop.left, crop.height, crop.width],
    }
    if pixel_map.mm_per_px is not None:
        parameters["mm_per_px"] = list(pixel_map.mm_per_px)
    return LossyStep(
        step="rectify",
        stream=stream,
        detail=f"frames and reference of {finger} were rectified by its map (nearest pixel) and "
        f"cropped to {crop.width}x{crop.height} pixels from column {crop.left}, row {crop.top}",
        parameters=parameters,
    )


def _undistorted(
    parent: Episode, view: StreamView, settings: PrepareSettings
) -> tuple[Undistorter, LossyStep]:
    camera = intrinsics_of(parent, view.name)
    if camera is None:
        raise UsageError(
            f"the intrinsics of {view.name!r} are not known: its frames cannot be rectified",
            where=parent.path,
            fix="Resize them only, or add the calibration item intrinsics/" + view.name + ".",
        )
    try:
        undistorter = Undistorter(camera, pinhole(settings.size, settings.fov_deg))
    except ValueError as error:
        raise UsageError(str(error), where=f"{parent.path}: intrinsics/{view.name}") from None
    size = settings.size
    return undistorter, LossyStep(
        step="undistort",
        stream=view.name,
        detail=f"frames of {camera.width}x{camera.height} pixels were made to look as if a camera "
        f"without distortion had taken them, {size}x{size} pixels, {settings.fov_deg:g} degrees "
        "across (area, then linear); what the lens did not see is black",
        parameters={
            "from": [camera.width, camera.height],
            "to": [size, size],
            "fov_deg": settings.fov_deg,
            "not_seen": round(undistorter.outside, 6),
            "intrinsics": parent.metadata.calibration[f"intrinsics/{view.name}"].value,
        },
    )
