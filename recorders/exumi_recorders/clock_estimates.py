"""How a device's clock stands to the hub's: from round trips, and from arrivals alone."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = [
    "ClockOffset",
    "OneWayDrift",
    "RoundTrip",
    "estimate_offset",
    "estimate_one_way_drift",
    "lower_hull",
]

Int64Array = npt.NDArray[np.int64]
Float64Array = npt.NDArray[np.float64]

_BLOCKS = 8


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """A message that a device sent, and the answer that it got.

    Attributes
    ----------
    sent_ns, back_ns : int
        By the device's clock: when it sent the message, and when the answer came.
    received_ns, answered_ns : int
        By the hub's: when the message came, and when the answer was sent.
    """

    sent_ns: int
    received_ns: int
    answered_ns: int
    back_ns: int

    @property
    def length_ns(self) -> int:
        """Time on the way, there and back."""
        return (self.back_ns - self.sent_ns) - (self.answered_ns - self.received_ns)

    @property
    def offset_ns(self) -> int:
        """Hub's time less device's, as if both ways took the same time."""
        return ((self.received_ns - self.sent_ns) + (self.answered_ns - self.back_ns)) // 2


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """What leads from a device's clock to the hub's.

    Attributes
    ----------
    offset_ns : int
        Hub's time less device's, at the trip that was taken.
    sigma_ns : float
        Of the offset, if the share of one way in the trip is anything from none to all.
    round_trip_ns : int
        Length of that trip: the offset is off by half of it at most.
    """

    offset_ns: int
    sigma_ns: float
    round_trip_ns: int


@dataclass(frozen=True, slots=True)
class OneWayDrift:
    """How a device's clock runs against the hub's, from arrivals alone.

    What the fastest message took cannot be seen, so the offset is that of the clocks plus that
    shortest delay: it is good for jitter and drift, not for latency.

    Attributes
    ----------
    drift_ppm, drift_sigma_ppm : float
        Rate of the hub's clock against the device's less one, parts per million.
    t_ref_ns : int
        The first device time.
    offset_ns : float
        Arrival less device time on the line of fastest arrivals, at `t_ref_ns`.
    jitter_ns : float
        Median delay beyond that of the fastest.
    """

    drift_ppm: float
    drift_sigma_ppm: float
    t_ref_ns: int
    offset_ns: float
    jitter_ns: float

    def fastest_arrival_ns(self, device_ns: npt.ArrayLike) -> Float64Array:
        """Return when messages of these device times would arrive without jitter.

        Parameters
        ----------
        device_ns : array_like of int, shape (N,)

        Returns
        -------
        ndarray of float64, shape (N,)
            Nanoseconds since `t_ref_ns`, on the hub's clock less `offset_ns` at that time.
        """
        since = (np.asarray(device_ns, np.int64) - self.t_ref_ns).astype(np.float64)
        return since * (1.0 + self.drift_ppm * 1e-6)


def estimate_offset(trips: Iterable[RoundTrip]) -> ClockOffset | None:
    """Estimate a clock's offset from round trips: that of the shortest one.

    A trip is long because one of its ways waited, and nothing tells which; the shortest waited
    least. Take trips of a few seconds only: at 40 ppm clocks part by 0.4 ms in ten.

    Parameters
    ----------
    trips : iterable of RoundTrip

    Returns
    -------
    ClockOffset or None
        None without a trip of positive length.
    """
    possible = [trip for trip in trips if trip.length_ns > 0]
    if not possible:
        return None
    best = min(possible, key=lambda trip: trip.length_ns)
    return ClockOffset(best.offset_ns, best.length_ns / np.sqrt(12.0), best.length_ns)


def lower_hull(x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[np.intp]:
    """Find the points of the lower convex hull, from left to right.

    Parameters
    ----------
    x : array_like, shape (N,)
        Strictly increasing.
    y : array_like, shape (N,)

    Returns
    -------
    ndarray of intp, shape (M,)
        Indices of the hull's corners; the first and the last point are always among them.
    """
    xs, ys = np.asarray(x, np.float64).tolist(), np.asarray(y, np.float64).tolist()
    hull: list[int] = []
    for i, (px, py) in enumerate(zip(xs, ys, strict=True)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            turn = (xs[b] - xs[a]) * (py - ys[a]) - (ys[b] - ys[a]) * (px - xs[a])
            if turn > 0:
                break
            hull.pop()
        hull.append(i)
    return np.asarray(hull, np.intp)


def estimate_one_way_drift(device_ns: npt.ArrayLike, arrival_ns: npt.ArrayLike) -> OneWayDrift:
    """Estimate how a clock runs from when its messages arrive.

    Of all lines that no arrival lies below, the one nearest to the arrivals in sum is an edge of
    their lower convex hull: the edge above the mean device time.

    Parameters
    ----------
    device_ns : array_like of int, shape (N,)
        When messages were sent, by the device's clock: strictly increasing.
    arrival_ns : array_like of int, shape (N,)
        When they came, by the hub's.

    Returns
    -------
    OneWayDrift

    Raises
    ------
    ValueError
        There are fewer than 16 messages, or device times do not increase.
    """
    device, arrival = np.asarray(device_ns, np.int64), np.asarray(arrival_ns, np.int64)
    if device.shape != arrival.shape or device.ndim != 1 or len(device) < 2 * _BLOCKS:
        raise ValueError(f"needs {2 * _BLOCKS} messages or more, each with both times")
    if not (np.diff(device) > 0).all():
        raise ValueError("device times must be strictly increasing")
    since = (device - device[0]).astype(np.float64)
    # Differences first, in integers: float64 holds no nanoseconds of a clock that began long ago.
    offset_0 = int(arrival[0]) - int(device[0])
    delay = ((arrival - arrival[0]) - (device - device[0])).astype(np.float64)
    hull = lower_hull(since, delay)
    edge = int(np.clip(np.searchsorted(since[hull], since.mean(), side="right"), 1, len(hull) - 1))
    left, right = hull[edge - 1], hull[edge]
    slope = float((delay[right] - delay[left]) / (since[right] - since[left]))
    level = float(delay[left] - slope * since[left])
    waited = delay - (level + slope * since)
    return OneWayDrift(
        drift_ppm=slope * 1e6,
        drift_sigma_ppm=_slope_sigma(since, waited) * 1e6,
        t_ref_ns=int(device[0]),
        offset_ns=offset_0 + level,
        jitter_ns=float(np.median(waited)),
    )


def _slope_sigma(since: Float64Array, waited: Float64Array) -> float:
    """How well the slope is known, from how the fastest arrivals of parts of the time scatter."""
    blocks = np.array_split(np.arange(len(since)), _BLOCKS)
    fastest = np.array([waited[block].min() for block in blocks])
    centres = np.array([since[block].mean() for block in blocks])
    return float(fastest.std(ddof=1) / (centres.std() * np.sqrt(_BLOCKS)))
