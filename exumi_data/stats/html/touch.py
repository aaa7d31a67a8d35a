"""Section: when, where and at what the fingers were touched."""

import math
from collections.abc import Sequence

import numpy as np

from exumi_data.stats.html.charts import Bar, bar_chart, line_chart
from exumi_data.stats.html.figures import STEPS
from exumi_data.stats.html.layout import card, cards, missing, section
from exumi_data.stats.html.looking import GRID
from exumi_data.stats.html.maps import finger_map, row_map
from exumi_data.stats.html.markup import Html
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.pictures import ContactMap
from exumi_data.stats.html.taxels import taxels
from exumi_data.stats.html.totals import TouchTotal
from exumi_data.stats.html.words import among_top, counted, parts_of_episodes, percent, top
from exumi_data.tactile import ACTIVITY_SIZE
from exumi_data.wording import time_text

__all__ = ["touch"]

_GROUPS = 10
_FINGERS = 6
_PIXELS = (ACTIVITY_SIZE // GRID) ** 2


def touch(material: Material) -> Html:
    """Write the section.

    Parameters
    ----------
    material : Material
    """
    totals = material.totals
    title, lead = "Touch", "When, at what and where the fingers feel something."
    cells = taxels(material)
    if not totals.holding["tactile"]:
        why = "No episode has a stream of kind tactile."
        absent = missing("No tactile images", why)
        return section("touch", title, lead if cells else "", cards(*cells, absent))
    charts: list[Html] = []
    everything = TouchTotal()
    for one in totals.touch.values():
        everything.frames += one.frames
        everything.active += one.active
    if everything.share is None:
        charts.append(
            missing("Contact over time", "Activity is not stored: exumi prepare derives it.")
        )
    else:
        charts.append(_over_time(material, everything))
        if len(_grouped(material)) > 1:
            charts += [_by_group(material), _groups_over_time(material)]
        if len(totals.touch) > 1:
            charts.append(_by_finger(totals.touch))
    maps = sorted(material.pictures.maps.items())
    charts += [_finger(name, found) for name, found in maps[:_FINGERS]]
    if len(maps) > _FINGERS:
        more = f"{len(maps) - _FINGERS:,} more tactile streams are not drawn."
        charts.append(missing("More fingers", more))
    if not maps:
        why = "No stream has a reference image, so contact cannot be told from the frames."
        charts.append(missing("Where it is touched", why))
    return section("touch", title, lead, cards(*charts, *cells))


def _shares(total: TouchTotal) -> list[float]:
    with np.errstate(invalid="ignore"):
        return [float(share) for share in total.active / total.frames]


def _x(material: Material) -> tuple[tuple[float, float], str]:
    return parts_of_episodes([row.duration_s for row in material.totals.rows])


def _over_time(material: Material, total: TouchTotal) -> Html:
    title = "Contact over time"
    x_range, x_title = _x(material)
    shares = _shares(total)
    known = [share for share in shares if not math.isnan(share)]
    begin, end = known[0], known[-1]
    peak = max(range(STEPS), key=lambda n: -1.0 if math.isnan(shares[n]) else shares[n])
    if len(material.totals.rows) == 1:
        when = f"at {time_text((peak + 0.5) / STEPS * x_range[1])}"
        takeaway = f"{percent(total.share)} of the tactile frames are in contact, most {when}."
    else:
        takeaway = (
            f"{percent(begin)} of frames are in contact at the start, {percent(shares[peak])} at "
            f"{100 * (peak + 0.5) / STEPS:.0f} % of the way, {percent(end)} at the end."
        )
    chart = line_chart(
        title,
        takeaway,
        shares,
        x_range=x_range,
        x_title=x_title,
        y_title="tactile frames in contact",
    )
    return card(title, takeaway, chart)


def _felt(material: Material) -> dict[str, TouchTotal]:
    """Return the activity of each group that has touch."""
    what = material.grouped_by
    return {name: one for (kind, name), one in material.totals.by_group.items() if kind == what}


def _episodes(material: Material) -> dict[str, int]:
    """Return how many episodes each group that has touch holds."""
    found = _felt(material)
    return {name: n for name, n in material.groups.items() if name in found}


def _grouped(material: Material) -> list[tuple[str, TouchTotal, bool]]:
    """Return groups with their activity: the largest by episodes, then the others as one."""
    found = _felt(material)
    shown, others, _ = top(_episodes(material), _GROUPS)
    rows = [(name, found[name], False) for name, _ in shown]
    if others:
        rest, names = TouchTotal(), {name for name, _ in shown}
        for name, one in found.items():
            if name not in names:
                rest.frames += one.frames
                rest.active += one.active
        rows.append((f"{others:,} more", rest, True))
    return rows


def _by_group(material: Material) -> Html:
    what = material.grouped_by
    title = f"Contact by {what}"
    rows = [(name, one.share, rest) for name, one, rest in _grouped(material)]
    bars = [
        Bar(name, share, percent(share), rest) for name, share, rest in rows if share is not None
    ]
    bars.sort(key=lambda bar: (bar.rest, -bar.value, bar.name))
    named = [bar for bar in bars if not bar.rest] or bars
    takeaway = (
        f"From {named[-1].note} ({named[-1].name[:40]}) to {named[0].note} ({named[0].name[:40]}) "
        f"of the tactile frames{among_top(_episodes(material), _GROUPS)}."
    )
    words = "; ".join(f"{bar.name[:60]} {bar.note}" for bar in bars)
    chart = bar_chart(title, f"{words}.", bars, unit="tactile frames in contact", most=1.0)
    return card(title, takeaway, chart)


def _groups_over_time(material: Material) -> Html:
    what = material.grouped_by
    title = f"Contact over time, by {what}"
    rows = [(name, _shares(one)) for name, one, _ in _grouped(material)]
    x_range, x_title = _x(material)
    takeaway = _onsets(rows)
    chart = row_map(
        title, takeaway, rows, x_range=x_range, x_title=x_title, legend="tactile frames in contact"
    )
    return card(title, takeaway, chart)


def _onsets(rows: Sequence[tuple[str, Sequence[float]]]) -> str:
    """Say from when on most frames are in contact, in the first row and in the last."""
    found = []
    for name, shares in rows:
        first = next((step for step, share in enumerate(shares) if share > 0.5), None)
        if first is not None:
            found.append((first, name))
    if not found:
        return "In no row are most frames in contact at the same time."
    early, late = min(found), max(found)
    words = f"Most frames are in contact from {100 * early[0] / STEPS:.0f} % of the way on"
    if early[0] != late[0]:
        words += f" ({early[1][:40]}), from {100 * late[0] / STEPS:.0f} % at the latest"
        words += f" ({late[1][:40]})"
    never = len(rows) - len(found)
    return f"{words}; in {counted(never, 'row')} never." if never else f"{words}."


def _by_finger(found: dict[str, TouchTotal]) -> Html:
    title = "Contact by finger"
    rows = [(name, one.share) for name, one in sorted(found.items()) if one.share is not None]
    bars = [Bar(name, share, percent(share)) for name, share in rows[: _GROUPS + 2]]
    apart = max(bar.value for bar in bars) - min(bar.value for bar in bars)
    takeaway = f"The streams differ by {apart * 100:.1f} percentage points."
    words = "; ".join(f"{bar.name} {bar.note}" for bar in bars)
    chart = bar_chart(title, f"{words}.", bars, unit="tactile frames in contact", most=1.0)
    return card(title, takeaway, chart)


def _finger(name: str, found: ContactMap) -> Html:
    title = f"Where {name} is touched"
    if not found.frames:
        return missing(title, "No frame that was looked at is in contact.")
    shares = found.counts / (found.frames * _PIXELS)
    row, column = (int(i) for i in np.unravel_index(int(shares.argmax()), shares.shape))
    covered = float((shares > 0.01).mean())
    takeaway = (
        f"Touched most {_place(row, column)} (in {percent(float(shares.max()))} of contact frames)"
        f"; {percent(covered)} of the image is touched in more than 1 %."
    )
    (height, width), _ = max(found.shapes.items(), key=lambda item: (item[1], item[0]))
    note = f"From {found.frames:,} frames in contact, as the sensor's image shows them."
    if len(found.shapes) > 1:
        note += f" Frames of {len(found.shapes):,} sizes were laid over each other."
    chart = finger_map(
        title, takeaway, shares, aspect=min(max(width / height, 0.4), 2.5),
        legend="contact frames in which the place is touched",
    )  # fmt: skip
    return card(title, takeaway, chart, note=note)


def _place(row: int, column: int) -> str:
    down = "at the top" if row < GRID / 3 else "at the bottom" if row >= GRID * 2 / 3 else ""
    across = "left" if column < GRID / 3 else "right" if column >= GRID * 2 / 3 else ""
    if down and across:
        return f"{down} {across}"
    return down or (f"on the {across}" if across else "in the middle")
