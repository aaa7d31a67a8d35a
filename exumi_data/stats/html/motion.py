"""Section: which widths, forces and poses the data covers."""

from collections import Counter

import numpy as np
import numpy.typing as npt

from exumi_data.stats.html.charts import histogram
from exumi_data.stats.html.layout import card, cards, missing, section
from exumi_data.stats.html.maps import plane_map
from exumi_data.stats.html.markup import Html, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.svg import number_text
from exumi_data.stats.html.totals import PoseTotal, ValueTotal
from exumi_data.stats.html.words import counted, percent

__all__ = ["motion"]

_BINS = 30
_CELLS = 56
_MOST_VALUES = 8
_MOST_POSES = 3
_SHOWN_AS = {"m": ("mm", 1e3), "rad": ("°", 180 / np.pi)}
_NAMES = {"width": "Gripper width", "opening": "Gripper opening"}
_WIDE = 3.0
_TAIL = 0.001


def motion(material: Material) -> Html:
    """Write the section.

    Parameters
    ----------
    material : Material
    """
    totals = material.totals
    values = sorted(totals.values.items(), key=lambda item: (item[1].kind != "width", item[0]))
    shown = [_values(key, total, values) for key, total in values[:_MOST_VALUES]]
    for name, pose in sorted(totals.poses.items())[:_MOST_POSES]:
        shown += _pose(name, pose)
    absent = [
        name
        for kind, name in (("width", "gripper width"), ("pose", "pose"), ("wrench", "force"))
        if not totals.holding[kind]
    ]
    if absent:
        why = f"No episode has a stream of: {', '.join(absent)}."
        shown.append(missing("Missing", why))
    lead = "Which part of the world the data covers." if len(absent) < 3 else ""
    return section("motion", "Width, force and pose", lead, cards(*shown))


def _values(
    key: tuple[str, str], total: ValueTotal, others: list[tuple[tuple[str, str], ValueTotal]]
) -> Html:
    stream, component = key
    same = sum(one.kind == total.kind for _, one in others) > 1
    title = _NAMES.get(
        component, f"Force {component}" if total.unit == "N" else f"Torque {component}"
    )
    if same:
        title = f"{title} ({shortened(stream, 30)})"
    if not total.counts:
        return missing(title, "No valid sample.")
    unit, factor = _SHOWN_AS.get(total.unit, (total.unit, 1.0))
    steps = np.array(sorted(total.counts), np.int64)
    counts = np.array([total.counts[int(step)] for step in steps], np.int64)
    drawn, bins, beyond = _histogram(steps, counts)
    scale = total.step * factor
    low, middle, high = (_quantile(steps, counts, q) * scale for q in (0.05, 0.5, 0.95))
    takeaway = f"Nine in ten samples lie between {low:.3g} and {high:.3g} {unit}."
    if total.left_out:
        takeaway += f" {counted(total.left_out, 'sample')} without a valid value."
    # A step is what was rounded to it.
    edges = [((a - 0.5) * scale, (b - 0.5) * scale, count / drawn) for a, b, count in bins]
    chart = histogram(
        title, takeaway, [(a, b, c * 100) for a, b, c in edges],
        x_title=f"{component} ({unit})", y_title="% of samples",
        mark=(middle, f"median {middle:.3g} {unit}"),
    )  # fmt: skip
    note = None
    if beyond:
        note = f"{percent(beyond / drawn)} of the samples lie beyond the ends of the axis."
    return card(title, takeaway, chart, note=note)


def _quantile(steps: npt.NDArray[np.int64], counts: npt.NDArray[np.int64], share: float) -> float:
    total = np.cumsum(counts)
    at = int(np.searchsorted(total, share * total[-1]))
    return float(steps[min(at, len(steps) - 1)])


