"""One picture of one grasp: what camera and fingers saw and felt, and what a loader yields."""

from collections.abc import Sequence
from dataclasses import dataclass

from exumi_data.demo.canvas import Canvas, mix
from exumi_data.demo.curves import CURVES_HEIGHT, Band, draw_curves
from exumi_data.demo.look import GAP, GROUND, LABELS, MARGIN, PLAIN, QUIET, TEXT, WIDTH, WINDOW
from exumi_data.demo.story import GraspTruth, Moment, SheetWindow
from exumi_data.demo.tiles import draw_moments
from exumi_data.episode import Episode

__all__ = ["SheetText", "contact_sheet"]

_GRID_TOP = 236
_ROWS = 4
_PAD = 24


@dataclass(frozen=True, slots=True)
class SheetText:
    """The words at the head and at the foot of the picture."""

    title: str
    subtitle: str
    foot: str


def contact_sheet(  # what the picture is put together from
    episode: Episode,
    prepared: Episode,
    moments: Sequence[Moment],
    truth: GraspTruth,
    window: SheetWindow,
    text: SheetText,
) -> Canvas:
    """Draw the picture.

    Parameters
    ----------
    episode : Episode
        With streams ``rgb``, ``tactile_left``, ``tactile_right``, ``width`` and ``pose``.
    prepared : Episode
        The same, prepared for training.
    moments : sequence of Moment
        The columns.
    truth : GraspTruth
    window : SheetWindow
        Of ``tactile_left``.
    text : SheetText

    Returns
    -------
    Canvas
        2000 pixels wide.
    """
    across = (WIDTH - 2 * MARGIN - LABELS - (len(moments) - 1) * GAP) / len(moments)
    tile = (across, float(round(across * 0.75)))
    small = (WIDTH - 2 * MARGIN - 2 * _PAD - len(window.steps) * GAP) / (len(window.steps) + 1)
    strip_top = _GRID_TOP + _ROWS * (tile[1] + GAP) + 84 + CURVES_HEIGHT + 108
    height = round(strip_top + 74 + small * 0.75 + 52 + 90)
    canvas = Canvas(WIDTH, height, GROUND)
    canvas.text((MARGIN, 104), text.title, size=58, color=TEXT, weight=600)
    canvas.text((MARGIN, 152), text.subtitle, size=25, color=QUIET)
    bottom = draw_moments(canvas, episode, moments, top=_GRID_TOP, tile=tile)
    band = draw_curves(canvas, episode, prepared, moments, truth, window, top=bottom + GAP + 84)
    _draw_window(canvas, window, band, top=strip_top, small=small)
    canvas.text((MARGIN, height - 30), text.foot, size=21, color=mix(QUIET, GROUND, 0.25))
    return canvas


def _draw_window(
    canvas: Canvas, window: SheetWindow, band: Band, *, top: float, small: float
) -> None:
    """Draw the window's frames on a panel that grows out of its band in the charts."""
    tall = small * 0.75
    right = WIDTH - MARGIN
    funnel = [(band.left, band.bottom), (band.right, band.bottom), (right, top + 8)]
    canvas.area([*funnel, (MARGIN, top + 8)], WINDOW, alpha=0.10)
    panel = (MARGIN, top, right - MARGIN, 74 + tall + 52)
    canvas.box(panel, mix(GROUND, WINDOW, 0.16), radius=16)
    at = (float(MARGIN + _PAD), top + 46)
    canvas.text(at, "One training window", size=28, color=TEXT, weight=600)
    note = (
        f"{len(window.steps)} tactile frames and a camera frame around step 0, 50 ms a step, "
        f"by {window.loader}"
    )
    at = (right - _PAD, top + 45)
    canvas.text(at, note, size=22, color=mix(QUIET, TEXT, 0.3), align="right")
    tiles = [(_step(step), image) for step, image in zip(window.steps, window.tactile, strict=True)]
    camera = sum(step <= 0 for step in window.steps)  # between history and future
    tiles.insert(camera, ("camera, 0", window.rgb))
    for number, (name, image) in enumerate(tiles):
        x, y = MARGIN + _PAD + number * (small + GAP), top + 74
        canvas.image((x, y, small, tall), image, radius=8)
        if number == camera:
            canvas.frame((x, y, small, tall), PLAIN, width=3, radius=8)
        at = (x + small / 2, y + tall + 31)
        canvas.text(at, name, size=22, color=mix(QUIET, TEXT, 0.5), align="center")


def _step(step: int) -> str:
    return f"step {step}" if step == 0 else f"step {'+' if step > 0 else '−'}{abs(step)}"
