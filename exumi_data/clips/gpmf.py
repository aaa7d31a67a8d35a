"""The telemetry of GoPro's cameras: key, length, value, nested; of it, the gyroscope.

A payload of about a second holds devices, a device holds streams, and a stream its settings and
samples. Only what leads to the gyroscope is read; lengths that do not fit end the reading there.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["MAX_PAYLOAD_BYTES", "GyroTrack", "Payload", "Record", "read_gyro", "records"]

MAX_PAYLOAD_BYTES = 4 << 20
"""Size of the largest payload that is read: a camera's are some kilobytes."""

_HEAD = struct.Struct(">4sBBH")
_MOST_RECORDS = 20_000
_NUMBERS = {
    ord("b"): ">i1",
    ord("B"): ">u1",
    ord("s"): ">i2",
    ord("S"): ">u2",
    ord("l"): ">i4",
    ord("L"): ">u4",
    ord("f"): ">f4",
    ord("d"): ">f8",
    ord("j"): ">i8",
    ord("J"): ">u8",
}
# Beyond what any camera has; 2000 degrees a second are 35 rad/s.
_FASTEST_RAD_PER_S = 100.0
_RATES_HZ = (20.0, 8000.0)


@dataclass(frozen=True, slots=True)
class Payload:
    """One sample of the telemetry track.

    Attributes
    ----------
    start_s, duration_s : float
        When it begins on the container's clock, and how long it is.
    data : bytes
    """

    start_s: float
    duration_s: float
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class GyroTrack:
    """What the gyroscope measured.

    Attributes
    ----------
    time_s : (N,) float64
        On the container's clock, strictly increasing.
    rad_per_s : (N, 3) float64
        Angular velocity about the camera's axes, in the camera's own order of them.
    sigma_s : float
        How well the payloads' times say when all samples were taken, together; seconds.
    device : str
        The camera's name, as it says itself; may be empty.
    problem : str or None
        What is missing or wrong in the track.
    """

    time_s: NDArray[np.float64]
    rad_per_s: NDArray[np.float64]
    sigma_s: float
    device: str = ""
    problem: str | None = None

    def between(self, start_s: float, stop_s: float) -> "GyroTrack | None":
        """Return the part from one time to another; None where there is none.

        Parameters
        ----------
        start_s, stop_s : float
        """
        first, last = np.searchsorted(self.time_s, [start_s, stop_s])
        if last - first < 2:
            return None
        return replace(self, time_s=self.time_s[first:last], rad_per_s=self.rad_per_s[first:last])


class Record(NamedTuple):
    """One record: its key, its numbers' type, and what it holds.

    Attributes
    ----------
    key : bytes
        Four letters.
    kind : int
        Code of the type; 0 where it holds records.
    size, repeat : int
        Bytes of a sample, and samples.
    content : memoryview
    at : int
        Where the key begins, bytes.
    """

    key: bytes
    kind: int
    size: int
    repeat: int
    content: memoryview
    at: int


class _Part(NamedTuple):
    """What one payload has of the gyroscope."""

    values: NDArray[np.float64]
    total: int | None
    device: str


def read_gyro(payloads: Sequence[Payload]) -> GyroTrack | None:
    """Read the gyroscope of a clip.

    The camera does not say when each sample was taken. Its clock is even, so the times are those
    of a line through the payloads' beginnings, by the number of samples before each of them.

    Parameters
    ----------
    payloads : sequence of Payload
        In order.

    Returns
    -------
    GyroTrack or None
        None where there is no gyroscope in them, or nothing to time it by.
    """
    parts: list[_Part] = []
    places: list[tuple[float, float, int]] = []  # start, duration, samples before
    damaged, before = 0, 0
    for payload in payloads:
        part = _gyro_of(memoryview(payload.data)[:MAX_PAYLOAD_BYTES])
        if part is None:
            damaged += 1
            continue
        count = len(part.values)
        first = before if part.total is None else part.total - count
        first = max(first, before)  # a count that goes back cannot be right
        before = first + count
        parts.append(part)
        places.append((payload.start_s, payload.duration_s, first))
    if not parts:
        return None
    values = np.concatenate([part.values for part in parts])
    number = np.concatenate(
        [first + np.arange(len(p.values)) for p, (_, _, first) in zip(parts, places, strict=True)]
    )
    line = _line(np.array(places), len(parts[-1].values))
    if line is None:
        return None
    start, period, sigma = line
    problem = f"{damaged} of {len(payloads)} parts have no gyroscope" if damaged else None
    return GyroTrack(start + period * number, values, sigma, parts[0].device, problem)


