"""A small drawing surface on OpenCV: antialiased shapes at fractions of a pixel, and good type.

OpenCV 5 brings a scalable typeface of its own. Older versions have stroke letters only: the same
picture, less fair to look at.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from exumi_data.store.files import atomic_file

__all__ = ["Canvas", "Color", "Points", "mix"]

Color = tuple[int, int, int]
Points = Sequence[tuple[float, float]]
UInt8Array = npt.NDArray[np.uint8]

_SHIFT = 4  # coordinates are given to OpenCV in sixteenths of a pixel
_PLAIN = str.maketrans({"−": "-", "·": "-", "→": ">", "×": "x", "–": "-", "’": "'"})


def mix(color: Color, other: Color, share: float) -> Color:
    """Return a color that is `share` of the way from `color` to `other`."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(color, other, strict=True))
    return red, green, blue


class Canvas:
    """A picture that is being drawn.

    Parameters
    ----------
    width, height : int
        Pixels.
    color : (int, int, int)
        Of the ground, RGB.

    Attributes
    ----------
    pixels : (H, W, 3) uint8
        RGB.
    """

    def __init__(self, width: int, height: int, color: Color) -> None:
        self.pixels: UInt8Array = np.full((height, width, 3), color, np.uint8)
        face = getattr(cv2, "FontFace", None)
        self._face: Any = face("sans") if face else None

    def text(
        self,
        at: tuple[float, float],
        text: str,
        *,
        size: int,
        color: Color,
        weight: int = 400,
        align: Literal["left", "center", "right"] = "left",
    ) -> float:
        """Write a line of text.

        Parameters
        ----------
        at : (float, float)
            Where the baseline begins, ends or has its middle, as `align` says.
        text : str
        size : int
            Pixels, from the baseline of a line to that of the next.
        color : (int, int, int)
        weight : int
            400 is regular, 600 semibold.
        align : {"left", "center", "right"}

        Returns
        -------
        float
            Width of the text, pixels.
        """
        width = self._text_width(text, size, weight)
        x = at[0] - {"left": 0.0, "center": 0.5, "right": 1.0}[align] * width
        origin = (round(x), round(at[1]))
        if self._face is not None:
            cv2.putText(self.pixels, text, origin, color, self._face, size, weight)
        else:
            scale, thickness = _stroke(size, weight)
            plain = text.translate(_PLAIN)
            face = cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(self.pixels, plain, origin, face, scale, color, thickness, cv2.LINE_AA)
        return width

    def _text_width(self, text: str, size: int, weight: int) -> float:
        if self._face is not None:
            box = cv2.getTextSize((10_000, 1_000), text, (0, 0), self._face, size, weight)
            return float(box[2])
        scale, thickness = _stroke(size, weight)
        plain = text.translate(_PLAIN)
        return float(cv2.getTextSize(plain, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)[0][0])

    def image(
        self, box: tuple[float, float, float, float], image: UInt8Array, *, radius: int = 0
    ) -> None:
        """Place an image, scaled to a box.

        Parameters
        ----------
        box : (float, float, float, float)
            Left, top, width, height.
        image : (H, W, 3) or (H, W, 1) uint8
        radius : int
            Of the corners, pixels.
        """
        x, y, width, height = (round(value) for value in box)
        if image.shape[2] == 1:
            image = np.repeat(image, 3, axis=2)
        shrinks = width < image.shape[1]
        how = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
        scaled = cv2.resize(image, (width, height), interpolation=how)
        mask = _rounded((width, height), radius)[..., None]
        under = self.pixels[y : y + height, x : x + width]
        under[:] = np.round(scaled * mask + under * (1 - mask)).astype(np.uint8)

    def box(
        self,
        box: tuple[float, float, float, float],
        color: Color,
        *,
        alpha: float = 1.0,
        radius: int = 0,
    ) -> None:
        """Fill a box.

        Parameters
        ----------
        box : (float, float, float, float)
            Left, top, width, height.
        color : (int, int, int)
        alpha : float
            1 hides what is under it.
        radius : int
            Of the corners, pixels.
        """
        x, y, width, height = (round(value) for value in box)
        mask = alpha * _rounded((width, height), radius)[..., None]
        under = self.pixels[y : y + height, x : x + width]
        under[:] = np.round(np.array(color) * mask + under * (1 - mask)).astype(np.uint8)

    def frame(
        self, box: tuple[float, float, float, float], color: Color, *, width: float, radius: int
    ) -> None:
        """Draw the outline of a box, inside it."""
        x, y, across, down = box
        outer = _rounded((round(across), round(down)), radius)
        thick = round(width)
        inner = np.zeros_like(outer)
        inner[thick:-thick, thick:-thick] = _rounded(
            (round(across) - 2 * thick, round(down) - 2 * thick), max(radius - thick, 0)
        )
        mask = (outer - inner)[..., None]
        left, top = round(x), round(y)
        under = self.pixels[top : top + mask.shape[0], left : left + mask.shape[1]]
        under[:] = np.round(np.array(color) * mask + under * (1 - mask)).astype(np.uint8)

    def line(self, points: Points, color: Color, *, width: int = 2) -> None:
        """Draw a line through points."""
        cv2.polylines(self.pixels, [_fixed(points)], False, color, width, cv2.LINE_AA, _SHIFT)

    def area(self, points: Points, color: Color, *, alpha: float = 1.0) -> None:
        """Fill the area that points enclose."""
        over = self.pixels.copy()
        cv2.fillPoly(over, [_fixed(points)], color, cv2.LINE_AA, _SHIFT)
        cv2.addWeighted(over, alpha, self.pixels, 1 - alpha, 0, dst=self.pixels)

    def dot(self, at: tuple[float, float], color: Color, *, radius: float) -> None:
        """Draw a disc."""
        center = (round(at[0] * (1 << _SHIFT)), round(at[1] * (1 << _SHIFT)))
        size = round(radius * (1 << _SHIFT))
        cv2.circle(self.pixels, center, size, color, -1, cv2.LINE_AA, _SHIFT)

    def save(self, path: Path) -> None:
        """Write the picture as PNG, whole or not at all.

        Raises
        ------
        OSError
            The folder is missing or not writable.
        """
        done, data = cv2.imencode(".png", cv2.cvtColor(self.pixels, cv2.COLOR_RGB2BGR))
        assert done  # noqa: S101  # a PNG of 8-bit pixels can always be made
        with atomic_file(path) as temporary:
            temporary.write_bytes(data.tobytes())


def _stroke(size: int, weight: int) -> tuple[float, int]:
    """Return scale and thickness of stroke letters that are about as large."""
    scale = size / 42
    return scale, max(1, round(scale * (2.6 if weight > 500 else 1.7)))


def _fixed(points: Points) -> npt.NDArray[np.int32]:
    return np.round(np.asarray(points, np.float64) * (1 << _SHIFT)).astype(np.int32)


def _rounded(size: tuple[int, int], radius: int) -> npt.NDArray[np.float64]:
    """Return how much of each pixel lies inside a box with round corners, (H, W)."""
    width, height = size
    mask = np.ones((height, width))
    if radius <= 0:
        return mask
    # Distance from the corner's center, of the pixels in one corner; the others mirror it.
    offset = radius - 0.5 - np.arange(radius)
    inside = np.clip(radius - np.hypot(*np.meshgrid(offset, offset)) + 0.5, 0, 1)
    mask[:radius, :radius] = inside
    mask[:radius, -radius:] = inside[:, ::-1]
    mask[-radius:, :radius] = inside[::-1]
    mask[-radius:, -radius:] = inside[::-1, ::-1]
    return mask
