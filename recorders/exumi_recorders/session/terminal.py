"""What the operator sees: a table of all streams, the state, and what has to be mended.

Whatever the size of the terminal: what does not fit is left out, the least important first, so that
state and problems are always in sight.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from exumi_recorders.recording.status import DeviceStatus, StreamStatus
from exumi_recorders.session.keys import HELP
from exumi_recorders.session.messages import SessionStatus

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

__all__ = ["draw_status", "status_document"]

_SHOWN = ("magnet", "agc", "dialect", "from_headset_m", "world_frame")
_OLD_S = 0.5
_GAP = 2
_COLUMNS = ("stream", "Hz", "jitter ms", "age ms", "queue KB", "samples", "lost")
_BY_IMPORTANCE = ("stream", "Hz", "age ms", "lost", "jitter ms", "samples", "queue KB")
_MOST_LINES_OF_A_PROBLEM = 2


def draw_status(
    status: SessionStatus,
    *,
    sync: str,
    preview: str | None,
    keys: bool = True,
    width: int = 100,
    height: int | None = None,
) -> "Group":
    """Return the picture of a session for a terminal.

    Parameters
    ----------
    status : SessionStatus
    sync : str
        How old the latency calibration is, in words.
    preview : str, optional
        Where the preview is.
    keys : bool
        Say what the keys do.
    width : int
        Columns of the terminal.
    height : int, optional
        Lines that there are; as many as are needed where it is not said.
    """
    from rich.console import Group
    from rich.text import Text

    room = 10_000 if height is None else max(height - 1, 1)
    problems = [line for one in status.recording.problems for line in _problem(one, width)]
    problems = problems[: max(1, room // 2)]
    foot = f"disk {_minutes(status.disk_minutes)} · sync {sync}"
    below = [foot + (f" · {preview}" if preview else "")]
    below += _wrapped(_readings(status), width)
    below += _wrapped(HELP, width) if keys else []
    rows = [_row(stream) for stream in status.recording.streams]
    room -= 1 + len(problems)
    below = below[: max(0, room - len(rows) - 1)]
    room -= len(below) + 1
    parts: list[Any] = [_headline(status)]
    parts += [Text(line, style="bold yellow") for line in problems]
    if room > 0 and rows:
        parts.append(_table(rows[:room], width))
    parts += [Text(line, style="dim") for line in below]
    for part in parts:
        if isinstance(part, Text):
            part.no_wrap, part.overflow = True, "ellipsis"
    return Group(*parts)


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, max(width, 20))


def _problem(one: Any, width: int) -> list[str]:
    lines = _wrapped(f"! {one.where + ': ' if one.where else ''}{one.text}", width)
    if len(lines) > _MOST_LINES_OF_A_PROBLEM:
        lines = [*lines[: _MOST_LINES_OF_A_PROBLEM - 1], f"{lines[1]} ..."]
    return lines


def _table(rows: Sequence[Sequence[Any]], width: int) -> "Table":
    """Return a table with the columns that there is room for, a line a row."""
    from rich.table import Table

    needed = {
        title: max(len(title), *(len(row[at]) for row in rows)) + _GAP
        for at, title in enumerate(_COLUMNS)
    }
    shown: set[str] = set()
    for title in _BY_IMPORTANCE:
        if sum(needed[each] for each in shown | {title}) - _GAP <= width:
            shown.add(title)
    table = Table(box=None, pad_edge=False, padding=(0, _GAP, 0, 0), header_style="dim")
    for title in _COLUMNS:
        if title in shown:
            table.add_column(title, justify="left" if title == "stream" else "right", no_wrap=True)
    for row in rows:
        named = zip(_COLUMNS, row, strict=True)
        table.add_row(*(cell for title, cell in named if title in shown))
    return table


def _headline(status: SessionStatus) -> Any:
    from rich.text import Text

    text = Text()
    if status.state == "recording":
        text.append(" REC ", style="bold white on red")
        text.append(f" {status.recording.elapsed_s:6.1f} s  {status.recording.bytes / 1e6:,.0f} MB")
    elif status.state == "ended":
        text.append(" ending ", style="bold black on yellow")
    else:
        text.append(" waiting ", style="bold black on green")
    text.append(f"   {status.kept} kept, {status.discarded} discarded")
    if status.finishing:
        text.append(f", {status.finishing} being finished")
    if status.undecided:
        text.append(" · d discards the last one")
    if status.next_trial is not None:
        text.append(f" · trial {status.next_trial}")
    return text


def _row(stream: StreamStatus) -> list[Any]:
    from rich.text import Text

    lost = stream.dropped + sum(stream.lost.values())
    age = None if stream.age_s is None else Text(f"{stream.age_s * 1e3:.0f}")
    if age is not None and stream.age_s is not None and stream.age_s > _OLD_S:
        age.stylize("bold red")
    return [
        stream.name,
        "-" if stream.rate_hz is None else f"{stream.rate_hz:.1f}",
        "-" if stream.jitter_s is None else f"{stream.jitter_s * 1e3:.2f}",
        age or "-",
        f"{stream.queue_bytes / 1e3:.0f}",
        f"{stream.samples:,}",
        Text(f"{lost}", style="bold red") if lost else "0",
    ]


def _readings(status: SessionStatus) -> str:
    """Say what devices tell of themselves, and how wide grippers are."""
    widths = {
        stream.device: status.widths_m[stream.name]
        for stream in status.recording.streams
        if stream.name in status.widths_m
    }
    said = [_of_device(one, widths.get(one.name)) for one in status.recording.devices]
    return "   ".join(text for text in said if text)


def _of_device(device: DeviceStatus, width_m: float | None) -> str:
    if not device.connected:
        return f"{device.name}: not connected"
    shown = [f"{name} {device.readings[name]}" for name in _SHOWN if name in device.readings]
    shown += [] if width_m is None else [f"width {1e3 * width_m:.1f} mm"]
    return f"{device.name}: {', '.join(shown)}" if shown else ""


def _minutes(minutes: float) -> str:
    return f"{minutes:.0f} min" if minutes < 600 else f"{minutes / 60:.0f} h"


def status_document(status: SessionStatus, *, sync_age_s: float | None) -> dict[str, Any]:
    """Return a session's status as a JSON object.

    Parameters
    ----------
    status : SessionStatus
    sync_age_s : float, optional
        Age of the latency calibration.
    """
    recording = status.recording
    return {
        "type": "status",
        "state": status.state,
        "episode": recording.episode,
        "elapsed_s": round(recording.elapsed_s, 3),
        "bytes": recording.bytes,
        "kept": status.kept,
        "discarded": status.discarded,
        "finishing": status.finishing,
        "undecided": status.undecided,
        "next_trial": status.next_trial,
        "disk_minutes": round(status.disk_minutes, 1),
        "sync_age_s": None if sync_age_s is None else round(sync_age_s),
        "pressure": round(recording.pressure, 3),
        "streams": [
            _stream_document(stream, status.widths_m.get(stream.name))
            for stream in recording.streams
        ],
        "devices": [
            {"name": one.name, "connected": one.connected, "readings": _plain(one.readings)}
            for one in recording.devices
        ],
        "problems": [
            {"where": one.where, "code": one.code, "text": one.text} for one in recording.problems
        ],
    }


def _plain(readings: Mapping[str, Any]) -> dict[str, Any]:
    """Return readings as JSON has them: what a driver says wrongly must not end the stream."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in readings.items()
    }


def _stream_document(stream: StreamStatus, width_m: float | None) -> dict[str, Any]:
    width = {} if width_m is None else {"width_m": round(width_m, 5)}
    return {
        "name": stream.name,
        "device": stream.device,
        "kind": stream.kind,
        "rate_hz": _rounded(stream.rate_hz, 2),
        "jitter_s": _rounded(stream.jitter_s, 6),
        "age_s": _rounded(stream.age_s, 4),
        "samples": stream.samples,
        "dropped": stream.dropped,
        "lost": dict(stream.lost),
        "queue_bytes": stream.queue_bytes,
        "queue_age_s": round(stream.queue_age_s, 4),
        **width,
    }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