def _line(places: NDArray[np.float64], last_count: int) -> tuple[float, float, float] | None:
    """Return time of sample 0, period and uncertainty, seconds; None where they make no sense."""
    start, duration, first = places.T
    if len(places) < 2 or first[-1] == first[0]:
        period = duration[0] / max(last_count, 1)
        origin = start[0] - period * first[0]
        scatter = period
    else:
        period, origin = np.polyfit(first, start, 1)
        scatter = float(np.std(start - origin - period * first))
    if not np.isfinite(origin) or not 1 / _RATES_HZ[1] <= period <= 1 / _RATES_HZ[0]:
        return None
    # A payload begins somewhere between two samples: its first one is half a period late, or so.
    origin += 0.5 * period
    sigma = np.hypot(scatter, period / np.sqrt(12.0)) / np.sqrt(len(places))
    return float(origin), float(period), float(sigma)


def _gyro_of(payload: memoryview) -> _Part | None:
    device = ""
    for outer in records(payload):
        if outer.key != b"DEVC" or outer.kind:
            continue
        for inner in records(outer.content):
            if inner.key == b"DVNM":
                device = bytes(inner.content).split(b"\0")[0].decode("latin-1").strip()
            elif inner.key == b"STRM" and not inner.kind:
                found = _gyro_stream(inner.content)
                if found is not None:
                    return _Part(*found, device)
    return None


def _gyro_stream(stream: memoryview) -> tuple[NDArray[np.float64], int | None] | None:
    scale, total = np.ones(1), None
    for record in records(stream):
        if record.key == b"SCAL":
            found = _numbers(record)
            if (
                found is None
                or not found.size
                or not np.isfinite(found).all()
                or (found == 0).any()
            ):
                return None
            scale = found.reshape(-1)
        elif record.key == b"TSMP":
            found = _numbers(record)
            total = None if found is None or not found.size else int(found.flat[0])
        elif record.key == b"GYRO":
            values = _numbers(record)
            if (
                values is None
                or values.ndim != 2
                or values.shape[1] != 3
                or len(scale) not in (1, 3)
            ):
                return None
            values = values / scale
            sound = np.isfinite(values).all() and (np.abs(values) < _FASTEST_RAD_PER_S).all()
            return (values, total) if sound else None
    return None


def _numbers(record: Record) -> NDArray[np.float64] | None:
    """Return a record's numbers, (repeat, values of one sample) float64."""
    code = _NUMBERS.get(record.kind)
    if code is None:
        return None
    dtype = np.dtype(code)
    if not record.size or record.size % dtype.itemsize:
        return None
    values = np.frombuffer(record.content, dtype=dtype)
    return values.astype(np.float64).reshape(record.repeat, record.size // dtype.itemsize)


def records(data: memoryview) -> Iterator[Record]:
    """Yield the records of one level, as far as their lengths fit.

    Parameters
    ----------
    data : memoryview
    """
    at = 0
    for _ in range(_MOST_RECORDS):
        if at + _HEAD.size > len(data):
            return
        key, kind, size, repeat = _HEAD.unpack_from(data, at)
        start, length = at + _HEAD.size, size * repeat
        if key == b"\0\0\0\0" or start + length > len(data):
            return
        yield Record(key, kind, size, repeat, data[start : start + length], at)
        at = start + length + -length % 4
