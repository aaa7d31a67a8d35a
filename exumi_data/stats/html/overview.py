"""The top of the page: what it is, how much, how good, what is wrong."""

from collections.abc import Iterator

from exumi_data.stats.html.judgement import Judgement
from exumi_data.stats.html.markup import Content, Html, element, join, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.remarks import Remark, remarks
from exumi_data.stats.html.words import REGIMES, counted, listed, named, percent
from exumi_data.wording import size_text, time_text

__all__ = ["overview", "summary"]

_SHOWN = 8
_SIGNS = {"good": "✓", "warn": "!", "bad": "✕", "note": "i", "none": "?"}
_KINDS = {
    "tactile": "tactile images",
    "rgb": "camera images",
    "pose": "pose",
    "width": "gripper width",
    "wrench": "force",
    "taxels": "taxels",
    "audio": "sound",
}
"""Kinds of streams in the order in which they are listed, as people call them."""


def overview(material: Material) -> Html:
    """Write the top of the page.

    Parameters
    ----------
    material : Material
    """
    grade, words, detail = _verdict(material)
    sign = element("span", _SIGNS[grade], class_="sign", aria_hidden="true")
    head = element("div", element("strong", words), element("span", detail), class_="words")
    verdict = element("div", sign, head, class_=f"verdict {grade}", role="status", id="verdict")
    return element(
        "section",
        element("h2", "Verdict and overview", class_="unseen", id="overview-title"),
        verdict,
        _tiles(material),
        element("div", _holdings(material), _known(remarks(material)), class_="split"),
        id="overview",
        aria_labelledby="overview-title",
    )


def summary(material: Material) -> str:
    """Say in a sentence what the data is.

    Parameters
    ----------
    material : Material
    """
    statistics, totals = material.statistics, material.totals
    if statistics.what == "episode":
        regime = next(iter(statistics.regimes), "")
        what = f"One {REGIMES.get(regime, 'episode')}"
    else:
        parts = [
            counted(regime.episodes, REGIMES.get(name, f"{name} episode"))
            for name, regime in statistics.regimes.items()
        ]
        if not parts:
            return "No episodes."
        what = listed(parts)
    of = [
        counted(len(said), name)
        for name, counts in (
            ("object", statistics.content.objects),
            ("part", statistics.content.parts),
        )
        if (said := [value for value in counts if value])
    ]
    touched = f" of {listed(of)}" if of else ""
    kinds = [name for kind, name in _KINDS.items() if totals.holding[kind]]
    holding = f", with {listed(kinds)}" if kinds else ", without any stream"
    return f"{what}{touched}, {time_text(statistics.duration_s)}{holding}."


def _verdict(material: Material) -> tuple[str, str, str]:
    judgement = material.judgement
    if judgement is None:
        return "none", "Not checked", "No validation was asked for: this page counts and shows."
    errors, warnings = judgement.count("error"), judgement.count("warning")
    standard = f"exUMI {judgement.standard}"
    looked = _coverage(judgement)
    if errors:
        return "bad", f"Not valid: {counted(errors, 'error')}", f"against {standard}. {looked}"
    if judgement.unchecked:
        what = counted(sum(item.count for item in judgement.unchecked), "thing")
        return "warn", f"Not fully checked: {what} could not be", f"by {standard}. {looked}"
    if material.statistics.unreadable or material.pictures.damaged:
        return "bad", "Valid, but not readable as a whole", f"by {standard}. {looked}"
    if warnings:
        return "warn", f"Valid, with {counted(warnings, 'warning')}", f"by {standard}. {looked}"
    return "good", "Valid", f"by {standard}, without a warning. {looked}"


def _coverage(judgement: Judgement) -> str:
    what = f"{judgement.rules:,} rules judged over {counted(judgement.episodes, 'episode')}"
    if "data" in judgement.levels:
        return f"{what}, {judgement.samples:,} samples and {judgement.frames:,} frames."
    return f"{what}, up to level {judgement.levels[-1]}: what frames show was not judged."


