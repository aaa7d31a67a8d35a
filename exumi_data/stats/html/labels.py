"""Section: how labels are distributed."""

from exumi_data.stats.html.charts import histogram
from exumi_data.stats.html.layout import card, cards, count_bars, missing, section
from exumi_data.stats.html.markup import Html, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.words import counted, listed, named, percent
from exumi_data.stats.model import Labels

__all__ = ["labels"]

_MOST = 12
_BINS = 20


def labels(material: Material) -> Html:
    """Write the section.

    Parameters
    ----------
    material : Material
    """
    found = material.statistics.labels
    if not found:
        why = "No episode is labelled."
        return section("labels", "Labels", "", cards(missing("No labels", why)))
    order = sorted(found, key=lambda label: (-label.episodes, label.property))
    shown = [
        chart
        for label in order[:_MOST]
        for chart in _charts(label, material.totals.numbers.get(label.property, []))
    ]
    if len(order) > _MOST:
        rest = named([label.property for label in order[_MOST:]], 12)
        shown.append(missing(f"{len(order) - _MOST:,} more properties", rest))
    lead = "What people or models say about what was touched."
    return section("labels", "Labels", lead, cards(*shown))


def _charts(label: Labels, numbers: list[float]) -> list[Html]:
    name = shortened(label.property, 40)
    whole = label.episodes + label.missing
    by = listed(sorted(label.provenance))
    base = f"Given by {by} to {percent(label.episodes / whole)} of the episodes"
    charts = []
    if numbers:
        charts.append(_numbers(name, label, numbers, base))
    if label.words:
        said = {word: count for word, count in label.words.items() if word}
        first = shortened(next(iter(said), ""), 30)
        kinds = counted(len(said), "value")
        takeaway = f"{base}; {kinds}, most often {first}."
        charts.append(card(name, takeaway, count_bars(name, label.words, unit="times")))
    return charts


def _numbers(name: str, label: Labels, numbers: list[float], base: str) -> Html:
    low, high = min(numbers), max(numbers)
    on = ""
    if len(label.scales) == 1:
        scale = label.scales[0]
        low, high = min(low, scale[0]), max(high, scale[1])
        on = f", on a scale from {scale[0]:g} to {scale[1]:g}"
    if high <= low:
        low, high = low - 0.5, high + 0.5
    step = (high - low) / _BINS
    counts = [0] * _BINS
    for value in numbers:
        counts[min(int((value - low) / step), _BINS - 1)] += 1
    middle = label.numbers.median if label.numbers else low
    bins = [(low + n * step, low + (n + 1) * step, float(count)) for n, count in enumerate(counts)]
    takeaway = f"{base}{on}."
    chart = histogram(
        name, takeaway, bins, x_title=name, y_title="labels", mark=(middle, f"median {middle:g}")
    )
    return card(name, takeaway, chart)
