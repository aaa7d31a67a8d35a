"""Activity: the share of a tactile frame's pixels that differ from the reference image."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exumi_data.tactile.images import UInt8Array, check_pair, to_grey

__all__ = [
    "ACTIVE_THRESHOLD",
    "ACTIVE_THRESHOLD_COMBINED",
    "ACTIVITY_METHOD",
    "ACTIVITY_SIZE",
    "PIXEL_THRESHOLD",
    "ActivityMeter",
    "active_pixels",
]

ACTIVITY_METHOD = "exumi-activity/1"

PIXEL_THRESHOLD = 0.16 * 255 / 7
"""Grey levels above which a pixel counts as active: 0.16 of full scale after the gain of 7."""

ACTIVITY_SIZE = 224
"""Pixels an edge of the square image that activity is defined on."""

ACTIVE_THRESHOLD = 1e-3
"""A frame of one sensor is active above this activity."""

ACTIVE_THRESHOLD_COMBINED = 5e-4
"""The same for the combined left|right image, of which each finger fills half."""


class ActivityMeter:
    """Measure the activity of frames against one reference; method ``exumi-activity/1``.

    Activity is the share of pixels at which
    ``max(A(max(g - r, 0)), A(max(r - g, 0))) > threshold``, with g the frame, r the reference and
    A the area-resize to ``size x size`` pixels in float32 (OpenCV's INTER_AREA: the mean over
    each target pixel's area; where a frame is smaller than the target in either direction,
    OpenCV interpolates linearly instead, and that is A then).

    Most frames differ from the reference in few places, and a mean cannot exceed its largest
    input. So only blocks that hold a pixel above the threshold are resized: the sampling grid
    repeats every ``H / gcd(H, size)`` rows and ``W / gcd(W, size)`` columns, and whole blocks of
    that period resize to the same values alone as within the image.

    Parameters
    ----------
    reference
        (H, W), (H, W, 1) or (H, W, 3) uint8 image without contact.
    threshold
        Grey levels.
    size
        Edge of the image that pixels are counted on.

    Raises
    ------
    ValueError
        If the reference is no uint8 image, or threshold or size is not positive.
    """

    # Above this share of blocks, gathering them costs more than it saves.
    _DENSE_SHARE = 0.6

    def __init__(
        self,
        reference: UInt8Array,
        *,
        threshold: float = PIXEL_THRESHOLD,
        size: int = ACTIVITY_SIZE,
    ) -> None:
        if not threshold > 0 or size < 1:
            raise ValueError(f"threshold ({threshold}) and size ({size}) must be positive")
        self._reference = to_grey(reference).copy()  # the caller may reuse its array
        self._threshold = threshold
        self._size = size
        self._blocks = _Blocks.of(self._reference, size)

    @property
    def threshold(self) -> float:
        """Grey levels above which a pixel is active."""
        return self._threshold

    @property
    def size(self) -> int:
        """Edge of the image that pixels are counted on."""
        return self._size

    def measure(self, grey: UInt8Array) -> float:
        """Measure one frame.

        Parameters
        ----------
        grey
            (H, W) uint8, of the reference's size.

        Returns
        -------
        float
            Activity, 0 to 1.

        Raises
        ------
        ValueError
            If shape or dtype does not fit.
        """
        import cv2

        check_pair(grey, self._reference)
        grey = np.ascontiguousarray(grey)
        difference = cv2.absdiff(grey, self._reference)
        # both sides are integers there, so "above the threshold" is "above its floor"
        above = cv2.threshold(difference, math.floor(self._threshold), 1, cv2.THRESH_BINARY)[1]
        pixels = np.flatnonzero(above.view(np.bool_))  # of booleans: ten times as fast
        if pixels.size == 0:
            return 0.0
        active = self._count(grey, pixels)
        return active / (self._size * self._size)

    def _count(self, grey: UInt8Array, pixels: npt.NDArray[np.intp]) -> int:
        """Count active target pixels, given the indices of source pixels above the threshold."""
        whole = (self._size, self._size)
        if self._blocks is None:
            return _count_active(grey, self._reference, whole, self._threshold)
        chosen = self._blocks.holding(pixels)
        if chosen.size > self._DENSE_SHARE * self._blocks.count:
            return _count_active(grey, self._reference, whole, self._threshold)
        return _count_active(
            self._blocks.gather(grey, chosen),
            self._blocks.reference(chosen),
            self._blocks.target(chosen.size),
            self._threshold,
        )


class _Blocks:
    """The periodic blocks of an area-resize, and the reference cut into them."""

    def __init__(self, reference: UInt8Array, size: int) -> None:
        height, width = reference.shape
        self._rows, self._columns = math.gcd(height, size), math.gcd(width, size)
        self._source = height // self._rows, width // self._columns
        self._target = size // self._rows, size // self._columns
        self.count = self._rows * self._columns
        row = np.arange(height) // self._source[0]
        column = np.arange(width) // self._source[1]
        self._block_of_pixel = (row[:, None] * self._columns + column).ravel()
        self._reference = self._cut(reference, np.arange(self.count))

    @classmethod
    def of(cls, reference: UInt8Array, size: int) -> _Blocks | None:
        """Cut a reference; None where OpenCV would not average areas (see `ActivityMeter`)."""
        return None if min(reference.shape) < size else cls(reference, size)

    def holding(self, pixels: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Return the blocks that hold any of the pixels (flat indices), ascending."""
        marked = np.zeros(self.count, np.bool_)
        marked[self._block_of_pixel[pixels]] = True
        return np.flatnonzero(marked)

    def gather(self, grey: UInt8Array, chosen: npt.NDArray[np.intp]) -> UInt8Array:
        """Stack the chosen blocks of a frame one below the other."""
        return self._cut(grey, chosen).reshape(-1, self._source[1])

    def reference(self, chosen: npt.NDArray[np.intp]) -> UInt8Array:
        """Stack the chosen blocks of the reference one below the other."""
        return self._reference[chosen].reshape(-1, self._source[1])

    def target(self, n: int) -> tuple[int, int]:
        """Height and width of n stacked blocks after the resize."""
        return n * self._target[0], self._target[1]

    def _cut(self, image: UInt8Array, chosen: npt.NDArray[np.intp]) -> UInt8Array:
        rows, columns = self._source
        blocks = image.reshape(self._rows, rows, self._columns, columns)
        return blocks[chosen // self._columns, :, chosen % self._columns]


def active_pixels(
    grey: UInt8Array,
    reference: UInt8Array,
    *,
    threshold: float = PIXEL_THRESHOLD,
    size: int = ACTIVITY_SIZE,
) -> npt.NDArray[np.bool_]:
    """Return which pixels are active: their share is the frame's activity.

    Parameters
    ----------
    grey, reference
        (H, W) uint8, of one size.
    threshold
        Grey levels.
    size
        Edge of the image that pixels are judged on.

    Returns
    -------
    (size, size) bool

    Raises
    ------
    ValueError
        If shapes or dtypes do not fit.
    """
    check_pair(grey, reference)
    above = _above(grey, reference, (size, size), threshold)
    return np.asarray(above[..., 0] | above[..., 1])


def _above(
    grey: UInt8Array, reference: UInt8Array, target: tuple[int, int], threshold: float
) -> npt.NDArray[np.bool_]:
    """Return where each difference is above the threshold on the `target` image, (H, W, 2)."""
    import cv2

    differences = cv2.merge((cv2.subtract(grey, reference), cv2.subtract(reference, grey)))
    resized = cv2.resize(
        differences.astype(np.float32), (target[1], target[0]), interpolation=cv2.INTER_AREA
    )
    return np.asarray(resized > np.float32(threshold))


def _count_active(
    grey: UInt8Array, reference: UInt8Array, target: tuple[int, int], threshold: float
) -> int:
    """Count pixels of the `target` (height, width) image that either difference activates."""
    # two booleans a pixel, read as one 16-bit number: not zero if either is true
    either = _above(grey, reference, target, threshold).view(np.uint16)
    return int(np.count_nonzero(either))
