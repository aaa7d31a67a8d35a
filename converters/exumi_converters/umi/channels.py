"""exUMI's tactile image: how far each pixel is darker and brighter than a reference, and its grey.

The released code computes grey, convex (brighter) and concave (darker) in this order, writes them
as if they were blue, green and red, and reads them as red, green and blue: what is stored is
concave, convex, grey. Its training code reads the first two.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from exumi_data.tactile import REPRESENTATION_GAIN

__all__ = [
    "DIFFERENCES_KIND",
    "Content",
    "Order",
    "difference_channels",
    "differences_of",
    "judge_content",
]

DIFFERENCES_KIND = "exumi:differences"
"""Kind of the stream that keeps concave and convex as they were stored."""

_FEW_LEVELS = 16.0


def differences_of(stream: str) -> str:
    """Return the name of the stream of concave and convex beside that of the grey image."""
    return f"{stream}_differences"


@dataclass(frozen=True, slots=True)
class Order:
    """Which channel is which.

    Attributes
    ----------
    concave, convex, grey : int
    """

    concave: int
    convex: int
    grey: int


RELEASED = Order(concave=0, convex=1, grey=2)
"""As exUMI's released code stores them."""
STRAIGHT = Order(concave=2, convex=1, grey=0)
"""As it computes them."""

Content = Order | Literal["pictures"]


def judge_content(frames: Sequence[np.ndarray]) -> Content:
    """Tell exUMI's channels from pictures, and which of them is which.

    Where nothing touches, concave and convex are near 0, and no pixel is darker and brighter at
    once; red, green and blue of a gel are all well above.

    Parameters
    ----------
    frames : sequence of (H, W, 3) uint8
        Some of an episode.

    Returns
    -------
    Order or ``"pictures"``
    """
    if not frames or frames[0].shape[2] != 3:
        return "pictures"
    levels = np.median([np.median(frame, axis=(0, 1)) for frame in frames], axis=0)
    order = STRAIGHT if levels[0] > levels[2] else RELEASED
    lesser = [np.minimum(f[..., order.concave], f[..., order.convex]).mean() for f in frames]
    return order if float(np.median(lesser)) < _FEW_LEVELS else "pictures"


def difference_channels(grey: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Make the tactile image as exUMI's training code reads it, clamped where exUMI's wrapped.

    Parameters
    ----------
    grey, reference : (H, W) uint8

    Returns
    -------
    (H, W, 3) uint8
        Concave, convex, grey.
    """
    import cv2

    gain = REPRESENTATION_GAIN
    concave = cv2.convertScaleAbs(cv2.subtract(reference, grey), alpha=gain)
    convex = cv2.convertScaleAbs(cv2.subtract(grey, reference), alpha=gain)
    return np.asarray(cv2.merge((concave, convex, np.ascontiguousarray(grey))), np.uint8)
