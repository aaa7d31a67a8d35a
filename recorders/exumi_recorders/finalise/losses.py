"""What is missing in a stream, and why: gaps, counters, and the flags of samples."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from exumi_data.model.clock import Gap
from exumi_recorders.journal.record import NONE, RESTARTED

__all__ = ["FLAG", "MOST_GAPS", "Losses", "Numbered"]

FLAG = {"time_nudged": 1, "out_of_order": 2, "gap_before": 4, "invalid": 8, "out_of_range": 16}
"""Bits of the registry."""
KNOWN_FLAGS = sum(FLAG.values())
MOST_GAPS = 4000
"""Gaps of one stream that are listed: a document cannot hold any number. Others are flagged."""
_UNREADABLE = "a file that is no image of the stream"
_FARTHEST_LATE = 1000  # a number that is farther behind is not late: the device counts anew
_LATE = 64  # how many gaps a sample that comes late can lie behind


@dataclass(slots=True, eq=False)
class Numbered:
    """What `Losses.take` finds out about some samples.

    Attributes
    ----------
    flags : (N,) uint32
        ``out_of_order`` and ``gap_before``.
    sequence : (N,) uint64 or None
        The device's own numbers, unwrapped; None where it has none.
    """

    flags: npt.NDArray[np.uint32]
    sequence: npt.NDArray[np.uint64] | None


@dataclass(slots=True)
class _Open:
    """A gap that may yet be filled by samples that come late."""

    after: int
    lost: int | None
    reason: str
    first: int = 0
    last: int = -1


@dataclass(slots=True)
class Losses:
    """Follows the numbers of a stream's samples: those of the journal, and those of the device.

    Parameters
    ----------
    modulus : int, optional
        Where the device's numbers wrap.

    Attributes
    ----------
    count : int
        Samples taken so far.
    lost : dict of str to int
        By cause.
    unlisted : int
        Gaps beyond `MOST_GAPS`.
    """

    modulus: int | None
    count: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    unlisted: int = 0
    _gaps: list[_Open] = field(default_factory=list)
    _next_number: int = 0
    _last_raw: int | None = None
    _last: int = -1
    _highest: int = -1

    def take(
        self,
        seq: npt.NDArray[np.uint64],
        sequence: npt.NDArray[np.int64],
        flags: npt.NDArray[np.uint32],
        *,
        damaged: npt.NDArray[np.bool_],
        left_out: npt.NDArray[np.int64],
    ) -> Numbered:
        """Follow some samples.

        Parameters
        ----------
        seq : (N,) uint64
            The journal's own numbers.
        sequence : (N,) int64
            The device's, as they were sent.
        flags : (N,) uint32
            Of the records.
        damaged : (N,) bool
            Whether a part of the journal was passed over before the sample.
        left_out : (N,) int64
            How many samples before this one are in the journal, but not in the episode.
        """
        found = np.zeros(len(seq), np.uint32)
        numbers = seq.astype(np.int64)
        holes = np.diff(numbers, prepend=self._next_number - 1) - 1 - left_out
        restarted = (flags & RESTARTED) != 0
        has_sequence = bool((sequence != NONE).all()) if len(seq) else False
        unwrapped = np.zeros(len(seq), np.int64)
        jumps = np.zeros(len(seq), np.int64)
        if has_sequence:
            self._unwrap(sequence, restarted, unwrapped, jumps, found)
        odd = (holes > 0) | (left_out > 0) | (jumps != 0) | restarted | damaged
        for index in np.flatnonzero(odd).tolist():
            self._gap(
                self.count + index - 1,
                hole=int(holes[index]),
                left_out=int(left_out[index]),
                jump=int(jumps[index]),
                number=int(unwrapped[index]),
                restarted=bool(restarted[index]),
                damaged=bool(damaged[index]),
            )
            if jumps[index] >= 0:
                found[index] |= FLAG["gap_before"]
        if len(seq):
            self._next_number = int(numbers[-1]) + 1
        self.count += len(seq)
        return Numbered(found, unwrapped.astype(np.uint64) if has_sequence else None)

    def _unwrap(
        self,
        raw: npt.NDArray[np.int64],
        restarted: npt.NDArray[np.bool_],
        unwrapped: npt.NDArray[np.int64],
        jumps: npt.NDArray[np.int64],
        flags: npt.NDArray[np.uint32],
    ) -> None:
        """Fill in numbers that go on, jumps over missing ones, and flags of those out of order.

        A jump is negative where a number comes late.
        """
        if self._last_raw is None:
            self._last_raw = int(raw[0]) - 1
            self._last = self._highest = max(int(raw[0]), 0) - 1
        step = np.diff(raw, prepend=self._last_raw)
        if self.modulus is not None:
            step = np.mod(step, self.modulus)
            step = np.where(step > self.modulus // 2, step - self.modulus, step)
        if (step == 1).all() and not restarted.any() and self._last == self._highest:
            unwrapped[:] = self._last + np.arange(1, len(raw) + 1)
            self._last_raw, self._last = int(raw[-1]), int(unwrapped[-1])
            self._highest = self._last
            return
        last, highest = self._last, self._highest
        for index, (by, anew) in enumerate(zip(step.tolist(), restarted.tolist(), strict=True)):
            # Opened or started anew, a device counts from where it likes.
            restarted[index] = anew or by < -_FARTHEST_LATE
            number = highest + 1 if restarted[index] else max(last + by, 0)
            if number <= last:
                flags[index] |= FLAG["out_of_order"]
            if number > highest:
                jumps[index] = number - highest - 1
                highest = number
            else:
                jumps[index] = -1
            unwrapped[index] = last = number
        self._last_raw, self._last, self._highest = int(raw[-1]), last, highest

    def _gap(
        self,
        after: int,
        *,
        hole: int,
        left_out: int,
        jump: int,
        number: int,
        restarted: bool,
        damaged: bool,
    ) -> None:
        if jump < 0:
            self._fill(number)
        here = max(hole, 0)
        in_device = max(jump - here - left_out, 0)
        self._count("journal" if damaged else "queue", here)
        self._count("unreadable", left_out)
        self._count("sequence", in_device)
        lost = here + left_out + in_device
        unknown = restarted or (damaged and not lost)
        if not lost and not unknown:
            return
        if restarted:
            reason = "the device was gone, or began anew"
        elif damaged:
            reason = "a part of the journal is damaged"
        elif here:
            reason = "the disk could not keep up"
        elif left_out:
            reason = _UNREADABLE
        else:
            reason = "the device's numbers leave them out"
        gap = _Open(after, None if unknown else lost, reason)
        if in_device and not unknown:
            gap.first, gap.last = number - jump, number - 1
        self._add(gap)

    def _fill(self, number: int) -> None:
        """Take a sample that came late out of the gap that it was missed in."""
        for gap in reversed(self._gaps[-_LATE:]):
            if gap.first <= number <= gap.last and gap.lost:
                gap.lost -= 1
                self._count("sequence", -1)
                return

    def left_out_at_the_end(self, number: int) -> None:
        """Note samples that are in the journal after the last one of the episode.

        Parameters
        ----------
        number : int
        """
        self._count("unreadable", number)
        self._add(_Open(self.count - 1, number, _UNREADABLE))

    def gap(self, after: int, reason: str, lost: int | None = None) -> None:
        """Note a gap that is known from elsewhere.

        Parameters
        ----------
        after : int
            Index of the sample before it.
        reason : str
        lost : int, optional
        """
        self._add(_Open(after, lost, reason))

    def _add(self, gap: _Open) -> None:
        same = next((each for each in self._gaps[-_LATE:] if each.after == gap.after), None)
        if same is not None:
            unknown = same.lost is None or gap.lost is None
            same.lost = None if unknown else (same.lost or 0) + (gap.lost or 0)
        elif len(self._gaps) >= MOST_GAPS:
            self.unlisted += 1
        else:
            self._gaps.append(gap)

    def _count(self, cause: str, number: int) -> None:
        if number:
            self.lost[cause] = self.lost.get(cause, 0) + number

    def gaps(self) -> list[Gap] | None:
        """Return the gaps in order; None where there is none."""
        listed = [
            Gap(after=gap.after, reason=gap.reason)
            if gap.lost is None
            else Gap(after=gap.after, lost=gap.lost, reason=gap.reason)
            for gap in sorted(self._gaps, key=lambda gap: gap.after)
            if gap.lost != 0
        ]
        return listed or None
