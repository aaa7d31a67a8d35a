"""Heat maps as SVG: of a finger, of a plane in space, of groups over time."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from exumi_data.stats.html.markup import Html, element, join
from exumi_data.stats.html.svg import (
    LEVELS,
    WIDTH,
    label,
    level_cells,
    number_text,
    picture,
    round_ticks,
    tick_text,
    x_axis,
)

__all__ = ["finger_map", "plane_map", "row_map", "taxel_map"]

Numbers = npt.NDArray[np.float64]

_NAMES = 118
_ROW = 21
_LEGEND = 30


def finger_map(
    title: str, description: str, shares: Numbers, *, aspect: float, legend: str
) -> Html:
    """Draw how often each place of a finger is touched, as the sensor's image shows it.

    Parameters
    ----------
    title, description : str
    shares : (R, C) float64
        0 to 1.
    aspect : float
        Width of the image by its height.
    legend : str
        What the scale shows.
    """
    most = float(shares.max()) if shares.size else 0.0
    wide = min(300.0, 240 * aspect)
    tall = wide / aspect
    left = (WIDTH - wide) / 2
    cell = (wide / shares.shape[1], tall / shares.shape[0])
    levels = _levels(shares, most)
    ground = element("rect", x=left, y=1.0, width=wide, height=tall, class_="ground")
    cells = level_cells(levels, left=left, top=1, cell=cell)
    scale = _legend(tall + 14, "0 %", f"{most * 100:.0f} %", legend)
    return picture(title, description, tall + 14 + _LEGEND, ground, cells, scale)


def taxel_map(
    title: str,
    description: str,
    means: Numbers,
    alive: npt.NDArray[np.bool_],
    *,
    unit: str,
) -> Html:
    """Draw what each taxel of a grid felt; cells are square, as the standard knows no pitch.

    Parameters
    ----------
    title, description : str
    means : (R, C) float64
        Below 0 is drawn as 0.
    alive : (R, C) bool
        Cells that are not are crossed out.
    unit : str
    """
    rows, columns = means.shape
    size = min(300 / columns, 240 / rows)
    wide, tall = size * columns, size * rows
    left = (WIDTH - wide) / 2
    shown = np.where(alive, np.maximum(means, 0.0), 0.0)
    most = float(shown.max(initial=0.0))
    ground = element("rect", x=left, y=1.0, width=wide, height=tall, class_="ground")
    cells = level_cells(_levels(shown, most), left=left, top=1, cell=(size, size))
    scale = _legend(tall + 14, "0", number_text(most), f"mean, {unit}")
    dead = _crosses(alive, left, size)
    return picture(title, description, tall + 14 + _LEGEND, ground, cells, dead, scale)


def _crosses(alive: npt.NDArray[np.bool_], left: float, size: float) -> Html:
    strokes = []
    for row, column in np.argwhere(~alive).tolist():
        x0, y0 = left + (column + 0.2) * size, 1 + (row + 0.2) * size
        x1, y1 = x0 + 0.6 * size, y0 + 0.6 * size
        strokes.append(f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}M{x1:.1f} {y0:.1f}L{x0:.1f} {y1:.1f}")
    return element("path", d="".join(strokes), class_="axis") if strokes else Html("")


def _levels(values: Numbers, most: float) -> list[list[int]]:
    if most <= 0:
        return [[0] * values.shape[1] for _ in values]
    levels = np.ceil(values / most * LEVELS).clip(0, LEVELS).astype(int)
    return [[int(level) for level in row] for row in levels]


def _legend(y: float, low: str, high: str, words: str) -> Html:
    """Draw the scale: eight boxes between its ends, with what it shows below."""
    size, left = 18, (WIDTH - LEVELS * 18) / 2
    boxes = [
        element("rect", x=left + size * n, y=y, width=size, height=8, class_=f"q{n + 1}")
        for n in range(LEVELS)
    ]
    ends = (
        label(left - 6, y + 8, low, anchor="end", quiet=True),
        label(left + size * LEVELS + 6, y + 8, high, quiet=True),
    )
    return join(*boxes, *ends, label(WIDTH / 2, y + 24, words, anchor="middle", quiet=True))


def plane_map(
    title: str,
    description: str,
    counts: Numbers,
    *,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    axes: tuple[str, str],
) -> Html:
    """Draw how often each place of a plane was visited, with equal scales on both axes.

    Parameters
    ----------
    title, description : str
    counts : (R, C) float64
        Rows from low y to high y.
    x_range, y_range : (float, float)
        Edges.
    axes : (str, str)
        What the axes show, with the units.
    """
    left, room, tallest = 46.0, WIDTH - 46.0, 260.0
    across, up = x_range[1] - x_range[0], y_range[1] - y_range[0]
    per_unit = min(room / across, tallest / up)
    wide, tall, top = across * per_unit, up * per_unit, 22.0
    with np.errstate(divide="ignore"):
        # From one visit to most visits by factors: a place that was rested at would hide the rest.
        shown = np.where(counts > 0, 1 + np.log(np.maximum(counts, 1)), 0)
    levels = _levels(shown, float(shown.max()))
    cell = (wide / counts.shape[1], tall / counts.shape[0])
    parts = [
        label(0, top - 9, axes[1], quiet=True),
        element("rect", x=left, y=top, width=wide, height=tall, class_="ground"),
        level_cells(levels[::-1], left=left, top=top, cell=cell),
    ]
    for tick in round_ticks(*y_range, max(2, int(tall / 50))):
        y = top + tall - (tick - y_range[0]) * per_unit
        parts.append(element("line", x1=left - 3, x2=left, y1=y, y2=y, class_="axis"))
        parts.append(label(left - 6, y + 4, _tick(tick), anchor="end", quiet=True))
    ticks = [
        (left + (tick - x_range[0]) * per_unit, _tick(tick))
        for tick in round_ticks(*x_range, max(2, int(wide / 70)))
    ]
    parts.append(x_axis(ticks, left=left, right=left + wide, y=top + tall, title=axes[0]))
    scale = _legend(top + tall + 42, "seldom", "often", "logarithmic; empty: never")
    return picture(title, description, top + tall + 42 + _LEGEND, *parts, scale)


def _tick(value: float) -> str:
    return tick_text(float(f"{value:.6g}"))


def row_map(
    title: str,
    description: str,
    rows: Sequence[tuple[str, Sequence[float]]],
    *,
    x_range: tuple[float, float],
    x_title: str,
    legend: str,
) -> Html:
    """Draw shares (0 to 1) of groups over equal steps, a row a group.

    Parameters
    ----------
    title, description : str
    rows : sequence of (str, sequence of float)
        Name, and one share a step; NaN where there is none.
    x_range : (float, float)
        Begin of the first step and end of the last.
    x_title, legend : str
    """
    steps = len(rows[0][1])
    across = WIDTH - _NAMES
    parts = []
    for number, (name, shares) in enumerate(rows):
        y = number * _ROW + 2
        parts.append(label(_NAMES - 8, y + 13, name, anchor="end", width=_NAMES - 10))
        parts.append(
            element("rect", x=_NAMES, y=float(y), width=across, height=_ROW - 3, class_="ground")
        )
        levels = [0 if math.isnan(share) else math.ceil(share * LEVELS) for share in shares]
        cell = (across / steps, _ROW - 3.0)
        parts.append(level_cells([levels], left=_NAMES, top=y, cell=cell))
    bottom = len(rows) * _ROW + 2
    low, high = x_range
    ticks = [
        (_NAMES + (tick - low) / ((high - low) or 1) * across, _tick(tick))
        for tick in round_ticks(low, high, 4)
    ]
    parts.append(x_axis(ticks, left=_NAMES, right=WIDTH, y=bottom, title=x_title))
    scale = _legend(bottom + 42, "0 %", "100 %", legend)
    return picture(title, description, bottom + 42 + _LEGEND, *parts, scale)
