"""What the operator sees: a table of all streams, the state, and what has to be mended."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from exumi_recorders.recording.status import DeviceStatus, StreamStatus
from exumi_recorders.session.keys import HELP
from exumi_recorders.session.messages import SessionStatus

if TYPE_CHECKING:
    from rich.console import Group

__all__ = ["draw_status", "status_document"]

_SHOWN = ("magnet", "agc", "dialect", "from_headset_m", "world_frame")
_OLD_S = 0.5


def draw_status(
    status: SessionStatus, *, sync: str, preview: str | None, keys: bool = True
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
    """
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for title in ("stream", "Hz", "jitter ms", "age ms", "queue KB", "samples", "lost"):
        table.add_column(title, justify="left" if title == "stream" else "right")
    for stream in status.recording.streams:
        table.add_row(*_row(stream))
    lines: list[Any] = [_headline(status), table]
    readings = [text for text in map(_readings, status.recording.devices) if text]
    if readings:
        lines.append(Text("   ".join(readings), style="dim"))
    lines += [
        Text(f"! {one.where + ': ' if one.where else ''}{one.text}", style="bold yellow")
        for one in status.recording.problems
    ]
    foot = f"disk {_minutes(status.disk_minutes)} · sync {sync}"
    if preview:
        foot += f" · {preview}"
    lines.append(Text(f"{foot}\n{HELP}" if keys else foot, style="dim"))
    return Group(*lines)


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


def _readings(device: DeviceStatus) -> str:
    if not device.connected:
        return f"{device.name}: not connected"
    shown = [f"{name} {device.readings[name]}" for name in _SHOWN if name in device.readings]
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
        "streams": [_stream_document(stream) for stream in recording.streams],
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


def _stream_document(stream: StreamStatus) -> dict[str, Any]:
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
    }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
