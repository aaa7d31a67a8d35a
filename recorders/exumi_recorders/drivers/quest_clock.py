"""A headset's clock against the hub's, while datagrams come (dialect d)."""

from collections import deque

from exumi_recorders.clock_estimates import (
    ClockOffset,
    OneWayDrift,
    RoundTrip,
    estimate_offset,
    estimate_one_way_drift,
)
from exumi_recorders.drivers.quest_dialects import Trip

__all__ = ["ClockWatch"]

S_NS = 1_000_000_000
_TRIP_AGE_NS = 10 * S_NS
_SECONDS = 300
_ENOUGH = 16


class ClockWatch:
    """Keeps the round trips of the last seconds, and the fastest arrival of each second."""

    def __init__(self) -> None:
        self._trips: deque[RoundTrip] = deque(maxlen=64)
        self._fastest: deque[tuple[int, int]] = deque(maxlen=_SECONDS)

    def take_trip(self, trip: Trip, time_ns: int) -> bool:
        """Keep a round trip; return False for one that cannot be ours, or is too old.

        Parameters
        ----------
        trip : Trip
        time_ns : int
            When it came, by the hub's clock.
        """
        ours = trip.received_ns <= trip.answered_ns <= time_ns <= trip.answered_ns + _TRIP_AGE_NS
        found = RoundTrip(trip.sent_ns, trip.received_ns, trip.answered_ns, trip.back_ns)
        if not ours or found.length_ns <= 0:
            return False
        self._trips.append(found)
        return True

    def take_arrival(self, device_ns: int, time_ns: int) -> None:
        """Look at the times of the next datagram.

        Parameters
        ----------
        device_ns, time_ns : int
            When it was sent, by the headset's clock, and when it came, by the hub's.
        """
        if not self._fastest or device_ns // S_NS != self._fastest[-1][0] // S_NS:
            self._fastest.append((device_ns, time_ns))
        elif time_ns - device_ns < self._fastest[-1][1] - self._fastest[-1][0]:
            self._fastest[-1] = (device_ns, time_ns)

    def offset(self, now_ns: int) -> ClockOffset | None:
        """Return the clock's offset by the trips of the last ten seconds; None without any.

        Parameters
        ----------
        now_ns : int
        """
        return estimate_offset(
            trip for trip in list(self._trips) if now_ns - trip.answered_ns <= _TRIP_AGE_NS
        )

    def drift(self) -> OneWayDrift | None:
        """Return how the clock runs, by the last five minutes; None in the first 16 s."""
        fastest = list(self._fastest)
        if len(fastest) < _ENOUGH:
            return None
        return estimate_one_way_drift(
            [device_ns for device_ns, _ in fastest], [time_ns for _, time_ns in fastest]
        )

    def readings(self, now_ns: int) -> dict[str, float | int]:
        """Return what is known of the clock, by name; nothing before the first trip.

        Parameters
        ----------
        now_ns : int
        """
        found: dict[str, float | int] = {}
        offset = self.offset(now_ns)
        if offset is not None:
            found["clock_offset_ns"] = offset.offset_ns
            found["clock_offset_sigma_ns"] = round(offset.sigma_ns)
            found["round_trip_ms"] = round(offset.round_trip_ns / 1e6, 3)
        drift = self.drift()
        if drift is not None:
            found["clock_drift_ppm"] = round(drift.drift_ppm, 2)
            found["clock_drift_sigma_ppm"] = round(drift.drift_sigma_ppm, 2)
        return found

    def restart(self) -> None:
        """Forget everything: it may be another clock."""
        self._trips.clear()
        self._fastest.clear()
