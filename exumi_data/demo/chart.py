"""Curves over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.demo.canvas import Canvas, Color

__all__ = ["Chart", "Curve"]

_PAD = 14
_WIDE = 5
"""Of a curve that the truth lies on."""


@dataclass(frozen=True, slots=True)
class Curve:
    """Values over time.

    Attributes
    ----------
    time_s : (N,) float64
        Seconds.
    value : (N,) float64
        In the chart's unit.
    color : (int, int, int)
    is_truth : bool
        Drawn as a thin line over the others.
    """

    time_s: npt.NDArray[np.float64]
    value: npt.NDArray[np.float64]
    color: Color
    is_truth: bool = False


class Chart:
    """A chart of curves that share one time axis; its values begin at zero.

    Parameters
    ----------
    box : (float, float, float, float)
        Left, top, width, height, pixels.
    span_s : (float, float)
        Time at the left and at the right edge.
    curves : sequence of Curve
        Drawn in this order.
    """

    def __init__(
        self,
        box: tuple[float, float, float, float],
        span_s: tuple[float, float],
        curves: Sequence[Curve],
    ) -> None:
        self._box = box
        self._span_s = span_s
        self._curves = curves
        self._has_truth = any(curve.is_truth for curve in curves)
        top = max(float(curve.value.max()) for curve in curves)
        self._step = nice_step(top)
        self._top = max(top, self._step)

    def place(self, time_s: float, value: float) -> tuple[float, float]:
        """Return where a value lies, pixels."""
        left, top, width, height = self._box
        start, end = self._span_s
        x = left + (time_s - start) / (end - start) * width
        return x, top + height - _PAD - value / self._top * (height - 2 * _PAD)

    def draw(self, canvas: Canvas, *, grid: Color, text: Color) -> None:
        """Draw grid, values of the grid lines, and curves.

        Parameters
        ----------
        canvas : Canvas
        grid, text : (int, int, int)
            Colors.
        """
        left, _, width, _ = self._box
        for number in range(int(self._top / self._step) + 1):
            value = number * self._step
            _, y = self.place(self._span_s[0], value)
            canvas.line([(left, y), (left + width, y)], grid, width=1)
            canvas.text((left + width + 10, y + 6), f"{value:g}", size=18, color=text)
        for curve in self._curves:
            points = [self.place(t, v) for t, v in zip(curve.time_s, curve.value, strict=True)]
            if curve.is_truth:
                canvas.line(points, curve.color, width=1)
                continue
            floor = self.place(0.0, 0.0)[1]
            canvas.area(
                [(points[0][0], floor), *points, (points[-1][0], floor)], curve.color, alpha=0.10
            )
            canvas.line(points, curve.color, width=_WIDE if self._has_truth else 3)


def nice_step(top: float) -> float:
    """Return a step of 1, 2 or 5 times a power of ten that divides `top` into about two."""
    if top <= 0:
        return 1.0
    rough = top / 2
    power = float(10 ** np.floor(np.log10(rough)))
    return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= rough)
