"""What holds for temperatures of a fingertip, and the functions that judge it."""

from collections.abc import Iterator

import numpy as np

from acme_thermal.kind import KIND
from exumi_data.standard import Rule
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = ["IN_RANGE", "PLAUSIBLE", "in_range", "plausible"]

PLAUSIBLE = Rule(
    id="acme:THERM-001",
    level="arrays",
    severity="warning",
    title="a fingertip is neither frozen nor burning",
    message="sample {index} is {found} degrees Celsius, plausible is {expected}",
    suggestion="Look at the sensor's wiring; judge a heated table by other limits.",
    anchor="https://acme.example/thermal/rules#THERM-001",
    since="1",
    limits={"low_celsius": -10.0, "high_celsius": 80.0},
)
IN_RANGE = Rule(
    id="acme:THERM-002",
    level="arrays",
    severity="error",
    title="temperatures lie within the sensor's range",
    message="sample {index} is {found} degrees Celsius, the sensor measures {expected}",
    suggestion="Correct `acme:range_celsius`, or the conversion from the sensor's counts.",
    anchor="https://acme.example/thermal/rules#THERM-002",
    since="1",
)


def _first_outside(
    episode: EpisodeContext, stream: str, low: float, high: float
) -> tuple[int, float] | None:
    """Find the first sample outside of a range. Arrays are read in blocks: they may be long."""
    for start, (values,) in episode.blocks(f"streams/{stream}/data"):
        outside = (values < low) | (values > high)
        if outside.any():
            first = int(np.argmax(outside))
            return start + first, float(values[first])
    return None


def _streams(episode: EpisodeContext) -> Iterator[str]:
    for name, stream in episode.streams.items():
        if stream.kind == KIND and episode.described_kind(stream) is not None:
            yield name


@check(PLAUSIBLE)
def plausible(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that temperatures are those of a fingertip."""
    low = episode.limit(PLAUSIBLE, "low_celsius")
    high = episode.limit(PLAUSIBLE, "high_celsius")
    for name in _streams(episode):
        outside = _first_outside(episode, name, low, high)
        if outside is not None:
            index, value = outside
            path = f"streams/{name}/data"
            yield problem(PLAUSIBLE, path, index=index, expected=[low, high], found=value)


@check(IN_RANGE)
def in_range(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that temperatures are such as the sensor can measure, where it says so."""
    for name in _streams(episode):
        path = f"streams/{name}/data"
        limits = (episode.streams[name].model_extra or {}).get("acme:range_celsius")
        if limits is None:
            yield Skipped(IN_RANGE.id, "the stream does not say what its sensor measures", path)
            continue
        outside = _first_outside(episode, name, *limits)
        if outside is not None:
            index, value = outside
            yield problem(IN_RANGE, path, index=index, expected=limits, found=value)
