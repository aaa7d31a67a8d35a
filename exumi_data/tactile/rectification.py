"""Rectified tactile images: straight, cropped to the gel, of one scale.

A sensor's lens bends its image. A *map* gives for each pixel of the rectified image the pixel of
the sensor's own image that it shows: pixels are moved, never blended. 9DTact makes such maps when
it is calibrated, and exUMI trains on images that have been through them.

OpenCV is imported where it is used.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from exumi_data.tactile.images import UInt8Array

__all__ = ["Crop", "PixelMap", "Rectifier", "read_ninedtact"]

_NINEDTACT_CROP_PX = (340, 460)
_MOST_BYTES = 64 << 20
_MOST_SIDE = 32767  # OpenCV moves pixels by 16-bit places

Turn = Literal["none", "left", "right"]
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Crop:
    """The part of a rectified image that shows the gel.

    Attributes
    ----------
    top, left : int
        First row and column.
    height, width : int
    """

    top: int
    left: int
    height: int
    width: int


@dataclass(frozen=True, slots=True)
class PixelMap:
    """How one sensor's frames are rectified and cropped.

    Attributes
    ----------
    index : (H, W, 2) uint16
        Row and column in the sensor's image that each pixel of the rectified image shows.
    centre_px : (float, float)
        Row and column of the rectified image that the crop is centred on.
    crop_px : (int, int)
        Rows and columns of the crop.
    mm_per_px : (float, float) or None
        Scale of the rectified image across and down, mm per pixel.

    Raises
    ------
    ValueError
        An index lies outside of the image, or the crop outside of the map.
    """

    index: npt.NDArray[np.uint16]
    centre_px: tuple[float, float]
    crop_px: tuple[int, int]
    mm_per_px: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        index = self.index
        if index.dtype != np.uint16 or index.ndim != 3 or index.shape[2] != 2 or not index.size:
            raise ValueError(f"a map is (H, W, 2) uint16, not {index.shape} {index.dtype}")
        height, width = index.shape[:2]
        if max(height, width) > _MOST_SIDE:
            raise ValueError(f"a map of {height}x{width} is larger than {_MOST_SIDE} pixels")
        if int(index[..., 0].max()) >= height or int(index[..., 1].max()) >= width:
            raise ValueError(f"an index of the map lies outside of its image of {height}x{width}")
        crop = self.crop
        inside = crop.top >= 0 and crop.left >= 0
        if not inside or crop.top + crop.height > height or crop.left + crop.width > width:
            raise ValueError(f"the crop {crop} lies outside of the map of {height}x{width}")

    @property
    def crop(self) -> Crop:
        """The crop's place: the centre less half its size, rounded down."""
        (row, column), (height, width) = self.centre_px, self.crop_px
        return Crop(math.floor(row - height / 2), math.floor(column - width / 2), height, width)


class Rectifier:
    """Rectifies, crops and turns the frames of one sensor, in one step.

    Parameters
    ----------
    pixel_map : PixelMap or None
        None: frames are only turned.
    turn : {"none", "left", "right"}
        By 90 degrees, left is counter-clockwise.
    """

    def __init__(self, pixel_map: PixelMap | None, turn: Turn = "none") -> None:
        self._turn = turn
        self._shape: tuple[int, ...] | None = None
        if pixel_map is None:
            return
        crop = pixel_map.crop
        part = pixel_map.index[
            crop.top : crop.top + crop.height, crop.left : crop.left + crop.width
        ]
        self._shape = pixel_map.index.shape[:2]
        # Turning the map once saves turning each frame. OpenCV asks for column and row.
        turned = _turned(part, turn)[..., ::-1]
        self._places = np.ascontiguousarray(turned, dtype=np.int16)

    def __call__(self, frame: UInt8Array) -> UInt8Array:
        """Return a frame, rectified, cropped and turned.

        Parameters
        ----------
        frame : (H, W, C) uint8
            Of the map's size.

        Returns
        -------
        (h, w, C) uint8

        Raises
        ------
        ValueError
            The frame is not of the map's size.
        """
        import cv2

        if self._shape is None:
            return _turned(frame, self._turn)
        if frame.shape[:2] != self._shape:
            raise ValueError(f"the frame is {frame.shape[:2]}, the map {self._shape}")
        moved = cv2.remap(frame, self._places, None, interpolation=cv2.INTER_NEAREST)  # type: ignore[call-overload]  # OpenCV's stubs miss that one map is enough
        return np.asarray(moved, np.uint8).reshape(*self._places.shape[:2], -1)


def _turned(image: npt.NDArray[T], turn: Turn) -> npt.NDArray[T]:
    if turn == "none":
        return image
    return np.ascontiguousarray(np.rot90(image, 1 if turn == "left" else -1))


def read_ninedtact(
    folder: str | os.PathLike[str], *, crop_px: tuple[int, int] = _NINEDTACT_CROP_PX
) -> PixelMap:
    """Read the maps that 9DTact's camera calibration leaves in a folder.

    These are ``row_index.npy`` and ``col_index.npy`` (H, W), and ``position_scale.npy``: the row
    and column of the centre, and mm per pixel, although its authors call it ``pixel_per_mm``.
    The size of the crop is in another file of theirs.

    Parameters
    ----------
    folder : path-like
        Such as ``sensor_1/camera_calibration``.
    crop_px : (int, int), optional
        Rows and columns of the crop; exUMI's images were cropped to 340 by 460.

    Raises
    ------
    ValueError
        A file holds something else, or the map does not fit together.
    OSError
        A file is missing.
    """
    rows, columns, position = (
        _numbers(Path(folder) / f"{name}.npy")
        for name in ("row_index", "col_index", "position_scale")
    )
    if rows.ndim != 2 or rows.shape != columns.shape or position.shape != (3,):
        raise ValueError(
            f"{folder}: row and column index are {rows.shape} and {columns.shape}, "
            f"position and scale {position.shape}"
        )
    index = np.stack([rows, columns], axis=-1)
    if index.dtype.kind not in "iu" or index.min() < 0 or index.max() > np.iinfo(np.uint16).max:
        raise ValueError(f"{folder}: row and column index are no whole numbers from 0 to 65535")
    row, column, scale = (float(number) for number in position)
    return PixelMap(index.astype(np.uint16), (row, column), crop_px, (scale, scale))


def _numbers(path: Path) -> npt.NDArray[np.generic]:
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"{path} is larger than {_MOST_BYTES:,} bytes")
    found = np.load(path, allow_pickle=False)
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "iuf" or not found.size:
        raise ValueError(f"{path} holds no array of numbers")
    return found