def _tiles(material: Material) -> Html:
    return element("dl", *_figures(material), class_="tiles")


def _figures(material: Material) -> Iterator[Html]:
    statistics = material.statistics
    each = statistics.episode_duration_s
    if statistics.what == "dataset":
        tasks = named([name for name in statistics.content.tasks if name], 2, 24)
        yield _tile("episodes", f"{statistics.episodes:,}", f"task: {tasks}" if tasks else "")
    span = f"median {time_text(each.median)} an episode" if each else ""
    yield _tile("recorded", time_text(statistics.duration_s) if each else "–", span)
    active = statistics.active
    if active.frames:
        note = f"of {active.frames:,} tactile moments"
        yield _tile("in contact", percent(active.ratio), note)
    else:
        yield _tile("in contact", "–", "no activity is stored")
    usable = statistics.usable
    required = "every stream" if usable.required is None else named(usable.required)
    yield _tile("usable time", percent(usable.ratio), f"{required} valid at once")
    labels = statistics.labels
    if labels:
        most = max(label.episodes for label in labels)
        whose = f"on up to {counted(most, 'episode')}"
        yield _tile("labelled properties", f"{len(labels):,}", whose)
    size = statistics.sizes.bytes
    per = size_text(size / statistics.episodes) if statistics.episodes else "0 B"
    yield _tile("on disk", size_text(size), f"{per} an episode")


def _tile(name: str, value: str, note: str) -> Html:
    return element(
        "div", element("dt", name), element("dd", value), element("dd", note or " ", class_="note")
    )


def _holdings(material: Material) -> Html:
    totals = material.totals
    episodes = len(totals.rows)
    rows: list[Html] = []
    extra = sorted(kind for kind in totals.kinds if kind not in _KINDS)
    there = [(kind, title) for kind, title in _KINDS.items() if kind in totals.kinds]
    for kind, title in [*there, *((kind, kind) for kind in extra[:6])]:
        rows.append(_holding(title, sorted(totals.kinds[kind]), kind, material))
    absent = [title for kind, title in _KINDS.items() if kind not in totals.kinds]
    if absent:
        sign = element("span", "–", class_="sign none", aria_hidden="true")
        rows.append(element("li", sign, f"missing: {', '.join(absent)}", class_="absent"))
    holds = "each episode holds" if episodes != 1 else "the episode holds"
    return element("div", element("h3", f"What {holds}"), element("ul", *rows, class_="holds"))


def _holding(title: str, streams: list[str], kind: str, material: Material) -> Html:
    totals = material.totals
    models = sorted({model for name in streams for model in totals.sensors.get(name, ())})
    by = f", {named(models, 2)}" if models else ""
    holding, episodes = totals.holding[kind], len(totals.rows)
    part = "" if holding == episodes else f", in {holding:,} of {counted(episodes, 'episode')}"
    words = element("span", f"{named(streams, 4, 32)}{by}{part}", class_="by")
    whole = holding == episodes
    sign = element("span", "✓" if whole else "◐", class_=f"sign {'good' if whole else 'note'}")
    return element("li", sign, element("b", title), " ", words)


def _known(found: list[Remark]) -> Html:
    items: list[Content] = [
        element(
            "li",
            element(
                "span", _SIGNS[remark.grade], class_=f"sign {remark.grade}", aria_hidden="true"
            ),
            element("a", shortened(remark.words, 260), href=f"#{remark.anchor}"),
        )
        for remark in found[:_SHOWN]
    ]
    if len(found) > _SHOWN:
        more = element("a", f"and {len(found) - _SHOWN:,} more", href="#findings")
        items.append(element("li", element("span", "…", class_="sign note"), more))
    if not found:
        items.append(element("li", element("span", "✓", class_="sign good"), "Nothing to remark."))
    return element(
        "div",
        element("h3", "What to know before use"),
        join(element("ul", *items, class_="remarks")),
    )
