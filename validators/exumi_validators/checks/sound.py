"""Sound: whether its blocks fit together, and come as fast as they should."""

from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from exumi_data.model.streams import AudioStream
from exumi_data.time import NS_PER_S
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = ["blocks", "sound_rate"]


def _sound(episode: EpisodeContext) -> Iterator[tuple[str, AudioStream]]:
    for name, stream in episode.streams.items():
        if isinstance(stream, AudioStream):
            yield name, stream


@check("AUD-001")
def blocks(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the offsets divide the sound among the blocks."""
    for name, _ in _sound(episode):
        yield from _block_problems(episode, name)


def _block_problems(episode: EpisodeContext, name: str) -> Iterator[Problem]:
    path = f"streams/{name}/offset"
    data = episode.reader(f"streams/{name}/data")
    last: np.ndarray = np.empty(0, np.uint64)
    for start, (offset,) in episode.blocks(path):
        if start == 0 and offset[0] != 0:
            yield problem("AUD-001", path, index=0, detail=f"the first offset is {offset[0]}")
            return
        joined = np.concatenate((last, offset))
        back = joined[1:] <= joined[:-1]
        if back.any():
            row = int(back.argmax())
            detail = f"offset {joined[row + 1]} follows {joined[row]}: a block has samples"
            yield problem("AUD-001", path, index=start + row + 1 - len(last), detail=detail)
            return
        last = offset[-1:]
    end = int(last[0]) if len(last) else 0
    if path in episode.scanned and data is not None and end != data.shape[0]:
        detail = f"the last offset is {end}, the sound has {data.shape[0]} samples"
        yield problem("AUD-001", path, detail=detail)


@check("AUD-002")
def sound_rate(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that blocks bring as many samples a second as the stream states."""
    for name, stream in _sound(episode):
        if stream.clock.stamp_point == "nominal_rate" or any(_block_problems(episode, name)):
            continue
        path = f"streams/{name}/time"
        rate = float(Fraction(stream.rate))
        time = _first_rows(episode, path)
        edges = _first_rows(episode, f"streams/{name}/offset")
        count = min(len(time), len(edges))
        # Of the last block it is not known how long it took. In float64: times are close together.
        passed_s = np.diff(time[:count].astype(np.float64)) / NS_PER_S
        sizes = np.diff(edges[:count].astype(np.float64))
        if (passed_s <= 0).any():
            continue  # another rule speaks of it
        enough = len(sizes) >= episode.limit("AUD-002", "blocks")
        span_s = float(time[count - 1] - time[0]) / NS_PER_S if count else 0.0
        if not enough or span_s < episode.limit("AUD-002", "span_s"):
            yield Skipped("AUD-002", "too little sound", path)
            continue
        found = _rate(episode, passed_s, sizes)
        if abs(found - rate) > episode.limit("AUD-002", "share_of_rate") * rate:
            yield problem("AUD-002", path, found=f"{found:.6g}", expected=stream.rate)


def _first_rows(episode: EpisodeContext, path: str) -> np.ndarray:
    most = int(episode.limit("AUD-002", "window_blocks")) + 1
    found: list[np.ndarray] = []
    for start, (rows,) in episode.blocks(path):
        found.append(rows[: most - start])
        if start + len(rows) >= most:
            break
    return np.concatenate(found) if found else np.empty(0, np.int64)


def _rate(episode: EpisodeContext, passed_s: np.ndarray, sizes: np.ndarray) -> float:
    """Return samples a second, intervals with a gap left out."""
    per_sample = passed_s / sizes
    whole = per_sample <= episode.limit("AUD-002", "gap_factor") * np.median(per_sample)
    spent = float(passed_s[whole].sum())
    return float(sizes[whole].sum()) / spent if spent > 0 else 0.0
