"""Pictures of what changed on a gel, for people."""

from __future__ import annotations

import numpy as np

from exumi_data.tactile.images import UInt8Array, representation, to_grey

__all__ = ["paint_change"]

_LIFT = 0.85  # a dark ground swallows the middle of a channel; 0 and 1 stay

Color = tuple[int, int, int]


def paint_change(
    frame: UInt8Array, reference: UInt8Array, *, ground: Color, brighter: Color, darker: Color
) -> UInt8Array:
    """Paint the two channels that exUMI trains on: brighter and darker than without contact.

    Parameters
    ----------
    frame, reference
        (H, W), (H, W, 1) or (H, W, 3) uint8.
    ground, brighter, darker
        RGB colours of no change, and of the largest change in either direction.

    Returns
    -------
    (H, W, 3) uint8

    Raises
    ------
    ValueError
        If shapes or dtypes do not fit.
    """
    _, convex, concave = representation(to_grey(frame), to_grey(reference))
    base = np.array(ground, np.float32)
    picture = base + np.zeros((*convex.shape, 3), np.float32)
    for channel, color in ((convex, brighter), (concave, darker)):
        picture += channel[..., None] ** _LIFT * (np.array(color, np.float32) - base)
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)
