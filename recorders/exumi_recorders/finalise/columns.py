"""The arrays that any stream has: `time`, beside it host and device time, sequence, flags."""

from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.model.clock import Clock
from exumi_data.standard import registry
from exumi_data.time import parse_rate
from exumi_recorders.contract import Port
from exumi_recorders.finalise.clocks import StreamTimes
from exumi_recorders.finalise.losses import FLAG, KNOWN_FLAGS, Losses
from exumi_recorders.journal.reading import Block
from exumi_recorders.journal.record import NONE

__all__ = ["Columns"]

_GAP_PERIODS = 2.5
_FEWEST_FOR_MEDIAN = 32
_OTHER_CLOCK_NS = 10_000_000_000  # so far back is no late sample: the device's clock began anew


class Columns:
    """Makes `time` and the arrays beside a stream's samples, block by block.

    Parameters
    ----------
    port : Port
    clock : Clock
    losses : Losses

    Attributes
    ----------
    first_ns, last_ns : int or None
        Host times of the first and the newest sample.
    """

    def __init__(self, port: Port, clock: Clock, losses: Losses) -> None:
        self._times = StreamTimes(clock)
        self._losses = losses
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._with_device_time: bool | None = None
        self._with_sequence: bool | None = None
        self._last_tick_ns: int | None = None
        self._left_out = self._damaged = self._last_sequence = 0
        rate = None if port.nominal_rate is None else parse_rate(port.nominal_rate)
        self._period_ns = None if rate is None else float(1_000_000_000 / rate)
        unit = registry.units().get(port.time_device_unit or "")
        self._has_unit = port.time_device_unit is not None
        self._unit_ns = 1 if unit is None else unit.ns or 1

    def of(
        self, block: Block, kept: npt.NDArray[np.bool_] | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """Return `time` and what is beside it, for the records that are kept.

        Parameters
        ----------
        block : Block
        kept : (N,) bool, optional
        """
        if kept is None:
            kept = np.ones(len(block), np.bool_)
        host = block.time_host[kept]
        damaged, left_out = self._before_kept(block.damaged, kept)
        raw_sequence = block.sequence[kept]
        first = self._losses.count
        numbered = self._losses.take(
            block.seq[kept], raw_sequence, block.flags[kept], damaged=damaged, left_out=left_out
        )
        times, nudged = self._times.take(host)
        flags = (block.flags[kept] & np.uint32(KNOWN_FLAGS)) | numbered.flags
        flags[nudged] |= FLAG["time_nudged"]
        columns: dict[str, npt.NDArray[Any]] = {"time": times, "time_host": host, "flags": flags}
        if self._with_sequence is None and len(host):
            self._with_sequence = numbered.sequence is not None
            has_device = bool((block.time_device[kept] != NONE).all())
            self._with_device_time = has_device and self._has_unit
        if self._with_sequence:
            columns["sequence"] = self._sequence(numbered.sequence, flags)
        if len(host):
            self.first_ns = int(host[0]) if self.first_ns is None else self.first_ns
            self.last_ns = int(host[-1])
        ticks_ns = host
        if self._with_device_time:
            columns["time_device"] = block.time_device[kept]
            # By the hub's clock, what waited in the air came after a pause: nothing is missing.
            ticks_ns = block.time_device[kept] * self._unit_ns
        self._gaps_in_time(ticks_ns, flags, first)
        return columns

    def _before_kept(
        self, damaged: npt.NDArray[np.bool_], kept: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
        """Return what lies between a kept record and the one before: damage, and others."""
        index = np.flatnonzero(kept)
        left_out = np.diff(index, prepend=-1) - 1
        running = np.cumsum(damaged)
        since = np.diff(running[index], prepend=0)
        if not len(index):
            self._left_out += len(kept)
            self._damaged += int(running[-1]) if len(running) else 0
            return since > 0, left_out
        left_out[0] += self._left_out
        since[0] += self._damaged
        self._left_out = len(kept) - 1 - int(index[-1])
        self._damaged = int(running[-1] - running[index[-1]])
        return since > 0, left_out

    def finish(self) -> None:
        """Note what was left out after the last sample."""
        if self._left_out:
            self._losses.left_out_at_the_end(self._left_out)

    def _sequence(
        self, found: npt.NDArray[np.uint64] | None, flags: npt.NDArray[np.uint32]
    ) -> npt.NDArray[np.uint64]:
        if found is None:
            # A driver whose later samples have no numbers is wrong; the samples are not.
            flags |= FLAG["out_of_order"]
            return np.full(len(flags), self._last_sequence, np.uint64)
        if len(found):
            self._last_sequence = int(found[-1])
        return found

    def _gaps_in_time(
        self, ticks_ns: npt.NDArray[np.int64], flags: npt.NDArray[np.uint32], first: int
    ) -> None:
        """Note where nothing was sent for more than 2.5 periods, whatever the numbers say."""
        if not len(ticks_ns):
            return
        before = self._last_tick_ns
        if before is None or ticks_ns[0] < before - _OTHER_CLOCK_NS:
            before = int(ticks_ns[0])
        # What comes late lies before its time: the next one is not late for that.
        reached = np.maximum.accumulate(np.concatenate([np.array([before]), ticks_ns]))
        intervals = np.diff(reached)
        self._last_tick_ns = int(reached[-1])
        usual = float(np.median(intervals)) if len(ticks_ns) >= _FEWEST_FOR_MEDIAN else 0.0
        period = max(self._period_ns or 0.0, usual)
        if period <= 0:
            return
        for index in np.flatnonzero(intervals > _GAP_PERIODS * period).tolist():
            if not flags[index] & FLAG["gap_before"]:
                flags[index] |= FLAG["gap_before"]
                self._losses.gap(first + index - 1, "no sample came")
