"""Bars, histograms, lines and ranges as SVG: small, quiet, readable on a phone and on paper."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from exumi_data.stats.html.markup import Html, element, join
from exumi_data.stats.html.svg import WIDTH, label, picture, round_ticks, tick_text, x_axis

__all__ = [
    "Bar",
    "RangeRow",
    "bar_chart",
    "histogram",
    "line_chart",
    "range_chart",
]

_NAMES = 118  # units for the names of rows
_ROW = 21
_LEFT = 40  # units for the numbers of a vertical axis
_PLOT = 120


@dataclass(frozen=True, slots=True)
class Bar:
    """A row of a bar chart: its name, its length, and what is written at its end."""

    name: str
    value: float
    note: str
    rest: bool = False


def bar_chart(
    title: str, description: str, bars: Sequence[Bar], *, unit: str, most: float | None = None
) -> Html:
    """Draw horizontal bars.

    Parameters
    ----------
    title, description : str
    bars : sequence of Bar
        From the top. Those of `rest` stand for several and are drawn lighter.
    unit : str
        What the length means.
    most : float, optional
        Length of a full row; default the longest bar.
    """
    longest = most or max((bar.value for bar in bars), default=0) or 1
    notes = max((len(bar.note) for bar in bars), default=0) * 6.2 + 8
    room = WIDTH - _NAMES - notes
    parts = []
    for number, bar in enumerate(bars):
        y = number * _ROW
        width = max(bar.value / longest * room, 1.5 if bar.value else 0)
        parts.append(label(_NAMES - 8, y + 15, bar.name, anchor="end", width=_NAMES - 10))
        shown = element("title", f"{bar.name[:200]}: {bar.note}")
        parts.append(
            element("g", shown, _bar(_NAMES, y + 4, width, 14), class_="c9" if bar.rest else "c1")
        )
        parts.append(label(_NAMES + width + 6, y + 15, bar.note, quiet=True))
    height = len(bars) * _ROW
    parts.append(label(_NAMES, height + 14, unit, quiet=True))
    return picture(title, description, height + 20, *parts)


def _bar(x: float, y: float, width: float, height: float) -> Html:
    return element("rect", x=float(x), y=float(y), width=float(width), height=height, rx=2)


def _scale(low: float, high: float, left: float, right: float, value: float) -> float:
    return left + (value - low) / ((high - low) or 1) * (right - left)


def _y_axis(top: float, unit: str, most: float, *, whole: bool, unit_y: float) -> Html:
    ticks = [tick for tick in round_ticks(0, most, 3) if not whole or tick == int(tick)]
    parts = []
    for tick in ticks:
        y = _scale(0, most, top + _PLOT, top, tick)
        parts.append(element("line", x1=_LEFT, x2=WIDTH, y1=y, y2=y, class_="grid"))
        parts.append(label(_LEFT - 5, y + 4, tick_text(tick), anchor="end", quiet=True))
    parts.append(label(0, unit_y, unit, quiet=True))
    return join(*parts)


def histogram(
    title: str,
    description: str,
    bins: Sequence[tuple[float, float, float]],
    *,
    x_title: str,
    y_title: str,
    mark: tuple[float, str] | None = None,
) -> Html:
    """Draw a histogram.

    Parameters
    ----------
    title, description : str
    bins : sequence of (float, float, float)
        Left and right edge, and height.
    x_title, y_title : str
        What the axes show, with the units.
    mark : (float, str), optional
        A line at a value, and what it is.
    """
    low, high = bins[0][0], bins[-1][1]
    top = 38 if mark else 22
    most = max(count for _, _, count in bins) or 1
    whole = all(count == int(count) for _, _, count in bins)
    # Above the words at the mark, which may stand at the left.
    parts = [_y_axis(top, y_title, most, whole=whole, unit_y=12 if mark else top - 8)]
    bars = []
    for left, right, count in bins:
        x0, x1 = (_scale(low, high, _LEFT, WIDTH, edge) for edge in (left, right))
        tall = count / most * _PLOT
        if count:
            tall = max(tall, 1)
            note = f"{tick_text(_near(left))} to {tick_text(_near(right))}: {count:,.4g}"
            bars.append(
                element(
                    "rect",
                    element("title", note),
                    x=x0 + 0.4,
                    y=top + _PLOT - tall,
                    width=max(x1 - x0 - 0.8, 0.6),
                    height=tall,
                )
            )
    parts.append(element("g", *bars, class_="c1"))
    if mark is not None and low <= mark[0] <= high:
        x = _scale(low, high, _LEFT, WIDTH, mark[0])
        parts.append(element("line", x1=x, x2=x, y1=top - 4, y2=top + _PLOT, class_="mark"))
        anchor = "end" if x > WIDTH * 0.6 else "start"
        parts.append(label(x + (-4 if anchor == "end" else 4), top - 4, mark[1], anchor=anchor))
    ticks = [(_scale(low, high, _LEFT, WIDTH, t), tick_text(_near(t))) for t in _few(low, high)]
    parts.append(x_axis(ticks, left=_LEFT, right=WIDTH, y=top + _PLOT, title=x_title))
    return picture(title, description, top + _PLOT + 34, *parts)


def _few(low: float, high: float) -> list[float]:
    return round_ticks(low, high, 5)


def _near(value: float) -> float:
    return float(f"{value:.6g}")


def line_chart(
    title: str,
    description: str,
    values: Sequence[float],
    *,
    x_range: tuple[float, float],
    x_title: str,
    y_title: str,
    y_range: tuple[float, float] | None = None,
) -> Html:
    """Draw numbers over equal steps as a filled line; shares are drawn from 0 to 100 %.

    Parameters
    ----------
    title, description : str
    values : sequence of float
        One a step; NaN where there is none.
    x_range : (float, float)
        Begin of the first step and end of the last.
    x_title, y_title : str
    y_range : (float, float), optional
        Ends of the axis. Default: the numbers are shares, 0 to 1.
    """
    top, low, high = 22, *x_range
    bottom, most = (0.0, 1.0) if y_range is None else y_range
    if y_range is None:
        levels = [(share, f"{share * 100:.0f} %") for share in (0, 0.25, 0.5, 0.75, 1)]
    else:
        levels = [(tick, tick_text(_near(tick))) for tick in round_ticks(bottom, most, 4)]
    parts = []
    for level, words in levels:
        y = _scale(bottom, most, top + _PLOT, top, level)
        parts.append(element("line", x1=_LEFT, x2=WIDTH, y1=y, y2=y, class_="grid"))
        parts.append(label(_LEFT - 5, y + 4, words, anchor="end", quiet=True))
    parts.append(label(0, top - 8, y_title, quiet=True))
    for run in _runs(values):
        points = [
            (
                _scale(0, len(values), _LEFT, WIDTH, number + 0.5),
                _scale(bottom, most, top + _PLOT, top, values[number]),
            )
            for number in run
        ]
        line = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        base = top + _PLOT  # of a level; what is above and below 0 is filled from there
        if bottom < 0 < most:
            base = round(_scale(bottom, most, top + _PLOT, top, 0))
        area = f"M{points[0][0]:.1f} {base}L{line}L{points[-1][0]:.1f} {base}z"
        parts.append(element("path", d=area, class_="area"))
        parts.append(element("path", d=f"M{line}", class_="line"))
    ticks = [(_scale(low, high, _LEFT, WIDTH, t), tick_text(_near(t))) for t in _few(low, high)]
    parts.append(x_axis(ticks, left=_LEFT, right=WIDTH, y=top + _PLOT, title=x_title))
    return picture(title, description, top + _PLOT + 34, *parts)


def _runs(values: Sequence[float]) -> list[list[int]]:
    runs: list[list[int]] = [[]]
    for number, value in enumerate(values):
        if math.isnan(value):
            runs.append([])
        else:
            runs[-1].append(number)
    return [run for run in runs if run]


@dataclass(frozen=True, slots=True)
class RangeRow:
    """A row of a range chart: ends, the middle half, the median; a note; a value that is wanted."""

    name: str
    low: float
    quarter: float
    median: float
    three_quarters: float
    high: float
    note: str
    wanted: float | None = None


def range_chart(
    title: str,
    description: str,
    rows: Sequence[RangeRow],
    *,
    x_title: str,
    log: bool = False,
    from_zero: bool = True,
) -> Html:
    """Draw ranges: a thin line from the smallest to the largest, a thick one, a dot at the median.

    Parameters
    ----------
    title, description : str
    rows : sequence of RangeRow
        From the top.
    x_title : str
        What the axis shows, with the unit.
    log : bool
        Logarithmic axis; all values are above 0.
    from_zero : bool
        The axis begins at 0.
    """
    ends = [value for row in rows for value in (row.low, row.high, row.wanted) if value is not None]
    low, high = min(ends), max(ends)
    if log:
        low, high = 10 ** math.floor(math.log10(low)), 10 ** math.ceil(math.log10(high * 1.0001))
    elif from_zero:
        low, high = min(low, 0), max(high, 0)
    if low == high:
        low, high = low - 0.5, high + 0.5
    notes = max((len(row.note) for row in rows), default=0) * 6.2 + 10
    right = WIDTH - notes

    def place(value: float) -> float:
        if log:
            return _scale(math.log10(low), math.log10(high), _NAMES, right, math.log10(value))
        return _scale(low, high, _NAMES, right, value)

    bottom = len(rows) * _ROW + 4
    ticks = _log_ticks(low, high) if log else round_ticks(low, high, 3)
    parts = [
        element("line", x1=place(t), x2=place(t), y1=0, y2=bottom, class_="grid") for t in ticks
    ]
    for number, row in enumerate(rows):
        parts.append(_range_row(row, number * _ROW + 12.0, place, note_x=float(WIDTH)))
    shown = [(place(tick), tick_text(_near(tick))) for tick in ticks]
    parts.append(x_axis(shown, left=_NAMES, right=right, y=bottom, title=x_title))
    return picture(title, description, bottom + 34, *parts)


def _log_ticks(low: float, high: float) -> list[float]:
    first, last = round(math.log10(low)), round(math.log10(high))
    step = max(1, (last - first) // 4)
    return [10.0**power for power in range(first, last + 1, step)]


def _range_row(row: RangeRow, y: float, place: Callable[[float], float], *, note_x: float) -> Html:
    low, quarter, median, three, high = (
        place(v) for v in (row.low, row.quarter, row.median, row.three_quarters, row.high)
    )
    parts = [
        element("title", f"{row.name[:200]}: {row.note}"),
        element("line", x1=low, x2=max(high, low + 1), y1=y, y2=y, class_="whisker"),
        element("line", x1=quarter, x2=max(three, quarter + 1), y1=y, y2=y, class_="box"),
    ]
    if row.wanted is not None:
        x = place(row.wanted)
        parts.append(element("line", x1=x, x2=x, y1=y - 7, y2=y + 7, class_="mark"))
    parts.append(element("circle", cx=median, cy=y, r=3.6, class_="dot"))
    name = label(_NAMES - 8, y + 4, row.name, anchor="end", width=_NAMES - 10)
    note = label(note_x, y + 4, row.note, anchor="end", quiet=True)
    return join(name, element("g", *parts), note)
