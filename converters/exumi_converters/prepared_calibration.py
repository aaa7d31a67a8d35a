"""Calibration of a prepared episode: what holds of its images, and all that is not of images."""

from collections.abc import Collection, Mapping

import numpy as np

from exumi_converters.prepare_settings import PrepareSettings
from exumi_converters.prepared_one import camera_afterwards
from exumi_converters.prepared_stream import Making, images_of_view
from exumi_data.calibration import add_intrinsics
from exumi_data.episode import Episode
from exumi_data.errors import DamagedDataError
from exumi_data.model.calibration import INTRINSICS, RECTIFICATION, RIG_REFERENCE
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["carry_calibration"]


def carry_calibration(
    parent: Episode,
    writer: EpisodeWriter,
    made: Mapping[str, Making],
    gone: Collection[str],
    settings: PrepareSettings,
) -> None:
    """Carry calibration along: items of images are changed as their images were, or left out.

    Parameters
    ----------
    parent : Episode
    writer : EpisodeWriter
        Its metadata hold the parent's items.
    made : mapping of str to Making
        Streams whose frames were made anew.
    gone : collection of str
        Streams that are no longer there: nothing that is known of their images holds.
    settings : PrepareSettings
    """
    items = writer.metadata.calibration
    left_out = [
        name
        for name in items
        if _stream_of(name, INTRINSICS, RECTIFICATION, RIG_REFERENCE) in {*made, *gone}
    ]
    before = {name: items.pop(name) for name in left_out}
    kept = {item.array for item in items.values()}
    arrays = {item.array for item in before.values() if item.array is not None} - kept
    writer.copy_group(parent, "calibration", without=sorted(arrays - {None}))
    for name, item in before.items():
        stream = _stream_of(name, INTRINSICS, RIG_REFERENCE)
        making = made.get(stream or "")
        if making is None or stream is None:
            continue
        if name.startswith(INTRINSICS):
            camera = camera_afterwards(parent, parent[stream], settings)
            if camera is not None:
                add_intrinsics(writer, stream, camera)
                value = items[name].value
                items[name] = item.model_copy(update={"value": value, "residual": None})
        elif item.array is not None and making.look is not None:
            image = making.fit(making.look(_image(parent, name, stream)))
            writer.add_calibration_array(name, image, dimension_names=("y", "x", "c"))
            items[name] = item.model_copy(update={"array": f"calibration/{name}"})


def _stream_of(item: str, *prefixes: str) -> str | None:
    """Return the stream that an item of one of these names is about."""
    prefix = next((prefix for prefix in prefixes if item.startswith(prefix)), None)
    return None if prefix is None else item.removeprefix(prefix)


def _image(parent: Episode, name: str, stream: str) -> np.ndarray:
    """Return an image of a stream's size: nothing larger is read."""
    images = images_of_view(parent[stream])
    colour, grey = ((images.height, images.width, channels) for channels in (3, 1))
    try:
        image = parent.calibration_array(name, shape=colour)
    except DamagedDataError:
        image = parent.calibration_array(name, shape=grey)
    if image.dtype != np.uint8:
        raise DamagedDataError(
            f"an image of {image.dtype}, expected uint8",
            where=f"{parent.path}: calibration {name}",
        )
    return image
