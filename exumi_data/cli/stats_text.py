"""Statistics as text for people."""

from typing import TYPE_CHECKING

from exumi_data.cli.output import plain, plain_table, print_table, size_text, time_text
from exumi_data.stats.model import Range, Statistics, StreamStatistics
from exumi_data.wording import counted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

__all__ = ["print_statistics"]

_STREAM_COLUMNS = (
    "stream",
    "kind",
    "stored",
    "episodes",
    "samples",
    "rate",
    "jitter",
    "gaps",
    "active",
    "valid",
    "size",
    "each",
)
_WIDE = 118
_MOST_VALUES = 6
_UNREADABLE_SHOWN = 10


def print_statistics(statistics: Statistics, console: "Console") -> None:
    """Print statistics.

    Parameters
    ----------
    statistics : Statistics
    console : rich.console.Console
    """
    _headline(statistics, console)
    if statistics.streams:
        print_table(_streams(statistics, console), console)
        _notes_on_streams(statistics, console)
    _shares(statistics, console)
    if statistics.labels:
        print_table(_labels(statistics), console)
        console.print()
    _content(statistics, console)
    _unreadable(statistics, console)


def _headline(statistics: Statistics, console: "Console") -> None:
    size = size_text(statistics.sizes.bytes)
    duration = time_text(statistics.duration_s)
    if statistics.what == "episode":
        console.print(f"[bold]Episode {plain(statistics.name)}[/]: {duration}, {size}")
    else:
        count = counted(statistics.episodes, "episode")
        console.print(f"[bold]Dataset {plain(statistics.name)}[/]: {count}, {duration}, {size}")
    console.print()


def _streams(statistics: Statistics, console: "Console") -> "Table":
    hidden = set() if console.width >= _WIDE else {"kind", "stored", "jitter", "size"}
    if statistics.what == "episode" or console.width < _WIDE:
        hidden.add("episodes")
    titles = [title for title in _STREAM_COLUMNS if title not in hidden]
    left = ("stream", "kind", "stored")
    table = plain_table(*((title, "left" if title in left else "right") for title in titles))
    for stream in statistics.streams:
        cells = _stream_cells(stream)
        table.add_row(*(cells[title] for title in titles))
    return table


def _stream_cells(stream: StreamStatistics) -> dict[str, str]:
    """Return what each of `_STREAM_COLUMNS` says about a stream."""
    each = stream.bytes_per_sample
    return {
        "stream": f"[bold]{stream.name}[/]",
        "kind": stream.kind,
        "stored": "+".join(stream.encodings) or "array",
        "episodes": f"{stream.episodes:,}",
        "samples": f"{stream.n:,}",
        "rate": _rate(stream),
        "jitter": _jitter(stream),
        "gaps": _gaps(stream),
        "active": _percent(_share(stream.active, stream.measured_activity)),
        "valid": _percent(stream.usable),
        "size": size_text(stream.bytes),
        "each": "" if each is None else size_text(each),
    }


def _rate(stream: StreamStatistics) -> str:
    rate = stream.rate_hz
    if rate is None:
        return "[dim]-[/]"
    text = _span(rate)
    return f"{text} Hz" if stream.measured_times else f"{text} Hz*"


def _jitter(stream: StreamStatistics) -> str:
    if stream.jitter_s is None or not stream.measured_times:
        return "[dim]-[/]"
    return time_text(stream.jitter_s.median)


def _gaps(stream: StreamStatistics) -> str:
    if not stream.gaps:
        return "0"
    return f"{stream.gaps:,} (≤ {time_text(stream.longest_gap_s)})"


def _span(values: Range) -> str:
    """Write the median, or both ends where they are further apart than 2 %."""
    if values.max <= 1.02 * values.min:
        return f"{values.median:.4g}"
    return f"{values.min:.4g} to {values.max:.4g}"


def _notes_on_streams(statistics: Statistics, console: "Console") -> None:
    streams = statistics.streams
    lines = []
    if any(not stream.measured_times for stream in streams):
        lines.append("* stated by the source, not measured: it gives no timestamps")
    for stream in streams:
        stated = _off_nominal(stream)
        if stated:
            lines.append(stated)
        if stream.empty:
            lines.append(f"{stream.name}: no sample in {counted(stream.empty, 'episode')}")
        if stream.declared_gaps:
            lines.append(f"{stream.name}: {counted(stream.declared_gaps, 'declared gap')}")
        if stream.lost:
            causes = ", ".join(f"{count} {cause}" for cause, count in stream.lost.items())
            lines.append(f"{stream.name}: lost, as the recorder counted: {causes}")
    for line in lines:
        console.print(line, style="dim", markup=False)
    console.print()


