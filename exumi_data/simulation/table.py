"""The table that the wrist camera looks at: a cutting mat on wood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exumi_data.simulation.pixels import as_float32, as_uint8

__all__ = ["TABLE_PX_PER_M", "table_texture"]

TABLE_PX_PER_M = 1300.0
"""Resolution of the table's picture."""

_SIDE_M = 0.9
_MAT_M = (0.56, 0.40)
_WOOD_RGB = (186, 150, 112)
_MAT_RGB = (62, 104, 104)
_LINE_RGB = (112, 152, 148)
_BOLD_RGB = (146, 182, 176)


def table_texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture of the table seen from above.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the wood's grain.

    Returns
    -------
    ndarray of uint8, shape (S, S, 3)
        RGB; the world's origin at its centre, x to the right, y up, at ``TABLE_PX_PER_M``.
    """
    import cv2

    side = round(_SIDE_M * TABLE_PX_PER_M)
    picture = _wood(rng, side)
    half_x, half_y = (round(length / 2 * TABLE_PX_PER_M) for length in _MAT_M)
    middle = side // 2
    low, high = (middle - half_x, middle - half_y), (middle + half_x, middle + half_y)
    cv2.rectangle(picture, low, high, _MAT_RGB, -1)
    step = round(0.01 * TABLE_PX_PER_M)
    for colour, every in ((_LINE_RGB, 1), (_BOLD_RGB, 5)):
        for x in range(-(half_x // step), half_x // step + 1):
            if x % every == 0:
                column = middle + x * step
                cv2.line(picture, (column, low[1]), (column, high[1]), colour, 1 + every // 5)
        for y in range(-(half_y // step), half_y // step + 1):
            if y % every == 0:
                row = middle + y * step
                cv2.line(picture, (low[0], row), (high[0], row), colour, 1 + every // 5)
    return as_uint8(cv2.GaussianBlur(picture, (0, 0), 0.8))


def _wood(rng: np.random.Generator, side: int) -> NDArray[np.uint8]:
    import cv2

    grain = np.zeros((side, side), np.float32)
    for along, across, strength in ((6, 90, 7.0), (14, 300, 5.0), (220, 3, 4.0)):
        coarse = strength * rng.standard_normal((across, along), dtype=np.float32)
        grain += as_float32(cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC))
    channels = [
        cv2.convertScaleAbs(grain, alpha=tint, beta=base)
        for tint, base in zip((1.0, 0.9, 0.8), _WOOD_RGB, strict=True)
    ]
    return as_uint8(cv2.merge(channels))
