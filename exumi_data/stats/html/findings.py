"""Section: what the validator found, what it could not judge, what could not be read."""

from collections.abc import Sequence

from exumi_data.stats.html.judgement import Judgement, NotJudged
from exumi_data.stats.html.layout import card, cards, count_bars, missing, section, table
from exumi_data.stats.html.markup import Content, Html, element, join, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.words import counted, percent
from exumi_data.stats.model import Unreadable

__all__ = ["findings"]

_MOST = 40
_MOST_UNREADABLE = 20
_GRADES = {"error": "bad", "warning": "warn", "info": "note"}


def findings(material: Material) -> Html:
    """Write the section.

    Parameters
    ----------
    material : Material
    """
    judgement = material.judgement
    parts: list[Content] = []
    if judgement is None:
        lead = ""
        parts.append(cards(missing("Not validated", "No validation was asked for.")))
    else:
        numbers = [counted(judgement.count(s), s) for s in ("error", "warning")]
        notes = counted(judgement.count("info"), "note")
        lead = f"The validator found {numbers[0]}, {numbers[1]} and {notes}."
        parts += [_table(judgement), _not_judged(judgement)]
    lost = _unreadable(material)
    if lost:
        parts.append(_list("Could not be read", lost, material.statistics.path))
    quality = material.statistics.content.quality
    if quality:
        share = percent(max(quality.values()) / max(material.statistics.episodes, 1))
        takeaway = f"What the makers of episodes remarked; the most frequent on {share} of them."
        title = "Notes of the makers"
        parts.append(cards(card(title, takeaway, count_bars(title, quality))))
    return section("findings", "Findings", lead, *parts)


def _table(judgement: Judgement) -> Content:
    if not judgement.findings:
        return None
    rows: list[list[Content]] = [
        [
            element("span", found.severity, class_=f"chip {_GRADES[found.severity]}"),
            shortened(found.code, 24),
            join(
                shortened(found.message, 300),
                element("small", f"First at {shortened(found.place, 160)}", class_="place"),
                element("small", shortened(found.suggestion, 300), class_="place"),
            ),
            f"{found.count:,}",
        ]
        for found in judgement.findings[:_MOST]
    ]
    rest = len(judgement.findings) - _MOST
    more = element("p", f"{rest:,} more rules: see exumi validate.", class_="note")
    shown = table("Findings by rule", ("", "rule", "what was found", "times"), rows, left=3, wide=2)
    return join(shown, more if rest > 0 else None)


def _not_judged(judgement: Judgement) -> Content:
    items = [*judgement.unchecked, *_together(judgement.skipped)]
    if not items:
        return None
    lines = [element("li", _line(item)) for item in items[:_MOST]]
    if len(items) > _MOST:
        lines.append(element("li", f"and {len(items) - _MOST:,} more"))
    title = element("h3", "Not judged, for want of something to judge by")
    return element("div", title, element("ul", *lines, class_="plain"), class_="aside")


def _together(skipped: Sequence[NotJudged]) -> list[NotJudged]:
    """Put rules together that had the same reason equally often."""
    found: dict[tuple[str, int], list[str]] = {}
    for item in skipped:
        found.setdefault((item.reason, item.count), []).append(item.what)
    return [NotJudged(", ".join(codes), reason, count) for (reason, count), codes in found.items()]


def _line(item: NotJudged) -> Html:
    times = f" ({item.count:,} times)" if item.count > 1 else ""
    words = f" {shortened(item.reason, 160)}{times}"
    return join(element("b", shortened(item.what, 60)), words)


def _unreadable(material: Material) -> list[Unreadable]:
    everything = [
        *material.statistics.unreadable,
        *material.totals.unreadable,
        *material.pictures.damaged,
    ]
    by_path: dict[str, Unreadable] = {}
    for item in everything:
        by_path.setdefault(item.path, item)
    return [by_path[path] for path in sorted(by_path)]


def _list(title: str, items: list[Unreadable], root: str) -> Html:
    # The page is given away: it says nothing of the folders of the machine it was made on.
    lines = [
        element("li", shortened(item.reason.replace(f"{root}/", "").replace(root, "."), 400))
        for item in items[:_MOST_UNREADABLE]
    ]
    if len(items) > _MOST_UNREADABLE:
        lines.append(element("li", f"and {len(items) - _MOST_UNREADABLE:,} more"))
    return element(
        "div", element("h3", title), element("ul", *lines, class_="plain"), class_="aside bad"
    )
