"""What a journal's header says of the machine and of each stream."""

from collections.abc import Mapping
from pathlib import Path

from exumi_data.model.description import CalibrationItem
from exumi_recorders.journal.header import KnownLatency, StreamHeader, port_document
from exumi_recorders.recording.device import RecordedStream

__all__ = ["LATENCY", "boot_id", "latency_of", "stream_header"]

LATENCY = "latency/"
"""A calibration item of this name and a stream's is its latency: value and uncertainty in ns."""
_MOST_LATENCY_NS = 60_000_000_000  # what is later is no latency, but a number in another unit


def boot_id() -> str:
    """Return what is another text after each start of the machine; ``unknown`` where none is."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return "unknown"


def latency_of(item: CalibrationItem) -> int | None:
    """Return the latency that a calibration item states, ns; None where it is none.

    Parameters
    ----------
    item : CalibrationItem
    """
    value = item.value
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return round(value) if abs(value) <= _MOST_LATENCY_NS else None


def stream_header(
    stream: RecordedStream, calibration: Mapping[str, CalibrationItem]
) -> StreamHeader:
    """Describe a stream, with its latency where the calibration knows it.

    Parameters
    ----------
    stream : RecordedStream
    calibration : mapping of str to CalibrationItem
    """
    item = calibration.get(f"{LATENCY}{stream.name}")
    document = port_document(stream.port)
    latency_ns = None if item is None else latency_of(item)
    if item is None or latency_ns is None:
        return StreamHeader(device=stream.device, port=document)
    latency = KnownLatency(
        latency_ns=latency_ns, latency_sigma_ns=item.uncertainty, method=item.method
    )
    return StreamHeader(device=stream.device, port=document, latency=latency)
