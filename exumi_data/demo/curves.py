"""The curves of a grasp over time, and where the training window lies in them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.demo.canvas import Canvas, mix
from exumi_data.demo.chart import Chart, Curve
from exumi_data.demo.look import (
    FINGERS,
    GROUND,
    LABELS,
    MARGIN,
    PANEL,
    PLAIN,
    QUIET,
    TEXT,
    TRUE,
    WIDTH,
    WINDOW,
    badge,
    row_label,
)
from exumi_data.demo.story import (
    FIRST_STEP,
    LAST_STEP,
    TICK_NS,
    GraspTruth,
    Moment,
    SheetWindow,
)
from exumi_data.episode import Episode

__all__ = ["CURVES_HEIGHT", "Band", "draw_curves"]

CURVES_HEIGHT = 558
"""Of all charts together, pixels."""

_BETWEEN = 22
_HEIGHTS = (116, 116, 130, 130)
_LEFT = MARGIN + LABELS
_ACROSS = WIDTH - MARGIN - _LEFT


@dataclass(frozen=True, slots=True)
class Band:
    """Where the training window lies in the charts, pixels."""

    left: float
    right: float
    bottom: float


@dataclass(frozen=True, slots=True)
class _Row:
    name: str
    unit: str
    height: int
    curves: tuple[Curve, ...]


def draw_curves(  # what the charts are put together from
    canvas: Canvas,
    episode: Episode,
    prepared: Episode,
    moments: Sequence[Moment],
    truth: GraspTruth,
    window: SheetWindow,
    *,
    top: float,
) -> Band:
    """Draw width and height of the gripper, contact depth and activity, one below the other.

    Parameters
    ----------
    canvas : Canvas
    episode : Episode
    prepared : Episode
        The same, prepared for training: its activity is drawn.
    moments : sequence of Moment
        Marked by lines with their numbers.
    truth : GraspTruth
    window : SheetWindow
        Marked by a band, its frames by dots on the left finger's activity.
    top : float
        Pixels.

    Returns
    -------
    Band
    """
    end_s = max(int(episode[name].time[-1]) for name in episode.streams) * 1e-9
    rows = _rows(episode, prepared, truth)
    bottom = top + sum(row.height for row in rows) + _BETWEEN * (len(rows) - 1)
    band = Band(
        max(_x((window.time_ns + FIRST_STEP * TICK_NS) * 1e-9, end_s), _LEFT),
        min(_x((window.time_ns + LAST_STEP * TICK_NS) * 1e-9, end_s), _LEFT + _ACROSS),
        bottom,
    )
    y = top
    charts = []
    for row in rows:
        box = (float(_LEFT), y, float(_ACROSS), float(row.height))
        canvas.box(box, PANEL, radius=8)
        row_label(canvas, y + row.height / 2 - 4, row.name, row.unit)
        charts.append(Chart(box, (0.0, end_s), row.curves))
        y += row.height + _BETWEEN
    canvas.box((band.left, top, band.right - band.left, bottom - top), WINDOW, alpha=0.16)
    for number, moment in enumerate(moments):
        x = _x(moment.time_ns * 1e-9, end_s)
        canvas.line([(x, top - 12), (x, bottom)], mix(GROUND, TEXT, 0.35), width=1)
        badge(canvas, (x, top - 27), number + 1)
    for chart in charts:
        chart.draw(canvas, grid=mix(PANEL, TEXT, 0.10), text=QUIET)
    _window_dots(canvas, charts[-1], rows[-1].curves[-1], window)
    _time_axis(canvas, end_s, bottom)
    return band


def _x(time_s: float, end_s: float) -> float:
    return _LEFT + time_s / end_s * _ACROSS


def _rows(episode: Episode, prepared: Episode, truth: GraspTruth) -> tuple[_Row, ...]:
    true_s = _seconds(truth.time_ns)
    width, pose = episode["width"], episode["pose"]
    opening = (
        Curve(_seconds(width.time), width.data * 1e3, PLAIN),
        Curve(true_s, truth.width_m * 1e3, TRUE, is_truth=True),
    )
    height = (
        Curve(_seconds(pose.time), pose.data[:, 2] * 1e3, PLAIN),
        Curve(true_s, truth.height_m * 1e3, TRUE, is_truth=True),
    )
    depth = [Curve(true_s, truth.depth_m[name] * 1e3, color) for name, color in FINGERS.items()]
    activity = []
    for name, color in FINGERS.items():
        stored = prepared[name].activity
        assert stored is not None  # noqa: S101  # preparing measures it
        times = _seconds(prepared[name].time)
        activity.append(Curve(times, stored.astype(np.float64) * 100, color))
    names = (
        ("gripper width", "mm, and the truth", opening),
        ("gripper height", "mm, and the truth", height),
        ("contact depth", "mm, true", tuple(depth)),
        ("activity", "% of pixels", tuple(activity)),
    )
    return tuple(
        _Row(name, unit, height_px, curves)
        for (name, unit, curves), height_px in zip(names, _HEIGHTS, strict=True)
    )


def _seconds(time_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    return time_ns.astype(np.float64) * 1e-9


def _window_dots(canvas: Canvas, chart: Chart, curve: Curve, window: SheetWindow) -> None:
    for step in window.steps:
        time_s = (window.time_ns + step * TICK_NS) * 1e-9
        at = chart.place(time_s, float(np.interp(time_s, curve.time_s, curve.value)))
        canvas.dot(at, PANEL, radius=10)
        canvas.dot(at, WINDOW, radius=7)


def _time_axis(canvas: Canvas, end_s: float, bottom: float) -> None:
    for second in range(int(end_s) + 1):
        text = f"{second} s" if second == int(end_s) else f"{second}"
        at = (_x(float(second), end_s), bottom + 30)
        canvas.text(at, text, size=20, color=QUIET, align="center")
