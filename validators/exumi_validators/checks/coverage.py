"""What of an episode is there: samples at all, at the same time, and every number of a counter."""

from collections.abc import Iterator

import numpy as np

from exumi_data.time import NS_PER_S
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped
from exumi_validators.stretches import DeclaredGaps, Stretch, stretches

__all__ = ["counters", "empty", "missing_numbers", "overlap"]

_MIN_STEPS = 4


@check("STRM-004")
def empty(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that streams have samples."""
    for name in episode.streams:
        path = f"streams/{name}/time"
        node = episode.array_nodes.get(path)
        if node is not None and node.shape == (0,):
            yield problem("STRM-004", path)


@check("TIME-009")
def overlap(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the streams were recorded at the same time as the longest one."""
    ends: dict[str, tuple[int, int]] = {}
    for name in sorted(episode.streams):
        for _, (time,) in episode.blocks(f"streams/{name}/time"):
            first = ends[name][0] if name in ends else int(time[0])
            ends[name] = (first, int(time[-1]))
    # A stream of one sample has no length that could overlap.
    ends = {name: (first, last) for name, (first, last) in ends.items() if last > first}
    if len(ends) < 2:
        return
    longest = max(ends, key=lambda name: ends[name][1] - ends[name][0])
    share = episode.limit("TIME-009", "share_of_stream")
    for name, (first, last) in ends.items():
        common = max(0, min(last, ends[longest][1]) - max(first, ends[longest][0]))
        if common < share * (last - first):
            found, expected = f"{common / NS_PER_S:.4g} s", f"{(last - first) / NS_PER_S:.4g} s"
            path = f"streams/{name}/time"
            yield problem("TIME-009", path, found=found, expected=expected, detail=longest)


@check("SEQ-002")
def counters(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that numbers which a counter leaves out are declared as gaps."""
    for name, stream in episode.streams.items():
        if "sequence" not in stream.arrays:
            continue
        path = f"streams/{name}/sequence"
        gaps = DeclaredGaps(stream)
        first: tuple[int, int, int] | None = None
        count, reason = 0, None
        for stretch in stretches(episode, name, "sequence"):
            missing = missing_numbers(stretch.others[0])
            if missing is None:
                reason = "too few samples, or the counter has no constant step"
                continue
            places = stretch.fresh_only(missing & ~gaps.intervals(stretch))
            count += len(places)
            if len(places) and first is None:
                first = _place(stretch, int(places[0]))
        if first is not None:
            index, expected, found = first
            yield problem(
                "SEQ-002", path, index=index, expected=expected, found=found, detail=f"{count:,}"
            )
        elif reason is not None:
            yield Skipped("SEQ-002", reason, path)


def _place(stretch: Stretch, at: int) -> tuple[int, int, int]:
    sequence = stretch.others[0]
    return stretch.first + at + 1, int(sequence[at]), int(sequence[at + 1])


def missing_numbers(sequence: np.ndarray) -> np.ndarray | None:
    """Find where a counter leaves out numbers that do not come out of order elsewhere.

    Parameters
    ----------
    sequence : (N,) uint64
        The counter.

    Returns
    -------
    (N-1,) bool or None
        None where the counter has no step that at least half of the samples take: such as one
        that several sensors share.
    """
    rises = sequence[1:] > sequence[:-1]
    steps = np.where(rises, sequence[1:] - sequence[:-1], 0)
    if np.count_nonzero(rises) < _MIN_STEPS:
        return None
    step = np.uint64(np.sort(steps[rises])[np.count_nonzero(rises) // 2])
    if np.count_nonzero(steps[rises] == step) * 2 < np.count_nonzero(rises):
        return None
    jumps = np.flatnonzero(steps > step)
    missing = np.zeros(len(steps), dtype=np.bool_)
    if len(jumps):
        known = np.unique(sequence)
        low = np.searchsorted(known, sequence[jumps], side="right")
        high = np.searchsorted(known, sequence[jumps + 1], side="left")
        # Numbers between two neighbours that came earlier or later are not lost.
        lost = steps[jumps] // step - np.uint64(1)
        missing[jumps] = lost > (high - low).astype(np.uint64)
    return missing
