"""Measures on small grey images of touch: quiet images, differences, shifts, jumps."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

__all__ = [
    "Shift",
    "coarse",
    "difference",
    "median_image",
    "nearest_to",
    "shift_between",
    "texture",
]

UInt8Array = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]

_NEAREST = 1 / 3  # of the images, which come from all over the stream
_COARSE = 9  # pixels of a thumbnail: what is wider is light, not pattern


@dataclass(frozen=True, slots=True)
class Shift:
    """By how much one image is displaced against another.

    Attributes
    ----------
    right, down : float
        Pixels of the images that were compared.
    left_over : float
        Difference of the patterns that is left when the shift is undone, as a share of what it
        was.
    """

    right: float
    down: float
    left_over: float

    @property
    def length(self) -> float:
        """Its length, pixels."""
        return float(np.hypot(self.right, self.down))


def difference(image: UInt8Array, reference: UInt8Array) -> UInt8Array:
    """Return the absolute difference of two images of one shape, grey levels."""
    return np.maximum(image, reference) - np.minimum(image, reference)


def nearest_to(reference: UInt8Array, images: Collection[UInt8Array]) -> list[UInt8Array]:
    """Return the third of some images that differs least from a reference, the nearest first.

    Parameters
    ----------
    reference : (h, w) uint8
    images : collection of (h, w) uint8

    Returns
    -------
    list of (h, w) uint8
        At least one.
    """
    import cv2

    count = max(1, round(_NEAREST * len(images)))
    return sorted(images, key=lambda image: cv2.norm(image, reference, cv2.NORM_L1))[:count]


def median_image(images: Collection[UInt8Array]) -> UInt8Array:
    """Return the median of images, pixel by pixel."""
    from exumi_data.tactile import reference_image

    return reference_image(list(images))


def coarse(image: UInt8Array, columns: int, rows: int) -> bytes:
    """Return an image's light, averaged to so many pixels, row by row: small enough to keep."""
    import cv2

    return cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA).tobytes()


def texture(image: UInt8Array) -> float:
    """Return the standard deviation of an image's pattern, grey levels."""
    return float(_pattern(image).std())


def shift_between(reference: UInt8Array, image: UInt8Array) -> Shift:
    """Find the shift that leads from a reference to an image, by phase correlation.

    Parameters
    ----------
    reference, image : (h, w) uint8
        Of one shape, at least 16 pixels high and wide.

    Returns
    -------
    Shift
    """
    import cv2

    before, after = _pattern(reference), _pattern(image)
    window = _window(before.shape[1], before.shape[0])
    (right, down), _ = cv2.phaseCorrelate(before, after, window)
    back = np.array([[1, 0, right], [0, 1, down]], np.float32)
    size = (before.shape[1], before.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    undone = np.asarray(cv2.warpAffine(after, back, size, flags=flags))
    rows, columns = _inside(before.shape[0], down), _inside(before.shape[1], right)
    was = np.abs(after - before)[rows, columns].mean()
    is_now = np.abs(undone - before)[rows, columns].mean()
    return Shift(float(right), float(down), float(is_now / max(float(was), 1e-6)))


@lru_cache(maxsize=8)
def _window(width: int, height: int) -> Float32Array:
    import cv2

    return np.asarray(cv2.createHanningWindow((width, height), cv2.CV_32F), np.float32)


def _inside(length: int, shift: float) -> slice:
    """Leave out the margin that nothing is known of once a shift is undone."""
    margin = min(int(np.ceil(abs(shift))) + 1, length // 4)
    return slice(margin, length - margin)


def _pattern(image: UInt8Array) -> Float32Array:
    import cv2

    levels = image.astype(np.float32)
    fine = cv2.GaussianBlur(levels, (3, 3), 0)
    return np.asarray(fine - cv2.blur(levels, (_COARSE, _COARSE)), np.float32)