def _histogram(
    steps: npt.NDArray[np.int64], counts: npt.NDArray[np.int64]
) -> tuple[int, list[tuple[int, int, int]], int]:
    """Merge fine steps into bins; return samples in all, bins, samples beyond the ends."""
    low, high = int(steps[0]), int(steps[-1]) + 1
    inner = (int(_quantile(steps, counts, _TAIL)), int(_quantile(steps, counts, 1 - _TAIL)) + 1)
    if high - low > _WIDE * (inner[1] - inner[0]):
        low, high = inner
    each = max(1, -(-(high - low) // _BINS))
    first, last = low // each, -(-high // each)
    found = np.zeros(last - first, np.int64)
    kept = (steps >= first * each) & (steps < last * each)
    np.add.at(found, steps[kept] // each - first, counts[kept])
    total = int(counts.sum())
    bins = [
        ((first + n) * each, (first + n + 1) * each, int(count)) for n, count in enumerate(found)
    ]
    return total, bins, total - int(found.sum())


def _pose(name: str, pose: PoseTotal) -> list[Html]:
    shown = shortened(name, 30)
    if not pose.from_above:
        return [missing(f"Where {shown} was", "No valid sample.")]
    above, x_range, y_range = _grid(pose.from_above, pose.cell_m)
    side, _, z_range = _grid(pose.from_side, pose.cell_m)
    # The maps are of whole cells; what is said is exact.
    extent = " × ".join(
        _centimetres(high - low) for low, high in zip(pose.low, pose.high, strict=True)
    )
    frames = f"{shortened(pose.child, 24)} in {shortened(pose.parent, 24)}"
    takeaway = f"Poses of {frames} fill a box of {extent} cm."
    if pose.left_out:
        takeaway += f" {counted(pose.left_out, 'sample')} without a valid pose."
    top = plane_map(
        f"{name} from above", takeaway, above,
        x_range=x_range, y_range=y_range, axes=("x (m)", "y (m)"),
    )  # fmt: skip
    z_axis = f"the z axis of {shortened(pose.parent, 24)}"
    height = f"From {pose.low[2]:.3f} to {pose.high[2]:.3f} m on {z_axis}."
    front = plane_map(
        f"{name} from the side", height, side,
        x_range=x_range, y_range=z_range, axes=("x (m)", "z (m)"),
    )  # fmt: skip
    return [
        card(f"Where {shown} was, from above", takeaway, top),
        card(f"Where {shown} was, from the side", height, front),
        _tilts(shown, pose),
    ]


def _centimetres(metres: float) -> str:
    # No pose is known better than to a tenth of a millimetre.
    return number_text(round(100 * metres, 2))


def _grid(
    cells: Counter[tuple[int, int]], cell_m: float
) -> tuple[npt.NDArray[np.float64], tuple[float, float], tuple[float, float]]:
    """Return counts, rows from low to high of the second axis, and the edges of both axes."""
    columns, rows = zip(*cells, strict=True)
    each = max(1, -(-max(max(columns) - min(columns), max(rows) - min(rows)) // _CELLS))
    first = min(columns) // each, min(rows) // each
    last = max(columns) // each + 1, max(rows) // each + 1
    grid = np.zeros((last[1] - first[1], last[0] - first[0]))
    for (column, row), count in cells.items():
        grid[row // each - first[1], column // each - first[0]] += count
    size = each * cell_m
    return grid, (first[0] * size, last[0] * size), (first[1] * size, last[1] * size)


def _tilts(name: str, pose: PoseTotal) -> Html:
    title = f"Tilt of {name}"
    low, high = (f"{end:.1f}".removesuffix(".0") for end in pose.tilt_ends)
    points = f"{low} to {high}°" if low != high else f"{low}°"
    takeaway = (
        f"The z axis of {shortened(pose.child, 24)} points {points} away from that of "
        f"{shortened(pose.parent, 24)}."
    )
    total = pose.tilts.total()
    bins = [
        (5.0 * step, 5.0 * (step + 1), 100 * pose.tilts[step] / total)
        for step in range(min(pose.tilts), max(pose.tilts) + 1)
    ]
    axes = f"{shortened(pose.child, 20)} and {shortened(pose.parent, 20)}"
    chart = histogram(
        title, takeaway, bins, x_title=f"angle between the z axes of {axes} (°)",
        y_title="% of samples",
    )  # fmt: skip
    return card(title, takeaway, chart)
