"""Section: tasks, objects, how long episodes are."""

from statistics import quantiles

from exumi_data.stats.html.charts import RangeRow, histogram, range_chart
from exumi_data.stats.html.layout import card, cards, count_bars, missing, section
from exumi_data.stats.html.markup import Html
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.totals import EpisodeRow
from exumi_data.stats.html.words import counted, percent, top
from exumi_data.wording import time_text

__all__ = ["content"]

_GROUPS = 10
_BINS = 24


def content(material: Material) -> Html:
    """Write the section.

    Parameters
    ----------
    material : Material
    """
    counts = material.statistics.content
    shown = [
        _counts("Tasks", "task", counts.tasks),
        _counts("Objects", "object", counts.objects),
        _counts("Parts", "part", counts.parts),
        _counts("Procedures", "procedure", counts.procedures),
        _counts("Success", "outcome", counts.success),
    ]
    charts = [chart for chart in shown if chart is not None]
    durations = [row.duration_s for row in material.totals.rows]
    if len(durations) > 1:
        charts.append(_lengths(durations))
        if len(material.groups) > 1:
            charts.append(_by_group(material))
    if not charts and not material.totals.rows:
        charts.append(_nothing(bool(material.statistics.unreadable)))
    elif not charts:
        alone = "There is nothing to tell apart: the overview says it all."
        charts.append(card("Nothing to compare", alone))
    lead = "What was done and touched, how often, and how long episodes are."
    return section("content", "What it holds", lead, cards(*charts))


def _nothing(unreadable: bool) -> Html:
    if unreadable:
        return missing("Nothing to show", "No episode could be read: see the findings.")
    what = "Episodes come from exumi record, or from exumi convert."
    return missing("The dataset is empty", f"It holds no episode yet. {what}")


def _counts(title: str, what: str, counts: dict[str, int]) -> Html | None:
    """Draw the counts; None where there is nothing to tell apart."""
    said = {name: count for name, count in counts.items() if name}
    if not said or len(counts) < 2:
        return None
    count = max(said.values())
    if len(said) == 1:
        takeaway = f"One {what}, in {counted(count, 'episode')}."
    elif count == min(said.values()):
        takeaway = f"{len(said):,} {what}s, {counted(count, 'episode')} of each."
    else:
        share = percent(count / sum(counts.values()))
        takeaway = f"{len(said):,} {what}s; the most frequent makes up {share} of the episodes."
    return card(title, takeaway, count_bars(title, counts))


def _lengths(durations: list[float]) -> Html:
    low, high = min(durations), max(durations)
    title = "Length of episodes"
    if high - low < 1e-9:
        bins = [(low - 0.5, low + 0.5, float(len(durations)))]
    else:
        step = (high - low) / _BINS
        counts = [0] * _BINS
        for value in durations:
            counts[min(int((value - low) / step), _BINS - 1)] += 1
        bins = [(low + n * step, low + (n + 1) * step, float(c)) for n, c in enumerate(counts)]
    middle = quantiles(durations, n=4, method="inclusive")
    ends = f"the shortest {time_text(low)}, the longest {time_text(high)}."
    takeaway = f"Half of them last {time_text(middle[0])} to {time_text(middle[2])}; {ends}"
    if time_text(middle[0]) == time_text(middle[2]):
        takeaway = f"Half of them or more last {time_text(middle[1])}; {ends}"
    if high - low < 1e-9:
        takeaway = f"All episodes last {time_text(low)}."
    chart = histogram(
        title, takeaway, bins, x_title="length (s)", y_title="episodes",
        mark=(middle[1], f"median {time_text(middle[1])}"),
    )  # fmt: skip
    return card(title, takeaway, chart)


def _by_group(material: Material) -> Html:
    what = material.grouped_by
    groups: dict[str, list[float]] = {}
    for row in material.totals.rows:
        groups.setdefault(_group_of(row, what), []).append(row.duration_s)
    shown, others, _ = top({name: len(times) for name, times in groups.items()}, _GROUPS)
    rows = [_range_row(name, groups[name]) for name, _ in shown]
    if others:
        names = {name for name, _ in shown}
        rest = [t for name, times in groups.items() if name and name not in names for t in times]
        rows.append(_range_row(f"{others:,} more", rest))
    if "" in groups:
        rows.append(_range_row("not said", groups[""]))
    longest = max(rows, key=lambda row: row.median)
    least = min(row.median for row in rows)
    title = f"Length by {what}"
    if least > 0.95 * longest.median:
        takeaway = f"All {what}s have episodes of about the same length."
    else:
        takeaway = f"Longest in the median: {longest.name[:40]}, {time_text(longest.median)}."
    words = "; ".join(f"{row.name[:40]} median {time_text(row.median)}" for row in rows)
    chart = range_chart(title, f"{words}.", rows, x_title="length (s)")
    note = "Line: shortest to longest. Thick: the middle half. Dot: median. Right: time in all."
    return card(title, takeaway, chart, note=note)


def _group_of(row: EpisodeRow, what: str) -> str:
    return {"task": row.task, "object": row.object_id, "part": row.part_id}[what] or ""


def _range_row(name: str, values: list[float]) -> RangeRow:
    low, middle, high = (
        quantiles(values, n=4, method="inclusive") if len(values) > 1 else values * 3
    )
    return RangeRow(name, min(values), low, middle, high, max(values), time_text(sum(values)))
