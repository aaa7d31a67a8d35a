"""The combined image of a gripper's two fingers, as exUMI trains on it."""

from __future__ import annotations

import numpy as np

from exumi_data.tactile.images import UInt8Array
from exumi_data.tactile.rectification import PixelMap, Rectifier

__all__ = ["Combiner", "combined_scale"]


class Combiner:
    """Puts the frames of two fingers side by side.

    Each is rectified and cropped; the left one is then turned left by 90 degrees, which is
    counter-clockwise, and the right one right, so that both fingers point the same way; left
    stands left of right.

    Parameters
    ----------
    left, right : PixelMap or None
        Of the fingers; without, their frames are taken whole.
    """

    def __init__(self, left: PixelMap | None, right: PixelMap | None) -> None:
        self._left, self._right = Rectifier(left, "left"), Rectifier(right, "right")

    def __call__(self, left: UInt8Array, right: UInt8Array) -> UInt8Array:
        """Return the image of both fingers in the resolution of their own.

        Parameters
        ----------
        left, right : (H, W, C) uint8
            Their frames.

        Returns
        -------
        (h, w, C) uint8
            Of two crops of 340 by 460 pixels 460 by 680.

        Raises
        ------
        ValueError
            The two do not fit together.
        """
        halves = self._left(left), self._right(right)
        heights, channels = {h.shape[0] for h in halves}, {h.shape[2] for h in halves}
        if len(heights) > 1 or len(channels) > 1:
            raise ValueError(
                f"the fingers' images differ: {halves[0].shape} and {halves[1].shape} once turned"
            )
        return np.concatenate(halves, axis=1)


def combined_scale(
    left: tuple[float, float] | None, right: tuple[float, float] | None
) -> tuple[float, float] | None:
    """Return the scale of a combined image in its fingers' resolution, mm per pixel.

    Parameters
    ----------
    left, right : (float, float) or None
        Of the fingers' images before they are turned, across and down.

    Returns
    -------
    (float, float) or None
        Across and down, the mean of both fingers; None where one of them is not known.
    """
    if left is None or right is None:
        return None
    # What was across lies down once it is turned.
    return (left[1] + right[1]) / 2, (left[0] + right[0]) / 2
