"""The hub's clocks: when an episode began in UTC, and how samples get their time."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.model.clock import Clock
from exumi_data.model.description import QualityNote
from exumi_data.time import apply_clock, strictly_increasing
from exumi_recorders.journal.header import JournalHeader, StreamHeader
from exumi_recorders.journal.journal import CLOCK_PAIR
from exumi_recorders.journal.reading import Block

__all__ = ["Epoch", "StreamTimes", "clock_of", "epoch_of", "utc_text"]

SOURCE = "hub_monotonic"
_STEP_NS = 10_000_000
_FARTHEST_NS = 1 << 60
_WIDEST_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Epoch:
    """When an episode began.

    Attributes
    ----------
    start : str or None
        UTC; None where no pair of clocks is left.
    note : QualityNote or None
        What is wrong with it.
    """

    start: str | None
    note: QualityNote | None = None


def utc_text(utc_ns: int) -> str:
    """Write a time in ns since 1970 as a timestamp of the format, exact to the nanosecond.

    Parameters
    ----------
    utc_ns : int
    """
    seconds, rest = divmod(utc_ns, 1_000_000_000)
    return f"{np.datetime_as_string(np.datetime64(seconds, 's'))}.{rest:09d}Z"


def epoch_of(blocks: Iterable[Block], header: JournalHeader) -> Epoch:
    """Work out when an episode began, from the pairs of clocks that were recorded.

    Where UTC was set meanwhile, the time after it is taken: it was set for a reason.

    Parameters
    ----------
    blocks : iterable of Block
        The clock's log.
    header : JournalHeader
    """
    last: int | None = None
    offset: int | None = None
    stepped = 0
    for block in blocks:
        for monotonic, payload in zip(block.time_host.tolist(), block.files, strict=True):
            if len(payload) != CLOCK_PAIR.size:
                continue
            utc, width = CLOCK_PAIR.unpack(payload)
            if not 0 <= width < _WIDEST_NS:
                continue
            found = utc - monotonic
            if last is None or abs(found - last) > _STEP_NS:
                stepped += 0 if last is None else found - last
                offset = found
            last = found
    if offset is None:
        return Epoch(header.episode.start)
    start = utc_text(header.t0_monotonic_ns + offset)
    if not stepped:
        return Epoch(start)
    message = (
        f"UTC was set by {stepped / 1e9:+.3f} s while this was recorded; `start` is by the time "
        "after that"
    )
    return Epoch(start, QualityNote(code="utc-stepped", message=message))


def clock_of(stream: StreamHeader, t0_ns: int, stamp_sigma_ns: float | None) -> Clock:
    """Return the clock of a stream.

    Parameters
    ----------
    stream : StreamHeader
    t0_ns : int
        CLOCK_MONOTONIC at the episode's start.
    stamp_sigma_ns : float, optional
        How well its samples are stamped.
    """
    known = stream.latency
    return Clock(
        source=SOURCE,
        stamp_point=stream.port.stamp_point,
        t_ref_ns=t0_ns,
        offset_sigma_ns=stamp_sigma_ns,
        latency_ns=known.latency_ns,
        latency_sigma_ns=known.latency_sigma_ns,
        raw_time="time_host",
        method=known.method,
    )


class StreamTimes:
    """Turns host times into times of the episode, block by block.

    Parameters
    ----------
    clock : Clock
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last: int | None = None

    def take(
        self, time_host: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Return times that increase strictly, and which of them were nudged for that.

        Parameters
        ----------
        time_host : (N,) int64
        """
        times = apply_clock(
            np.clip(time_host, -_FARTHEST_NS, _FARTHEST_NS),
            t_ref=self._clock.t_ref_ns,
            drift_ppm=0.0,
            offset_ns=0,
            latency_ns=self._clock.latency_ns,
        )
        before = [] if self._last is None else [self._last]
        increasing, nudged = strictly_increasing(
            np.concatenate([np.array(before, np.int64), times])
        )
        increasing, nudged = increasing[len(before) :], nudged[len(before) :]
        if len(increasing):
            self._last = int(increasing[-1])
        return increasing, nudged
