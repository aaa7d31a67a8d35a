"""Colours and measures of the picture."""

from exumi_data.demo.canvas import Canvas, Color, mix

__all__ = [
    "CONCAVE",
    "CONVEX",
    "FINGERS",
    "GAP",
    "GROUND",
    "LABELS",
    "LEFT",
    "MARGIN",
    "PANEL",
    "PLAIN",
    "QUIET",
    "RIGHT",
    "TEXT",
    "TRUE",
    "WIDTH",
    "WINDOW",
    "badge",
    "row_label",
]

GROUND: Color = (13, 17, 23)
PANEL: Color = (21, 27, 35)
TEXT: Color = (236, 240, 245)
QUIET: Color = (139, 149, 162)
LEFT: Color = (45, 212, 191)
RIGHT: Color = (251, 146, 180)
PLAIN: Color = (203, 213, 225)
TRUE: Color = (220, 38, 38)
WINDOW: Color = (167, 139, 250)
CONVEX: Color = (255, 183, 77)
CONCAVE: Color = (79, 156, 255)

FINGERS: dict[str, Color] = {"tactile_right": RIGHT, "tactile_left": LEFT}
"""Tactile streams in the order in which curves are drawn: the left one lies on top."""

WIDTH = 2000
MARGIN = 68
LABELS = 204
"""Pixels at the left for the names of rows."""
GAP = 14


def badge(canvas: Canvas, at: tuple[float, float], number: int) -> None:
    """Draw a number on a disc: the same at a column of images and at its time in the charts."""
    canvas.dot(at, mix(GROUND, TEXT, 0.9), radius=15)
    canvas.text((at[0], at[1] + 8), str(number), size=22, color=GROUND, weight=700, align="center")


def row_label(canvas: Canvas, middle: float, name: str, note: str = "") -> None:
    """Write the name of a row, and a note under it, left of the row."""
    canvas.text((MARGIN + 20, middle + 2), name, size=24, color=TEXT, weight=500)
    if note:
        canvas.text((MARGIN + 20, middle + 29), note, size=19, color=QUIET)
