"""The grid of images: a column a moment, a row a sensor."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from exumi_data.demo.canvas import Canvas
from exumi_data.demo.look import (
    CONCAVE,
    CONVEX,
    GAP,
    LABELS,
    LEFT,
    MARGIN,
    PANEL,
    PLAIN,
    QUIET,
    RIGHT,
    TEXT,
    badge,
    row_label,
)
from exumi_data.demo.story import Moment
from exumi_data.episode import Episode
from exumi_data.tactile import paint_change
from exumi_data.time import nearest_indices

__all__ = ["draw_moments"]

_ROWS = (
    ("wrist camera", "", PLAIN),
    ("left finger", "", LEFT),
    ("right finger", "", RIGHT),
    ("left, change", "from no contact", LEFT),
)
_ANY_DISTANCE_NS = 10**18

UInt8Array = npt.NDArray[np.uint8]


def draw_moments(
    canvas: Canvas,
    episode: Episode,
    moments: Sequence[Moment],
    *,
    top: float,
    tile: tuple[float, float],
) -> float:
    """Draw the grid.

    Parameters
    ----------
    canvas : Canvas
    episode : Episode
    moments : sequence of Moment
    top : float
        Of the first row, pixels.
    tile : (float, float)
        Width and height of an image, pixels.

    Returns
    -------
    float
        Bottom of the last row, pixels.
    """
    row = tile[1] + GAP
    for number, (name, note, color) in enumerate(_ROWS):
        y = top + number * row
        canvas.box((MARGIN, y + 6, 5, tile[1] - 12), color, radius=2)
        row_label(canvas, y + tile[1] / 2, name, note)
    _legend(canvas, top + (len(_ROWS) - 0.5) * row + 56)
    for number, moment in enumerate(moments):
        x = MARGIN + LABELS + number * (tile[0] + GAP)
        badge(canvas, (x + 15, top - 27), number + 1)
        canvas.text((x + 42, top - 18), moment.name, size=27, color=TEXT, weight=600)
        time = f"{moment.time_ns * 1e-9:.2f} s"
        canvas.text((x + tile[0], top - 18), time, size=22, color=QUIET, align="right")
        for position, image in enumerate(_images(episode, moment)):
            canvas.image((x, top + position * row, *tile), image, radius=10)
    return top + len(_ROWS) * row - GAP


def _legend(canvas: Canvas, y: float) -> None:
    for name, color in (("brighter", CONVEX), ("darker", CONCAVE)):
        canvas.dot((MARGIN + 28, y - 6), color, radius=6)
        canvas.text((MARGIN + 44, y), name, size=19, color=QUIET)
        y += 26


def _images(episode: Episode, moment: Moment) -> list[UInt8Array]:
    index = {
        name: int(
            nearest_indices(episode[name].time, np.array([moment.time_ns]), _ANY_DISTANCE_NS)[0]
        )
        for name in ("rgb", "tactile_left", "tactile_right")
    }
    seen = [episode[name].frames[number] for name, number in index.items()]
    return [*seen, _change(episode, "tactile_left", index["tactile_left"])]


def _change(episode: Episode, stream: str, index: int) -> UInt8Array:
    """Paint the two channels that exUMI trains on: brighter and darker than without contact."""
    reference = episode[stream].reference
    assert reference is not None  # noqa: S101  # the demonstration stores one
    grey = episode[stream].frames.read([index], grey=True)[0, ..., 0]
    return paint_change(grey, reference, ground=PANEL, brighter=CONVEX, darker=CONCAVE)
