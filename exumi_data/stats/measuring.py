"""Measuring an episode or a dataset: episodes one by one, on all cores, then added up."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import partial
from math import fsum
from statistics import median

from exumi_data.dataset import Dataset
from exumi_data.engine import Engine, map_items
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import ExumiError, UsageError
from exumi_data.stats.episode import EpisodeMeasure, StreamMeasure, measure_episode
from exumi_data.stats.labels import count_labels
from exumi_data.stats.model import (
    ActiveTactile,
    Content,
    Range,
    Regime,
    Sizes,
    Statistics,
    StreamStatistics,
    Unreadable,
    Usable,
)
from exumi_data.ticks import DEFAULT_TICK_S

__all__ = ["measure"]


_MANY_EPISODES = 200
_DEMONSTRATIONS = ("demonstration", "play")


def measure(
    source: Dataset | Episode,
    *,
    tick_s: Fraction | float = DEFAULT_TICK_S,
    required: Sequence[str] | None = None,
    workers: int | None = None,
    engine: Engine | None = None,
    on_done: Callable[[int], None] | None = None,
) -> Statistics:
    """Measure an episode or a dataset. Reads times and stored activity; decodes no frame.

    Parameters
    ----------
    source : Dataset or Episode
        A dataset, a selection of one, or an episode.
    tick_s : fractions.Fraction or float
        Distance of two ticks of the common timeline, seconds.
    required : sequence of str, optional
        Streams that must be valid at a usable tick. Default: all that an episode has.
    workers : int, optional
        Processes. Default: one for up to 200 episodes, else all cores.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_done : callable, optional
        Called after each episode with the number of episodes done, for progress.

    Returns
    -------
    Statistics

    Raises
    ------
    UsageError
        The tick is not positive, or no episode has a required stream.
    ExumiError
        `source` is an episode that cannot be read. In a dataset such an episode is listed in
        `Statistics.unreadable`.
    """
    tick = Fraction(tick_s).limit_denominator(10**9)
    if tick <= 0:
        raise UsageError(f"a tick of {float(tick_s)} seconds is not positive")
    unreadable: list[Unreadable] = []
    if isinstance(source, Episode):
        what, name = "episode", source.id
        measures = [measure_episode(source, tick_s=tick, required=required)]
    else:
        what, name = "dataset", source.metadata.name
        measures = _measure_all(
            source, tick, required, workers, engine, on_done=on_done, unreadable=unreadable
        )
    _check_required(required, measures, source.path)
    return _add_up(source.path, what, name, measures, unreadable, tick, required)


def _measure_path(path: str, *, tick_s: Fraction, required: Sequence[str] | None) -> EpisodeMeasure:
    with open_episode(path) as episode:
        return measure_episode(episode, tick_s=tick_s, required=required)


def _measure_all(
    dataset: Dataset,
    tick_s: Fraction,
    required: Sequence[str] | None,
    workers: int | None,
    engine: Engine | None,
    *,
    on_done: Callable[[int], None] | None,
    unreadable: list[Unreadable],
) -> list[EpisodeMeasure]:
    paths = [dataset.episode_location(index) for index in range(len(dataset))]
    # A few episodes are read faster than processes start.
    if engine is None and workers is None and len(paths) <= _MANY_EPISODES:
        workers = 1
    function = partial(_measure_path, tick_s=tick_s, required=required)
    found: dict[str, EpisodeMeasure] = {}
    for outcome in map_items(function, paths, workers=workers, engine=engine):
        if outcome.value is not None:
            found[outcome.item] = outcome.value
        elif isinstance(outcome.error, ExumiError | OSError):
            unreadable.append(Unreadable(outcome.item, str(outcome.error)))
        elif outcome.error is not None:
            raise outcome.error
        if on_done is not None:
            on_done(len(found) + len(unreadable))
    unreadable.sort(key=lambda item: item.path)
    return [found[path] for path in paths if path in found]


def _check_required(
    required: Sequence[str] | None, measures: Sequence[EpisodeMeasure], path: str
) -> None:
    known = {stream.name for item in measures for stream in item.streams}
    for name in required or ():
        if measures and name not in known:
            raise UsageError(
                f"no episode has a stream {name!r}",
                where=path,
                fix=f"There are: {', '.join(sorted(known)) or 'none'}.",
            )


def _add_up(
    path: str,
    what: str,
    name: str,
    measures: list[EpisodeMeasure],
    unreadable: list[Unreadable],
    tick_s: Fraction,
    required: Sequence[str] | None,
) -> Statistics:
    durations = [item.duration_s for item in measures]
    regimes = _regimes(measures)
    shown = [regimes[regime] for regime in _DEMONSTRATIONS if regime in regimes]
    total = _regime(sum(r.episodes for r in shown), fsum(r.duration_s for r in shown))
    return Statistics(
        path=path,
        what=what,
        name=name,
        episodes=len(measures),
        duration_s=fsum(durations),
        episode_duration_s=_range(durations),
        demonstrations_per_hour=total.per_hour if shown else None,
        regimes=regimes,
        streams=_streams(measures),
        active=_active(measures),
        usable=_usable(measures, tick_s, required),
        content=_content(measures),
        labels=count_labels([item.labels for item in measures]),
        sizes=_sizes(measures),
        unreadable=unreadable,
    )


def _range(values: Iterable[float | None]) -> Range | None:
    there = [value for value in values if value is not None]
    return Range(min(there), median(there), max(there)) if there else None


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _regime(episodes: int, duration_s: float) -> Regime:
    return Regime(episodes, duration_s, 3600 * episodes / duration_s if duration_s > 0 else None)


def _regimes(measures: list[EpisodeMeasure]) -> dict[str, Regime]:
    found = {}
    for regime in sorted({item.regime for item in measures}):
        durations = [item.duration_s for item in measures if item.regime == regime]
        found[regime] = _regime(len(durations), fsum(durations))
    return found


def _streams(measures: list[EpisodeMeasure]) -> list[StreamStatistics]:
    groups: dict[tuple[str, str], list[tuple[StreamMeasure, int]]] = {}
    for item in measures:
        for stream in item.streams:
            groups.setdefault((stream.kind, stream.name), []).append((stream, item.ticks))
    # Tactile first: it is what this is about.
    order = sorted(groups, key=lambda key: (key[0] != "tactile", key[0] != "rgb", *key))
    return [_stream([s for s, _ in groups[k]], sum(t for _, t in groups[k])) for k in order]


def _stream(parts: list[StreamMeasure], ticks: int) -> StreamStatistics:
    rates = [part.rate for part in parts]
    samples = sum(rate.n for rate in rates)
    size = sum(part.bytes for part in parts)
    gaps = [gap.length_s for rate in rates for gap in rate.gaps]
    lost: Counter[str] = Counter()
    for part in parts:
        lost.update(part.lost)
    measured = [part for part in parts if part.active is not None]
    return StreamStatistics(
        name=parts[0].name,
        kind=parts[0].kind,
        encodings=sorted({part.encoding for part in parts if part.encoding is not None}),
        episodes=len(parts),
        empty=sum(rate.n == 0 for rate in rates),
        n=samples,
        duration_s=fsum(rate.duration_s for rate in rates),
        nominal_hz=_count(part.nominal for part in parts if part.nominal is not None),
        measured_times=any(part.measured_times for part in parts),
        rate_hz=_range(rate.rate_hz for rate in rates),
        jitter_s=_range(rate.jitter_s for rate in rates),
        gaps=len(gaps),
        longest_gap_s=max(gaps, default=0.0),
        episodes_with_gaps=sum(rate.gap_count > 0 for rate in rates),
        declared_gaps=sum(part.declared_gaps for part in parts),
        lost=dict(sorted(lost.items())),
        active_above=sorted({p.active_above for p in measured if p.active_above is not None}),
        active=sum(part.active or 0 for part in measured) if measured else None,
        measured_activity=sum(part.rate.n for part in measured),
        bytes=size,
        bytes_per_sample=size / samples if samples else None,
        usable=_ratio(sum(part.usable for part in parts), ticks),
    )


def _active(measures: list[EpisodeMeasure]) -> ActiveTactile:
    known = [item for item in measures if item.tactile_frames is not None]
    frames = sum(item.tactile_frames or 0 for item in known)
    active = sum(item.tactile_active for item in known)
    return ActiveTactile(
        episodes=len(known),
        unmeasured=sum(item.has_tactile for item in measures) - len(known),
        frames=frames,
        active=active,
        ratio=_ratio(active, frames),
    )


def _usable(
    measures: list[EpisodeMeasure], tick_s: Fraction, required: Sequence[str] | None
) -> Usable:
    ticks = sum(item.ticks for item in measures)
    usable = sum(item.usable for item in measures)
    return Usable(
        tick_s=float(tick_s),
        required=None if required is None else list(required),
        ticks=ticks,
        usable=usable,
        ratio=_ratio(usable, ticks),
        without=sum(item.lacks_required for item in measures),
    )


def _count(values: Iterable[str | None]) -> dict[str, int]:
    """Count values, most frequent first, of equals by name; None counts as the empty string."""
    counter = Counter(value or "" for value in values)
    return dict(sorted(counter.items(), key=lambda item: (-item[1], item[0])))


_SUCCESS = {True: "yes", False: "no", None: None}


def _content(measures: list[EpisodeMeasure]) -> Content:
    return Content(
        tasks=_count(item.task for item in measures),
        objects=_count(item.object_id for item in measures),
        parts=_count(item.part_id for item in measures),
        procedures=_count(item.procedure for item in measures),
        pad_types=_count(item.pad_type for item in measures),
        success=_count(_SUCCESS[item.success] for item in measures),
        licences=_count(item.licence for item in measures),
        sources=_count(item.source for item in measures),
        lossy_steps=_count(step for item in measures for step in item.lossy),
        quality=_count(code for item in measures for code in sorted(set(item.quality))),
    )


def _sizes(measures: list[EpisodeMeasure]) -> Sizes:
    total = sum(item.bytes_total for item in measures)
    streams = sum(item.bytes_streams for item in measures)
    derived = sum(item.bytes_derived for item in measures)
    return Sizes(bytes=total, streams=streams, derived=derived, metadata=total - streams - derived)
