"""Section: rates, jitter, gaps, and how streams were brought onto one clock."""

from statistics import median

from exumi_data.stats.html.charts import RangeRow, range_chart
from exumi_data.stats.html.figures import ClockFigures
from exumi_data.stats.html.layout import card, cards, missing, section, table
from exumi_data.stats.html.markup import Content, Html, shortened
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.remarks import off_nominal
from exumi_data.stats.html.words import counted, named, percent
from exumi_data.stats.model import Range, StreamStatistics
from exumi_data.time import parse_rate
from exumi_data.wording import size_text, time_text

__all__ = ["timing"]

_MOST = 16
_WIDE = 5
_COLUMNS = ("stream", "kind", "stored", "samples", "rate", "jitter", "gaps", "valid", "size")


def timing(material: Material) -> Html:
    """Write the section.

    Parameters
    ----------
    material : Material
    """
    streams = material.statistics.streams
    lead = "How often and how regularly each stream was sampled, and how well streams are in step."
    if not streams:
        return section("timing", "Time", "", cards(missing("Rates", "There is no stream.")))
    shown = streams[:_MOST]
    rows = [_row(stream) for stream in shown]
    parts: list[Content] = [table("Streams and their sampling", _COLUMNS, rows, left=3)]
    if len(streams) > _MOST:
        rest = named([stream.name for stream in streams[_MOST:]], 12)
        parts.append(missing(f"{len(streams) - _MOST:,} more streams", rest))
    details, latencies = _clocks(material)
    parts += [cards(_rates(shown), _jitter(shown), latencies), details]
    return section("timing", "Time", lead, *parts)


def _row(stream: StreamStatistics) -> list[Content]:
    rate = None if stream.rate_hz is None else f"{_span(stream.rate_hz)} Hz"
    if rate and not stream.measured_times:
        rate += " (stated)"
    jitter = stream.jitter_s if stream.measured_times else None
    gaps = f"{stream.gaps:,} (≤ {time_text(stream.longest_gap_s)})" if stream.gaps else "0"
    return [
        shortened(stream.name, 40),
        shortened(stream.kind, 40),
        "+".join(stream.encodings) or "array",
        f"{stream.n:,}",
        rate,
        time_text(jitter.median) if jitter else None,
        gaps,
        percent(stream.usable) if stream.usable is not None else None,
        size_text(stream.bytes),
    ]


def _span(values: Range) -> str:
    if values.max <= 1.02 * values.min:
        return f"{values.median:.4g}"
    return f"{values.min:.4g} to {values.max:.4g}"


def _rates(streams: list[StreamStatistics]) -> Html:
    title = "Rates"
    rows = []
    for stream in streams:
        if stream.rate_hz is not None and stream.rate_hz.min > 0:
            wanted = next(iter(stream.nominal_hz)) if len(stream.nominal_hz) == 1 else None
            nominal = float(parse_rate(wanted)) if wanted else None
            note = f"{stream.rate_hz.median:.4g} Hz"
            rows.append(_range_row(stream.name, stream.rate_hz, note, nominal))
    if not rows:
        return missing(title, "No stream has two samples.")
    measured = [stream for stream in streams if stream.measured_times]
    if not measured:
        takeaway = "No rate was measured: all are what the source states."
    else:
        offs = {s.name: off for s in measured if (off := off_nominal(s)) is not None}
        far = max(offs, key=lambda name: abs(offs[name]), default=None)
        takeaway = f"Measured on {counted(len(measured), 'stream')} of {len(streams)}"
        if far is not None:
            share = f"{abs(offs[far]) * 100:.1f} %"
            takeaway += f"; {far} is furthest from its nominal rate, {share} off"
        takeaway += "."
    words = "; ".join(f"{row.name} {row.note}" for row in rows)
    wide = max(row.high for row in rows) > _WIDE * min(row.low for row in rows)
    x_title = "rate (Hz), logarithmic" if wide else "rate (Hz)"
    chart = range_chart(title, f"{words}.", rows, x_title=x_title, log=wide)
    note = "Line: slowest to fastest episode. Dot: median. Upright mark: nominal rate."
    return card(title, takeaway, chart, note=note)


def _range_row(name: str, values: Range, note: str, wanted: float | None = None) -> RangeRow:
    middle = values.median
    return RangeRow(name, values.min, middle, middle, middle, values.max, note, wanted)


