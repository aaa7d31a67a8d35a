"""How regularly the samples of a stream come: rate, gaps, jitter, bursts."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from exumi_data.model.streams import StreamModel
from exumi_data.time import NS_PER_S, parse_rate
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.intervals import MIN_INTERVALS, Intervals, intervals_of
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped
from exumi_validators.stretches import DeclaredGaps, Stretch, stretches

__all__ = ["rhythm"]


@check("TIME-005", "TIME-006", "TIME-007", "TIME-008", "GAP-002")
def rhythm(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that samples come at the stated rate, evenly, and that what is missing is said."""
    for name, stream in episode.streams.items():
        judge = _Judge(episode, name, stream)
        for stretch in stretches(episode, name):
            judge.add(stretch)
        yield from judge.findings()


class _Judge:
    """Judges one stream, and keeps of each rule the first place and the number of places."""

    def __init__(self, episode: EpisodeContext, name: str, stream: StreamModel) -> None:
        self.limit = episode.limit
        self.name = name
        self.path = f"streams/{name}/time"
        self.measured = stream.clock.stamp_point != "nominal_rate"
        self.rate = None if stream.nominal_rate is None else float(parse_rate(stream.nominal_rate))
        self.stated = stream.nominal_rate
        self.gaps = DeclaredGaps(stream)
        self.count: dict[str, int] = {}
        self.first: dict[str, tuple[int | None, str, str]] = {}
        self.skipped: dict[str, str] = {}
        self.wrong_gaps: list[Problem] = []

    @property
    def applicable(self) -> list[str]:
        """The rules that say something of this stream."""
        found = ["TIME-006"]
        if self.measured:
            found += ["TIME-007", "TIME-008"] + (["TIME-005"] if self.rate else [])
        return found + (["GAP-002"] if self.gaps.lost.any() else [])

    def add(self, stretch: Stretch) -> None:
        """Judge a stretch."""
        medians = self.limit("TIME-006", "medians")
        intervals = intervals_of(stretch.time, gap_factor=medians)
        if len(stretch.time) <= MIN_INTERVALS:
            self.skip("too few samples", *self.applicable)
        elif intervals is None:
            return  # times that do not increase are the matter of another rule
        elif self.rate is None and not intervals.is_regular:
            self.skip("samples come irregularly", *self.applicable)
        else:
            declared = self.gaps.intervals(stretch)
            if self.measured and self.unsteady(stretch, intervals, declared):
                return
            self.long_intervals(stretch, intervals, declared)
            self.spans(stretch, intervals)
            if self.measured and self.rate:
                self.rates(intervals, declared)

    def skip(self, reason: str, *codes: str) -> None:
        """Note rules that cannot be judged."""
        for code in codes:
            if code in self.applicable:
                self.skipped.setdefault(code, reason)

    def note(self, code: str, count: int, index: int | None, found: str, expected: str) -> None:
        """Note that a rule is broken, at so many places."""
        self.count[code] = self.count.get(code, 0) + count
        self.first.setdefault(code, (index, found, expected))

    def unsteady(
        self, stretch: Stretch, intervals: Intervals, declared: npt.NDArray[np.bool_]
    ) -> bool:
        """Judge bursts and jitter; whether they leave nothing else to judge."""
        crowded = intervals.crowded(self.limit("TIME-008", "share_of_period"))
        told = stretch.flagged("time_nudged", "out_of_order")
        crowded &= ~(told[1:] | told[:-1])
        total = len(intervals.periods)
        in_bursts = bool(crowded.sum() > self.limit("TIME-008", "bursts_share") * total)
        limit = self.limit("TIME-007", "share_of_period")
        jitter = intervals.jitter
        if jitter > limit and declared.any():
            jitter = intervals.jitter_beside(declared)
        if jitter > limit and not in_bursts:
            found, expected = _shown(jitter * intervals.median_ns), _shown(intervals.median_ns)
            self.note("TIME-007", 1, None, found, expected)
            self.skip("the jitter hides it", "TIME-005", "TIME-006", "TIME-008", "GAP-002")
            return True
        if crowded.sum() > self.limit("TIME-008", "share_of_samples") * total:
            places = stretch.fresh_only(crowded)
            pace = max(intervals.median_ns, intervals.pace_ns)
            self.note_at("TIME-008", stretch, intervals.periods, places, pace)
        if in_bursts:
            self.skip("samples come in bursts", "TIME-005", "TIME-006", "TIME-007", "GAP-002")
        return in_bursts

    def note_at(
        self,
        code: str,
        stretch: Stretch,
        periods: npt.NDArray[np.int64],
        places: npt.NDArray[np.int64],
        usual_ns: float,
    ) -> None:
        """Note intervals that break a rule, at the samples that they lead to."""
        if len(places):
            at = int(places[0])
            index = stretch.first + at + 1
            self.note(code, len(places), index, _shown(int(periods[at])), _shown(usual_ns))

    def long_intervals(
        self, stretch: Stretch, intervals: Intervals, declared: npt.NDArray[np.bool_]
    ) -> None:
        """Judge that gaps are declared."""
        if not intervals.statistics.gaps:
            return
        silent = np.zeros(len(intervals.periods), dtype=np.bool_)
        silent[intervals.gap_positions()] = True
        places = stretch.fresh_only(silent & ~declared)
        self.note_at("TIME-006", stretch, intervals.periods, places, intervals.median_ns)

    def spans(self, stretch: Stretch, intervals: Intervals) -> None:
        """Judge that a gap is as long as the samples that it lost."""
        if not self.gaps.lost.any():
            return
        inside = self.gaps.inside(stretch)
        at = self.gaps.after[inside] - stretch.first
        lost = self.gaps.lost[inside].astype(np.float64)
        spans = intervals.periods[at] / intervals.median_ns
        periods, share = (self.limit("GAP-002", name) for name in ("periods", "share_of_gap"))
        off = np.abs(spans - (lost + 1)) > periods + share * (lost + 1)
        for row in np.flatnonzero((lost > 0) & (at >= stretch.carried - 1) & off):
            number = int(inside[row])
            self.wrong_gaps.append(
                problem(
                    "GAP-002",
                    ROOT,
                    pointer=(*EXUMI, "streams", self.name, "gaps", number, "lost"),
                    index=number,
                    expected=int(lost[row]),
                    found=f"{spans[row]:.1f}",
                )
            )

    def rates(self, intervals: Intervals, declared: npt.NDArray[np.bool_]) -> None:
        """Judge that the rate is the stated one."""
        rate, measured = self.rate, intervals.statistics.rate_hz
        tolerance = self.limit("TIME-005", "share_of_rate")
        if rate and measured and intervals.is_off(rate, tolerance, declared):
            self.note("TIME-005", 1, None, f"{measured:.4g}", str(self.stated))

    def findings(self) -> Iterator[Finding]:
        """Return what was found, one problem a rule but for the gaps."""
        for code, (index, found, expected) in sorted(self.first.items()):
            detail = f"{self.count[code]:,}"
            yield problem(
                code, self.path, index=index, found=found, expected=expected, detail=detail
            )
        yield from self.wrong_gaps
        for code, reason in sorted(self.skipped.items()):
            if code not in self.first:
                yield Skipped(code, reason, self.path)


def _shown(ns: float) -> str:
    """Write a time with a unit that suits it."""
    for unit, name in ((NS_PER_S, "s"), (1_000_000, "ms"), (1_000, "us")):
        if ns >= unit:
            return f"{ns / unit:.4g} {name}"
    return f"{ns:.0f} ns"
