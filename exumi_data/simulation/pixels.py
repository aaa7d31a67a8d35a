"""Types for images that come back from OpenCV, whose stubs say only "some number"."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Float32Array", "UInt8Array", "as_float32", "as_uint8"]

Float32Array = NDArray[np.float32]
UInt8Array = NDArray[np.uint8]


def as_float32(image: NDArray[Any]) -> Float32Array:
    """Return `image` as float32, without a copy where it is that already."""
    return np.asarray(image, dtype=np.float32)


def as_uint8(image: NDArray[Any]) -> UInt8Array:
    """Return `image` as uint8, without a copy where it is that already."""
    return np.asarray(image, dtype=np.uint8)
