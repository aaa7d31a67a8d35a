"""Calibration items that the standard defines: read from episodes, added to those being written."""

from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from exumi_data.episode import Episode
from exumi_data.errors import DamagedDataError, MetadataError
from exumi_data.model.base import Model
from exumi_data.model.calibration import INTRINSICS, RECTIFICATION, Intrinsics, Rectification
from exumi_data.model.description import CalibrationItem
from exumi_data.model.documents import dump, problems_of
from exumi_data.model.streams import images_of
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile.rectification import PixelMap

__all__ = ["add_intrinsics", "add_rectification", "intrinsics_of", "rectification_of"]

_FIX = "Check the episode with: exumi validate EPISODE"

M = TypeVar("M", bound=Model)


def intrinsics_of(episode: Episode, stream: str) -> Intrinsics | None:
    """Return how the camera of a stream sees; None where that is not known.

    Parameters
    ----------
    episode : Episode
    stream : str
        With frames.

    Raises
    ------
    MetadataError
        The item is none, or holds for images of another size.
    """
    item = episode.metadata.calibration.get(INTRINSICS + stream)
    if item is None:
        return None
    camera = _value(episode, INTRINSICS + stream, item, Intrinsics)
    images = images_of(episode[stream].metadata)
    if images is None or (camera.width, camera.height) != (images.width, images.height):
        raise MetadataError(
            f"{INTRINSICS}{stream} holds for images of {camera.width}x{camera.height}, not for "
            "those of the stream",
            where=episode.path,
            fix=_FIX,
        )
    return camera


def rectification_of(episode: Episode, stream: str) -> PixelMap | None:
    """Return how the frames of a tactile stream are rectified; None where that is not known.

    Parameters
    ----------
    episode : Episode
    stream : str
        With frames.

    Raises
    ------
    MetadataError
        The item is none.
    DamagedDataError
        Its array is missing, or does not fit the frames.
    """
    name = RECTIFICATION + stream
    item = episode.metadata.calibration.get(name)
    if item is None:
        return None
    value = _value(episode, name, item, Rectification)
    images = images_of(episode[stream].metadata)
    shape = (images.height, images.width, 2) if images else None
    scale = value.mm_per_px
    try:
        return PixelMap(
            episode.calibration_array(name, shape=shape),
            (value.centre_px[0], value.centre_px[1]),
            (value.crop_px[0], value.crop_px[1]),
            None if scale is None else (scale[0], scale[1]),
        )
    except ValueError as error:
        where = f"{episode.path}: calibration {name}"
        raise DamagedDataError(str(error), where=where, fix=_FIX) from None


def _value(episode: Episode, name: str, item: CalibrationItem, model: type[M]) -> M:
    try:
        return model.model_validate(
            item.value, context={"newer_minor": episode.metadata.is_newer_minor}
        )
    except ValidationError as error:
        found = problems_of(error, below=("calibration", name, "value"))
        problems = tuple(f"{message} @ {path}" for message, path in found)
        raise MetadataError(
            "; ".join(problems), where=episode.path, fix=_FIX, problems=problems
        ) from None


def add_intrinsics(writer: EpisodeWriter, stream: str, camera: Intrinsics, **said: Any) -> None:
    """Put the intrinsics of a stream's camera on record.

    Parameters
    ----------
    writer : EpisodeWriter
    stream : str
    camera : Intrinsics
        For images of the stream's size.
    **said
        Other fields of `CalibrationItem`: how it is known (`method`), `residual` in pixels ...
    """
    name = INTRINSICS + stream
    writer.metadata.calibration[name] = CalibrationItem(value=dump(camera), unit="px", **said)


def add_rectification(writer: EpisodeWriter, stream: str, pixel_map: PixelMap, **said: Any) -> None:
    """Put on record how the frames of a tactile stream are rectified.

    Parameters
    ----------
    writer : EpisodeWriter
    stream : str
    pixel_map : PixelMap
        For images of the stream's size.
    **said
        Other fields of `CalibrationItem`: how it is known (`method`), `residual` in pixels ...
    """
    name = RECTIFICATION + stream
    scale = {} if pixel_map.mm_per_px is None else {"mm_per_px": list(pixel_map.mm_per_px)}
    value = {"centre_px": list(pixel_map.centre_px), "crop_px": list(pixel_map.crop_px), **scale}
    index = np.ascontiguousarray(pixel_map.index)
    writer.add_calibration_array(name, index, dimension_names=("y", "x", "index"))
    writer.metadata.calibration[name] = CalibrationItem(
        value=value, unit="px", array=f"calibration/{name}", **said
    )
