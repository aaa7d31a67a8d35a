"""Charts are sound XML, and say with their lengths what they are given."""

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from exumi_data.stats.html.charts import (
    Bar,
    RangeRow,
    bar_chart,
    histogram,
    line_chart,
    range_chart,
)
from exumi_data.stats.html.maps import finger_map, plane_map, row_map
from exumi_data.stats.html.svg import level_cells, round_ticks, tick_text


def parsed(svg: str) -> ET.Element:
    return ET.fromstring(svg)  # noqa: S314  # our own


def rects(svg: str, group: str = "c1") -> list[dict[str, float]]:
    found = parsed(svg).findall(f".//g[@class='{group}']//rect")
    return [{key: float(value) for key, value in rect.attrib.items()} for rect in found]


def test_bars_are_as_long_as_their_values() -> None:
    svg = bar_chart("t", "d", [Bar("a", 4, "4"), Bar("b", 1, "1"), Bar("c", 0, "0")], unit="n")
    widths = [rect["width"] for rect in rects(svg)]
    assert widths[1] == pytest.approx(widths[0] / 4, rel=0.01)
    assert widths[2] == 0


def test_a_histogram_is_as_high_as_its_counts() -> None:
    svg = histogram("t", "d", [(0, 1, 2), (1, 2, 8), (2, 3, 0)], x_title="x", y_title="n")
    heights = [rect["height"] for rect in rects(svg)]
    assert heights == [30, 120]
    assert "0.5" not in svg  # counts of things have no halves on their axis


def test_a_line_is_broken_where_nothing_is_known() -> None:
    shares = [0.0, 1.0, float("nan"), 0.5]
    svg = line_chart("t", "d", shares, x_range=(0, 4), x_title="x", y_title="y")
    lines = [p for p in parsed(svg).iter("path") if p.get("class") == "line"]
    assert len(lines) == 2


def test_ranges_stand_at_their_values() -> None:
    rows = [RangeRow("a", 1, 2, 5, 6, 10, "x", wanted=10), RangeRow("b", 0, 0, 0, 0, 0, "y")]
    root = parsed(range_chart("t", "d", rows, x_title="x"))
    dots = [float(dot.get("cx", "")) for dot in root.iter("circle")]
    ends = [(float(x.get("x1", "")), float(x.get("x2", ""))) for x in root.iter("line")
            if x.get("class") == "whisker"]  # fmt: skip
    assert dots[0] - dots[1] == pytest.approx((ends[0][1] - dots[1]) / 2, abs=0.1)
    assert range_chart("t", "d", [rows[1]], x_title="x")  # all at one place is no division by zero
    assert range_chart("t", "d", rows[:1], x_title="x", log=True)


def test_a_finger_map_draws_the_touched_place_darkest() -> None:
    shares = np.zeros((4, 4))
    shares[1, 2], shares[3, 0] = 0.8, 0.1
    root = parsed(finger_map("t", "d", shares, aspect=1.5, legend="l"))
    cells = {p.get("class"): p.get("d") for p in root.iter("path")}
    assert cells == {"q8": "M2 1h1v1h-1z", "q1": "M0 3h1v1h-1z"}
    assert finger_map("t", "d", np.zeros((4, 4)), aspect=1.0, legend="l")


def test_equal_cells_of_a_row_are_one_rectangle() -> None:
    cells = level_cells([[3, 3, 0, 3], [0, 0, 0, 0]], left=0, top=0, cell=(1, 1))
    assert re.findall(r'd="([^"]*)"', cells) == ["M0 0h2v1h-2zM3 0h1v1h-1z"]


def test_maps_of_space_and_of_groups() -> None:
    counts = np.array([[1.0, 0], [0, 1000]])  # rows from low to high: the last is drawn on top
    svg = plane_map("t", "d", counts, x_range=(0, 2), y_range=(0, 2), axes=("x", "y"))
    cells = {p.get("class"): p.get("d") for p in parsed(svg).iter("path")}
    assert cells["q8"] == "M1 0h1v1h-1z"
    rows = [("<a>", [0.0, 0.5, 1.0]), ("b", [float("nan")] * 3)]
    assert parsed(row_map("t", "d", rows, x_range=(0, 9), x_title="x", legend="l")) is not None


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [(0, 10, [0, 5, 10]), (0.12, 0.31, [0.15, 0.2, 0.25, 0.3]), (-1, 1, [-1, -0.5, 0, 0.5, 1]),
     (3, 3, [3]), (0, 1e9, [0, 5e8, 1e9])],
)  # fmt: skip
def test_ticks_are_round(low: float, high: float, ticks: list[float]) -> None:
    assert round_ticks(low, high, 4) == pytest.approx(ticks)


def test_numbers_of_axes() -> None:
    assert [tick_text(v) for v in (0, -0.05, 1500, 5e8)] == ["0", "−0.05", "1,500", "5e8"]
