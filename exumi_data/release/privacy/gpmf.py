"""What in GoPro's telemetry may be private: positions, and the ids of camera and lens.

What is taken out becomes a record ``FREE`` of the same length, which readers pass over; all else
stays where it is.
"""

import re
from collections.abc import Iterator

import numpy as np

from exumi_data.clips.gpmf import Record, records
from exumi_data.release.privacy.patches import Patch, printable

__all__ = ["gpmf_patches"]

_FREE = b"FREE"
_HEAD = 8
_DEEPEST = 8
_POSITIONS = frozenset((b"GPS5", b"GPS9", b"GPSA", b"GPRI", b"GLPI", b"BPOS"))
_FOR_SURE = re.compile(r"\bGPS\b|\blat(?:\.|itude)", re.IGNORECASE)
# What says how a stream is to be read, and nothing of where it was recorded.
_STRUCTURE = frozenset(b"STNM SIUN UNIT SCAL TYPE TSMP TICK TOCK EMPT STMP TIMO RMRK FREE".split())
_IDS = {
    b"CASN": "the camera's serial number",
    b"LINF": "the lens's serial number",
    b"CINF": "the camera's own id",
    b"MUID": "an id of camera and clip",
    b"GUMI": "an id of camera and clip",
}
_SECRET = 8


def gpmf_patches(payload: bytes, start: int) -> Iterator[Patch]:
    """Yield what in a payload may be private.

    Parameters
    ----------
    payload : bytes
        One sample of a telemetry track, or what a box ``GPMF`` holds.
    start : int
        Where it begins in the file.
    """
    yield from _device(memoryview(payload), start, 0)


def _device(data: memoryview, start: int, depth: int) -> Iterator[Patch]:
    for record in records(data):
        at = start + record.at
        if record.key in _IDS and any(record.content):
            content = bytes(record.content)
            secret = content.rstrip(b"\0")
            yield Patch(
                kind="serial",
                start=at,
                new=_freed(record),
                value=printable(content),
                why=_IDS[record.key],
                secret=secret if len(secret) >= _SECRET else b"",
            )
        elif record.kind == 0 and depth < _DEEPEST:
            if record.key == b"STRM":
                yield from _stream(record.content, at + _HEAD)
            yield from _device(record.content, at + _HEAD, depth + 1)


def _stream(data: memoryview, start: int) -> Iterator[Patch]:
    inner = list(records(data))
    if not _tells_where(inner):
        return
    told = [one for one in inner if one.key not in _STRUCTURE and one.kind]
    # Without a fix all positions are 0: nothing is told then.
    if not any(any(one.content) for one in told if one.key not in (b"GPSU", b"GPSF", b"GPSP")):
        return
    for one in told:
        yield Patch("gps", start + one.at, _freed(one), _position(one, inner), _why(one))


def _tells_where(inner: list[Record]) -> bool:
    if any(one.key in _POSITIONS for one in inner):
        return True
    name = next((bytes(one.content) for one in inner if one.key == b"STNM"), b"")
    return _FOR_SURE.search(name.decode("latin-1")) is not None


def _why(record: Record) -> str:
    key = record.key.decode("latin-1")
    return f"positions in the camera's telemetry ({key})"


def _position(record: Record, inner: list[Record]) -> str:
    """Return the first position as a person reads it, rounded to some kilometres."""
    scale = next((bytes(one.content) for one in inner if one.key == b"SCAL"), b"")
    if record.key not in (b"GPS5", b"GPS9") or len(scale) < 8 or len(record.content) < 8:
        return record.key.decode("latin-1")
    counts, divisor = np.frombuffer(bytes(record.content[:8]) + scale[:8], ">i4").reshape(2, 2)
    latitude, longitude = counts / np.maximum(divisor, 1)
    return f"{latitude:.1f}, {longitude:.1f}"


def _freed(record: Record) -> bytes:
    head = _FREE + bytes((record.kind, record.size)) + record.repeat.to_bytes(2, "big")
    return head + bytes(len(record.content))