def _jitter(streams: list[StreamStatistics]) -> Html:
    title = "Jitter"
    rows = []
    for stream in streams:
        if stream.measured_times and stream.jitter_s is not None:
            in_ms = Range(*(1e3 * v for v in _three(stream.jitter_s)))
            rows.append(_range_row(stream.name, in_ms, time_text(stream.jitter_s.median)))
    if not rows:
        why = "No stream has measured times: nominal times have no jitter to show."
        return missing(title, why)
    worst = max(rows, key=lambda row: row.median)
    takeaway = f"The periods of {worst.name} scatter most: by {worst.note} (one sigma)."
    if not worst.median:
        takeaway = "In the median, the periods of no stream scatter."
    words = "; ".join(f"{row.name} {row.note}" for row in rows)
    chart = range_chart(title, f"{words}.", rows, x_title="scatter of periods (ms)")
    return card(title, takeaway, chart, note="Line: calmest to worst episode. Dot: median.")


def _three(values: Range) -> tuple[float, float, float]:
    return values.min, values.median, values.max


def _clocks(material: Material) -> tuple[Html | None, Html]:
    title = "Latency taken out, and how sure it is"
    clocks = material.totals.clocks
    measured = {
        stream.name: [one for one in clocks[stream.name] if one.stamp_point != "nominal_rate"]
        for stream in material.statistics.streams
        if stream.name in clocks
    }
    measured = {name: found for name, found in measured.items() if found}
    if not measured:
        why = "Not known: no stream has measured times, so nothing says how far they are apart."
        return None, missing(title, why)
    rows = [
        _clock_row(name, found)
        for name, found in list(measured.items())[:_MOST]
        if _is_estimated(found)
    ]
    stated = [name for name, found in measured.items() if _sigma(found) is not None]
    if not rows:
        takeaway = "No latency was estimated for any stream."
        chart = None
    else:
        worst = max(stated, key=lambda name: _sigma(measured[name]) or 0, default=None)
        takeaway = "No stream states how sure its latency is."
        if worst is not None:
            sigma = _sigma(measured[worst]) or 0.0
            takeaway = f"Least sure: {worst}, ± {_ms(sigma)} (one sigma)."
            if sigma == 0:
                takeaway = "Stated as exact: sigma is 0."
        unknown = len(measured) - len(rows)
        if unknown:
            takeaway += f" For {counted(unknown, 'stream')} none was estimated."
        words = "; ".join(f"{row.name} {row.note}" for row in rows)
        chart = range_chart(title, f"{words}.", rows, x_title="latency (ms)")
    note = "Dot: median of the episodes. Thick: ± one sigma. Line: smallest to largest."
    columns = ("stream", "stamped", "latency", "offset σ", "drift")
    lines = [_clock_cells(name, found) for name, found in list(measured.items())[:_MOST]]
    details = table("Clocks of the streams", columns, lines, left=2)
    how = f"{_methods(measured)} {note}" if rows else None
    return details, card(title, takeaway, chart, note=how)


def _sigma(found: list[ClockFigures]) -> float | None:
    sigmas = [one.latency_sigma_ns for one in found if one.latency_sigma_ns is not None]
    return median(sigmas) if sigmas else None


def _ms(nanoseconds: float) -> str:
    return f"{nanoseconds * 1e-6:.3g} ms"


def _is_estimated(found: list[ClockFigures]) -> bool:
    return any(one.latency_ns or one.latency_sigma_ns is not None for one in found)


def _latency(found: list[ClockFigures]) -> str:
    sigma = _sigma(found)
    if not _is_estimated(found):
        return "not estimated"
    sure = "" if sigma is None else f" ± {sigma * 1e-6:.2g}"
    return f"{median(one.latency_ns for one in found) * 1e-6:.3g}{sure} ms"


def _clock_row(name: str, found: list[ClockFigures]) -> RangeRow:
    values = [one.latency_ns * 1e-6 for one in found]
    sigma = (_sigma(found) or 0.0) * 1e-6
    middle = median(values)
    low, high = middle - sigma, middle + sigma
    ends = min(low, *values), max(high, *values)
    return RangeRow(name, ends[0], low, middle, high, ends[1], _latency(found))


def _clock_cells(name: str, found: list[ClockFigures]) -> list[Content]:
    offsets = [one.offset_sigma_ns for one in found if one.offset_sigma_ns is not None]
    drift = median(one.drift_ppm for one in found)
    return [
        shortened(name, 40),
        named(sorted({f"{one.stamp_point}, {one.source}" for one in found}), 2),
        _latency(found),
        _ms(median(offsets)) if offsets else None,
        f"{drift:+.3g} ppm" if drift else "0",
    ]


def _methods(measured: dict[str, list[ClockFigures]]) -> str:
    methods = {one.method for found in measured.values() for one in found if one.method}
    if not methods:
        return "How latencies were estimated is not stated."
    # What follows the colon is about one episode.
    names = sorted({method.partition(":")[0] for method in methods})
    return f"By: {named(names, 3, 60)}."
