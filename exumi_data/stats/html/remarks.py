"""What a stranger has to know: one sentence each, the grave ones first."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from exumi_data.model.episode import UNKNOWN_LICENCE
from exumi_data.stats.html.markup import shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.words import counted, listed, named, percent
from exumi_data.stats.model import StreamStatistics
from exumi_data.wording import time_text

__all__ = ["Grade", "Remark", "off_nominal", "remarks"]

Grade = Literal["bad", "warn", "note"]
_ORDER = ("bad", "warn", "note")
_GRADES: dict[str, Grade] = {"error": "bad", "warning": "warn", "info": "note"}
_FAR_OFF = 0.02
_MOST_USABLE = 0.95


@dataclass(frozen=True, slots=True)
class Remark:
    """A sentence, how grave it is, and the section that shows more."""

    grade: Grade
    words: str
    anchor: str


def remarks(material: Material) -> list[Remark]:
    """Say what is wrong, and what else a stranger should know.

    Parameters
    ----------
    material : Material

    Returns
    -------
    list of Remark
        The grave ones first.
    """
    found = [
        *_empty(material),
        *_unreadable(material),
        *_findings(material),
        *_licence(material),
        *_source(material),
        *_touch(material),
        *_streams(material),
        *_notes(material),
    ]
    return sorted(found, key=lambda remark: _ORDER.index(remark.grade))


def _empty(material: Material) -> Iterator[Remark]:
    if not material.statistics.episodes and not material.statistics.unreadable:
        yield Remark("warn", "The dataset is empty: it holds no episode.", "content")


def _unreadable(material: Material) -> Iterator[Remark]:
    lost = len(material.statistics.unreadable)
    if lost:
        yield Remark(
            "bad",
            f"{counted(lost, 'episode')} could not be read, and no number counts them.",
            "findings",
        )
    known = {item.path for item in material.statistics.unreadable}
    damaged = {item.path for item in material.pictures.damaged}
    damaged |= {item.path for item in material.totals.unreadable}
    if damaged - known:
        words = f"The data of {counted(len(damaged - known), 'episode')} could not be read in part."
        yield Remark("bad", words, "findings")


def _findings(material: Material) -> Iterator[Remark]:
    if material.judgement is None:
        return
    for found in material.judgement.findings:
        times = f", {found.count:,} times" if found.count > 1 else ""
        words = f"{shortened(found.message, 200)} ({found.code}{times})"
        yield Remark(_GRADES[found.severity], words, "findings")


def _licence(material: Material) -> Iterator[Remark]:
    content = material.statistics.content
    count = content.licences.get(UNKNOWN_LICENCE, 0)
    if count:
        whom = "" if count == material.statistics.episodes else f" of {counted(count, 'episode')}"
        words = (
            f"The licence{whom} is not stated: nobody may rely on being allowed to use the data."
        )
        yield Remark("warn", words, "origin")


def _source(material: Material) -> Iterator[Remark]:
    simulated = material.statistics.content.sources.get("simulated", 0)
    if simulated:
        which = "All" if simulated == material.statistics.episodes else f"{simulated:,}"
        yield Remark("note", f"{which} episodes are simulated: no sensor made them.", "origin")


def _touch(material: Material) -> Iterator[Remark]:
    rows = material.totals.rows
    never = sum(row.touched is False for row in rows)
    if never:
        words = f"{counted(never, 'episode')} without contact: no tactile frame is active."
        yield Remark("warn", words, "touch")
    unmeasured = material.statistics.active.unmeasured
    if unmeasured:
        words = f"Activity is not stored for {counted(unmeasured, 'episode')} with tactile streams."
        yield Remark("note", f"{words} exumi prepare derives it.", "touch")
    without = {name: n for name, n in material.totals.without_reference.items() if n}
    if without:
        most = max(without.values())
        words = f"{named(sorted(without))}: no reference image in up to {counted(most, 'episode')}"
        yield Remark("warn", f"{words}, so contact cannot be told from the frames.", "touch")


def off_nominal(stream: StreamStatistics) -> float | None:
    """Return how far a measured rate is from the stated one, as a share; None if not known.

    Parameters
    ----------
    stream : StreamStatistics
    """
    if not stream.measured_times or stream.rate_hz is None or len(stream.nominal_hz) != 1:
        return None
    numerator, _, denominator = next(iter(stream.nominal_hz)).partition("/")
    return stream.rate_hz.median / (int(numerator) / int(denominator or 1)) - 1


def _streams(material: Material) -> Iterator[Remark]:
    streams, usable = material.statistics.streams, material.statistics.usable
    if usable.ratio is not None and usable.ratio < _MOST_USABLE:
        covers = {stream.name: stream.usable for stream in streams if stream.usable is not None}
        least = min(covers, key=lambda name: covers[name])
        words = f"All streams together cover {percent(usable.ratio)} of the recorded time; "
        yield Remark("warn", f"{words}{least} alone {percent(covers[least])}.", "timing")
    for stream in streams:
        off = off_nominal(stream)
        if off is not None and abs(off) > _FAR_OFF:
            words = f"{stream.name} runs {off:+.1%} off its nominal rate."
            yield Remark("warn", words.replace("%", " %"), "timing")
        if stream.gaps:
            words = f"{stream.name} has {counted(stream.gaps, 'gap')}, the longest of "
            yield Remark("warn", f"{words}{time_text(stream.longest_gap_s)}.", "timing")
        if stream.lost:
            words = f"The recorder counted {sum(stream.lost.values()):,} lost samples of "
            yield Remark("warn", f"{words}{stream.name}.", "timing")
        if stream.empty:
            words = f"{stream.name} holds no sample in {counted(stream.empty, 'episode')}."
            yield Remark("warn", words, "timing")
    nominal = [stream.name for stream in streams if not stream.measured_times]
    if nominal:
        whose = "All times" if len(nominal) == len(streams) else f"The times of {named(nominal)}"
        words = f"{whose} are nominal: counted from a stated rate, not measured."
        yield Remark("note", words, "timing")


def _notes(material: Material) -> Iterator[Remark]:
    quality = material.statistics.content.quality
    if quality:
        codes = [f"{shortened(code, 40)} ({count:,})" for code, count in list(quality.items())[:5]]
        rest = len(quality) - len(codes)
        if rest > 0:
            codes.append(f"{rest:,} more")
        yield Remark("note", f"Episodes carry notes of their makers: {listed(codes)}.", "findings")
    lossy = material.statistics.content.lossy_steps
    if lossy:
        yield Remark("note", f"Lossy steps are on record: {named(lossy)}.", "origin")
    success = material.statistics.content.success
    regimes = material.statistics.regimes
    unmarked = success.get("", 0)
    if unmarked and "demonstration" in regimes:
        words = f"{counted(unmarked, 'episode')} without a mark of success or failure."
        yield Remark("note", words, "content")
