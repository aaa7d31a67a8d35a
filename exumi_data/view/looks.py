"""How the frames of each encoding are logged: as they are stored, where Rerun knows that form."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import rerun as rr

from exumi_data.episode import StreamView
from exumi_data.model.images import ArrayImages, EncodedImages
from exumi_data.model.streams import images_of
from exumi_data.store import jpeg
from exumi_data.tactile.images import UInt8Array, to_grey
from exumi_data.view.log import Log

__all__ = ["DECODED_QUALITY", "JPEG", "Look", "Picture", "begin_jpeg", "jpeg_columns", "look_of"]

DECODED_QUALITY = 90
"""Quality of the JPEG that frames decoded from video are shown as."""

JPEG = "image/jpeg"


@dataclass(frozen=True, slots=True)
class Picture:
    """One frame.

    Attributes
    ----------
    data : callable
        Gives the bytes that are logged.
    grey : callable
        Gives its (H, W) uint8 luma.
    """

    data: Callable[[], bytes]
    grey: Callable[[], UInt8Array]


class Look(Protocol):
    """How the frames of a stream are logged."""

    def begin(self, log: Log, path: str) -> None:
        """Log what all frames share."""

    @property
    def read(self) -> Callable[[int], Picture]:
        """Reads a frame."""

    def columns(self, blobs: Sequence[bytes | None]) -> rr.ComponentColumnList:
        """Return the columns of frames; None stands for a missing one."""


def _optional(blobs: Sequence[bytes | None]) -> tuple[list[np.ndarray], list[int]]:
    """Return the blobs that are there, and for each row whether it is (1 or 0).

    Rerun shows nothing from a row without one on, until the next.
    """
    there = [np.frombuffer(blob, np.uint8) for blob in blobs if blob is not None]
    return there, [int(blob is not None) for blob in blobs]


def begin_jpeg(log: Log, path: str) -> None:
    """Log that the pictures of an entity are JPEG files."""
    log.fixed(path, rr.EncodedImage.from_fields(media_type=JPEG))


def jpeg_columns(blobs: Sequence[bytes | None]) -> rr.ComponentColumnList:
    """Return the columns of JPEG files; None stands for a missing one."""
    there, counts = _optional(blobs)
    return rr.EncodedImage.columns(blob=there).partition(counts)


@dataclass(frozen=True, slots=True)
class _JpegLook:
    """JPEG files, one a frame."""

    read: Callable[[int], Picture]
    begin = staticmethod(begin_jpeg)
    columns = staticmethod(jpeg_columns)


class _ArrayLook:
    """Pixels as they are."""

    def __init__(self, stream: StreamView, images: ArrayImages) -> None:
        self._stream = stream
        self._images = images

    def begin(self, log: Log, path: str) -> None:
        grey = self._images.channels == 1
        layout = rr.components.ImageFormat(
            width=self._images.width,
            height=self._images.height,
            color_model=rr.ColorModel.L if grey else rr.ColorModel.RGB,
            channel_datatype=rr.ChannelDatatype.U8,
        )
        log.fixed(path, rr.Image.from_fields(format=layout))

    def read(self, index: int) -> Picture:
        frame = self._stream.frames[index]
        return Picture(frame.tobytes, lambda: to_grey(frame))

    def columns(self, blobs: Sequence[bytes | None]) -> rr.ComponentColumnList:
        there, counts = _optional(blobs)
        return rr.Image.columns(buffer=there).partition(counts)


def _read_file(stream: StreamView, images: EncodedImages, index: int) -> Picture:
    data = stream.encoded(index)
    jpeg.check(data, (images.height, images.width))

    def grey() -> UInt8Array:
        out = np.empty((images.height, images.width, 1), np.uint8)
        jpeg.decode_into(data, out)
        return out[..., 0]

    return Picture(lambda: data, grey)


def _read_decoded(stream: StreamView, index: int) -> Picture:
    frame = stream.frames[index]
    return Picture(lambda: jpeg.encode(frame, DECODED_QUALITY), lambda: to_grey(frame))


def look_of(stream: StreamView) -> Look:
    """Return how the frames of a stream are logged, one by one.

    Parameters
    ----------
    stream : StreamView
        With frames.
    """
    images = images_of(stream.metadata)
    if isinstance(images, ArrayImages):
        return _ArrayLook(stream, images)
    if isinstance(images, EncodedImages):
        return _JpegLook(lambda index: _read_file(stream, images, index))
    return _JpegLook(lambda index: _read_decoded(stream, index))