def _off_nominal(stream: StreamStatistics) -> str | None:
    """Say so if what was measured is more than 2 % away from what the maker states."""
    if not stream.measured_times or stream.rate_hz is None or len(stream.nominal_hz) != 1:
        return None
    stated = next(iter(stream.nominal_hz))
    numerator, _, denominator = stated.partition("/")
    nominal = int(numerator) / int(denominator or 1)
    off = stream.rate_hz.median / nominal - 1
    if abs(off) <= 0.02:
        return None
    return f"{stream.name}: {off:+.1%} from its nominal {stated} Hz"


def _share(part: int | None, whole: int) -> float | None:
    return None if part is None or not whole else part / whole


def _percent(share: float | None) -> str:
    return "[dim]-[/]" if share is None else f"{share:.1%}"


def _shares(statistics: Statistics, console: "Console") -> None:
    table = plain_table(("", "left"), ("", "right"), ("", "left"), header=False)
    active, usable = statistics.active, statistics.usable
    note = f"{active.active:,} of {active.frames:,} moments, any tactile stream"
    if active.unmeasured:
        note += f"; {counted(active.unmeasured, 'episode')} without stored activity left out"
    if active.episodes or active.unmeasured:
        table.add_row("[bold]active tactile[/]", _percent(active.ratio), note)
    required = "all streams" if usable.required is None else ", ".join(usable.required)
    note = (
        f"{usable.usable:,} of {usable.ticks:,} ticks of {usable.tick_s * 1e3:.4g} ms, {required}"
    )
    if usable.without:
        note += f"; {counted(usable.without, 'episode')} without a required stream"
    table.add_row("[bold]usable[/]", _percent(usable.ratio), note)
    for regime, item in statistics.regimes.items():
        rate = "[dim]-[/]" if item.per_hour is None else f"{item.per_hour:,.0f}"
        what = "clips" if regime == "touch" else f"{regime} episodes"
        seconds = time_text(item.duration_s)
        table.add_row("[bold]per hour[/]", rate, f"{what} in an hour of recording ({seconds})")
    print_table(table, console)
    console.print()


def _labels(statistics: Statistics) -> "Table":
    table = plain_table(
        ("label", "left"), ("episodes", "right"), ("missing", "right"), ("values", "left")
    )
    for item in statistics.labels:
        parts = []
        if item.numbers is not None:
            numbers = item.numbers
            parts.append(f"{numbers.min:g} to {numbers.max:g}, median {numbers.median:g}")
            parts += [f"scale {low:g}-{high:g}" for low, high in item.scales]
        if item.words:
            parts.append(_most_frequent(item.words))
        parts += [f"by {who}" for who in item.provenance]
        values = plain("; ".join(parts))
        table.add_row(
            f"[bold]{plain(item.property)}[/]", f"{item.episodes:,}", f"{item.missing:,}", values
        )
    return table


def _most_frequent(counts: dict[str, int]) -> str:
    shown = list(counts.items())[:_MOST_VALUES]
    text = ", ".join(f"{value or '(not said)'} ({count:,})" for value, count in shown)
    rest = len(counts) - len(shown)
    return f"{text}, and {rest:,} more" if rest else text


def _content(statistics: Statistics, console: "Console") -> None:
    content = statistics.content
    rows = {
        "tasks": content.tasks,
        "objects": content.objects,
        "parts": content.parts,
        "procedures": content.procedures,
        "pad types": content.pad_types,
        "success": content.success,
        "licences": content.licences,
        "sources": content.sources,
        "lossy steps": content.lossy_steps,
        "quality": content.quality,
    }
    table = plain_table(("content", "left"), ("values", "right"), ("episodes of each", "left"))
    for name, counts in rows.items():
        said = {value: count for value, count in counts.items() if value}
        if said:
            values = plain(_most_frequent(counts))
            table.add_row(f"[bold]{name}[/]", f"{len(said):,}", values)
    if table.row_count:
        print_table(table, console)


def _unreadable(statistics: Statistics, console: "Console") -> None:
    if not statistics.unreadable:
        return
    console.print()
    count = counted(len(statistics.unreadable), "episode")
    console.print(f"[bold red]{count} could not be read[/] and are in none of these numbers:")
    for item in statistics.unreadable[:_UNREADABLE_SHOWN]:
        console.print(f"  {item.reason}", markup=False, soft_wrap=True)
    if len(statistics.unreadable) > _UNREADABLE_SHOWN:
        console.print(f"  and {len(statistics.unreadable) - _UNREADABLE_SHOWN} more")
