"""The times of a stream against its other clocks: steps and drift."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from exumi_data.model.streams import StreamModel
from exumi_data.time import NS_PER_S, TIME_LIMIT_NS
from exumi_validators.checks.time import raw_scale
from exumi_validators.clock_relation import Step, Thinned, drift_of, steps_of
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Skipped
from exumi_validators.stretches import DeclaredGaps, Stretch, stretches

__all__ = ["other_clocks"]

_RULES = ("CLOCK-005", "CLOCK-006")
_SURE_SIGMAS = 3.0
_TOO_UNSURE = 10.0


@check(*_RULES)
def other_clocks(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that `time` keeps up with the clocks beside it that it was not computed from."""
    for name, stream in episode.streams.items():
        for array in ("time_host", "time_device"):
            if array in stream.arrays and array != stream.clock.raw_time:
                scale = raw_scale(stream, array)
                if scale is None:
                    reason = "the device's time has no unit of time"
                    yield from (Skipped(code, reason, f"streams/{name}/{array}") for code in _RULES)
                else:
                    yield from _judge(episode, name, stream, array, scale)


def _judge(
    episode: EpisodeContext, name: str, stream: StreamModel, array: str, scale: int
) -> Iterator[Finding]:
    path = f"streams/{name}/{array}"
    gaps = DeclaredGaps(stream)
    limit_ns = episode.limit("CLOCK-005", "step_s") * NS_PER_S
    steps: dict[int, Step] = {}
    thinned = Thinned()
    start: tuple[int, int] | None = None
    for stretch in stretches(episode, name, array):
        kept = np.flatnonzero(~stretch.flagged("time_nudged", "out_of_order"))
        time, raw = stretch.time[kept], stretch.others[0][kept]
        if not len(kept) or not _sound(time):
            continue
        start = start or (int(time[0]), int(raw[0]))
        difference = (time - start[0]) - (raw.astype(np.float64) - start[1]) * scale
        if array == "time_device" and (raw[1:] < raw[:-1]).any():
            reason = "the device's clock restarts"
            yield from (Skipped(code, reason, path) for code in _RULES)
            return
        for step in steps_of(time, difference, limit_ns):
            if array == "time_host" or not _in_gap(gaps, stretch, kept, step):
                index = stretch.first + int(kept[step.index])
                steps.setdefault(index, step)
        fresh = kept >= stretch.carried
        thinned.add(time[fresh], difference[fresh])
    if steps:
        index = min(steps)
        found = f"{steps[index].size_ns / 1e6:+.1f} ms"
        yield problem(
            "CLOCK-005", path, index=index, found=found, detail=array, number=f"{len(steps):,}"
        )
        yield Skipped("CLOCK-006", "the clock steps", path)
        return
    yield from _drift(episode, stream, array, path, thinned)


def _sound(time: npt.NDArray[np.int64]) -> bool:
    """Whether times increase and lie in range; if not, other rules say so."""
    increasing = not (time[1:] <= time[:-1]).any()
    return increasing and int(time[0]) > -TIME_LIMIT_NS and int(time[-1]) < TIME_LIMIT_NS


def _in_gap(gaps: DeclaredGaps, stretch: Stretch, kept: npt.NDArray[np.int64], step: Step) -> bool:
    """Whether samples are missing at a step: a device may have been restarted there."""
    declared = gaps.intervals(stretch)
    return bool(declared[kept[step.index - 1] : kept[step.index]].any())


def _drift(
    episode: EpisodeContext, stream: StreamModel, array: str, path: str, thinned: Thinned
) -> Iterator[Finding]:
    name = "host_ppm" if array == "time_host" else "device_ppm"
    limit = episode.limit("CLOCK-006", name)
    wander_ns = episode.limit("CLOCK-006", "wander_s") * NS_PER_S
    drift = drift_of(*thinned.samples, wander_ns)
    if drift is None:
        yield Skipped("CLOCK-006", "too few samples to compare", path)
    elif _SURE_SIGMAS * drift.sigma_ppm > _TOO_UNSURE * limit:
        yield Skipped("CLOCK-006", "too short to know the drift", path)
    else:
        sigma = float(np.hypot(drift.sigma_ppm, stream.clock.drift_sigma_ppm or 0.0))
        allowed = max(limit, _SURE_SIGMAS * sigma)
        if abs(drift.ppm) > allowed:
            yield problem(
                "CLOCK-006",
                path,
                found=f"{drift.ppm:+.0f}",
                expected=f"{allowed:.0f}",
                detail=array,
            )
