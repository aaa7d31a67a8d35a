"""One episode of a dataset as curves over time: activity, width, force, where the hand was."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.dataset import Dataset
from exumi_data.demo.canvas import Canvas, Color
from exumi_data.demo.look import CONVEX, GROUND, LEFT, PANEL, PLAIN, QUIET, RIGHT, TEXT, WINDOW
from exumi_data.episode import Episode, StreamView

__all__ = ["signals_picture", "title"]

_WIDTH = 1000
_MARGIN = 24
_LEFT, _RIGHT = 190, 70
_TALL, _GAP, _HEAD, _FOOT = 110, 12, 64, 40
_PAD = 10
_MOST_POINTS = 4000
_MOST_ROWS = 6
_COLORS: tuple[Color, ...] = (LEFT, RIGHT, WINDOW, CONVEX, PLAIN)
Float = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Row:
    """Curves on one scale."""

    name: str
    unit: str
    curves: tuple[tuple[str, Float, Float], ...]


def signals_picture(dataset: Dataset) -> Canvas | None:
    """Draw the signals of the episode that has most of them, of those the one of median length.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    Canvas or None
        None where no episode has any.
    """
    table = dataset.catalog.select(["duration_s", "streams"]).to_pylist()
    kinds = [len({s["name"] for s in row["streams"] if s["n"]}) for row in table]
    most = [i for i, count in enumerate(kinds) if count == max(kinds) > 0]
    by_length = sorted(most, key=lambda i: (table[i]["duration_s"], i))
    if not by_length:
        return None
    with dataset[by_length[len(by_length) // 2]] as episode:
        rows = list(_rows(episode))[:_MOST_ROWS]
        return _drawn(episode, rows) if rows else None


def title(canvas: Canvas, text: str, about: str) -> None:
    """Write the head of a picture.

    Parameters
    ----------
    canvas : Canvas
    text : str
    about : str
        In quiet letters beside it.
    """
    width = canvas.text((_MARGIN, 38), text, size=26, color=TEXT, weight=600)
    canvas.text((_MARGIN + width + 16, 38), about, size=17, color=QUIET)


def _rows(episode: Episode) -> Iterator[_Row]:
    felt = [(s.name, _seconds(s), s.activity) for s in episode.of_kind("tactile")]
    curves = [(n, t, 100.0 * np.asarray(a, np.float64)) for n, t, a in felt if a is not None]
    curves = [curve for curve in curves if len(curve[1]) > 1]
    if curves:
        yield _Row("contact", "% of pixels active", tuple(curves))
    widths = [s for s in episode.of_kind("width") if len(s) > 1]
    if widths:
        opening = [(s.name, _seconds(s), 1e3 * s.data.astype(np.float64)) for s in widths]
        yield _Row("gripper width", "mm", tuple(opening))
    for stream in episode.of_kind("wrench"):
        names = stream.metadata.components  # type: ignore[attr-defined]  # by its kind
        data = stream.data.astype(np.float64)
        unit = "N" if all(name.startswith("f") for name in names) else "N, N·m"
        if len(data) > 1:
            time = _seconds(stream)
            yield _Row(stream.name, unit, tuple((n, time, data[:, i]) for i, n in enumerate(names)))
    for stream in episode.of_kind("pose"):
        if len(stream) > 1:
            time, place = _seconds(stream), stream.data[:, :3]
            curves = [(axis, time, place[:, i] * 1e3) for i, axis in enumerate("xyz")]
            yield _Row(stream.name, "position, mm", tuple(curves))


def _seconds(stream: StreamView) -> Float:
    return stream.time.astype(np.float64) * 1e-9


def _drawn(episode: Episode, rows: list[_Row]) -> Canvas:
    times = [time for row in rows for _, time, _ in row.curves]
    start, end = min(t[0] for t in times), max(t[-1] for t in times)
    height = _HEAD + len(rows) * (_TALL + _GAP) + _FOOT
    canvas = Canvas(_WIDTH, height, GROUND)
    title(canvas, "One episode", f"{episode.metadata.task.name[:40]}  ·  {episode.id}")
    for number, row in enumerate(rows):
        _chart(canvas, row, _HEAD + number * (_TALL + _GAP), (start, end))
    bottom = _HEAD + len(rows) * (_TALL + _GAP)
    for time in _ticks(start, end, 8):
        x = float(_x(time, (start, end)))
        canvas.text((x, bottom + 20), f"{time:g} s", size=15, color=QUIET, align="center")
    return canvas


def _chart(canvas: Canvas, row: _Row, top: float, span: tuple[float, float]) -> None:
    width = _WIDTH - _LEFT - _RIGHT
    canvas.box((_LEFT, top, width, _TALL), PANEL, radius=6)
    canvas.text((_MARGIN, top + 24), row.name[:20], size=18, color=TEXT, weight=500)
    canvas.text((_MARGIN, top + 44), row.unit, size=14, color=QUIET)
    finite = np.concatenate([value[np.isfinite(value)] for _, _, value in row.curves])
    if not len(finite):
        return
    low, high = float(finite.min()), float(finite.max())
    if low >= 0 and low < 0.5 * high:
        low = 0.0
    if high <= low:
        low, high = low - 0.5, high + 0.5

    def y(value: Float | float) -> Float:
        share = (np.asarray(value) - low) / (high - low)
        return np.asarray(top + _TALL - _PAD - share * (_TALL - 2 * _PAD))

    for value in _ticks(low, high, 3):
        at = float(y(value))
        canvas.line([(_LEFT, at), (_LEFT + width, at)], (38, 46, 56), width=1)
        canvas.text((_LEFT + width + 8, at + 5), f"{value:g}", size=14, color=QUIET)
    for number, (name, time, values) in enumerate(row.curves):
        color = _COLORS[number % len(_COLORS)]
        step = -(-len(time) // _MOST_POINTS)
        for part in _whole(time[::step], values[::step]):
            points = np.column_stack([_x(part[0], span), y(part[1])])
            canvas.line([(float(a), float(b)) for a, b in points], color, width=2)
        if len(row.curves) > 1:
            place = (_MARGIN + 8 + number % 2 * 84, top + 66 + number // 2 * 17)
            canvas.dot((place[0], place[1] - 4), color, radius=4)
            canvas.text((place[0] + 9, place[1]), _short(name), size=13, color=QUIET)


def _short(name: str) -> str:
    text = name.removeprefix("tactile_")
    return text if len(text) <= 9 else f"{text[:8]}…"


def _whole(time: Float, values: Float) -> Iterator[tuple[Float, Float]]:
    """Yield the stretches without missing values."""
    sound = np.isfinite(values)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], sound, [False]]).astype(np.int8)))
    for first, last in edges.reshape(-1, 2):
        if last - first > 1:
            yield time[first:last], values[first:last]


def _x(time: Float | float, span: tuple[float, float]) -> Float:
    start, end = span
    length = max(end - start, 1e-9)
    return np.asarray(_LEFT + (np.asarray(time) - start) / length * (_WIDTH - _LEFT - _RIGHT))


def _ticks(low: float, high: float, about: int) -> list[float]:
    """Return round values between two, about as many as asked for."""
    rough = max(high - low, 1e-9) / about
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    first = np.ceil(low / step)
    count = int(np.floor(high / step) - first) + 1
    return [round(float((first + number) * step), 10) + 0.0 for number in range(max(count, 0))]
