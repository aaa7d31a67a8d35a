"""Measuring one episode: small numbers and words, no array, so that processes can send them."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from exumi_data.episode import Episode, StreamView
from exumi_data.errors import DamagedDataError, LimitError
from exumi_data.model.description import Label
from exumi_data.model.streams import images_of
from exumi_data.tactile.activity import ACTIVE_THRESHOLD
from exumi_data.ticks import image_tolerance_ns, max_gap_ns, tick_times_ns
from exumi_data.time import RateStatistics, bracket_indices, nearest_indices, rate_statistics

__all__ = ["EpisodeMeasure", "StreamMeasure", "active_above", "measure_episode"]

_MAX_TICKS = 20_000_000
_TIME_LIMIT_NS = 2**62

Times = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamMeasure:
    """One stream of one episode; see `exumi_data.stats.StreamStatistics`."""

    name: str
    kind: str
    encoding: str | None
    nominal: str | None
    measured_times: bool
    rate: RateStatistics
    declared_gaps: int
    lost: dict[str, int]
    active_above: float | None
    active: int | None
    bytes: int
    usable: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeMeasure:
    """One episode; see `exumi_data.stats.Statistics`."""

    id: str
    regime: str
    duration_s: float
    streams: tuple[StreamMeasure, ...]
    tactile_frames: int | None
    tactile_active: int
    has_tactile: bool
    ticks: int
    usable: int
    lacks_required: bool
    task: str
    object_id: str | None
    part_id: str | None
    procedure: str | None
    pad_type: str | None
    success: bool | None
    licence: str
    source: str
    lossy: tuple[str, ...]
    quality: tuple[str, ...]
    labels: tuple[Label, ...]
    bytes_total: int
    bytes_streams: int
    bytes_derived: int


def measure_episode(
    episode: Episode, *, tick_s: Fraction, required: Sequence[str] | None
) -> EpisodeMeasure:
    """Measure an episode. Reads its times and stored activity; decodes no frame.

    Parameters
    ----------
    episode : Episode
    tick_s : fractions.Fraction
        Distance of two ticks of the common timeline, seconds.
    required : sequence of str or None
        Streams that must be valid at a usable tick; None: all that the episode has.

    Returns
    -------
    EpisodeMeasure

    Raises
    ------
    DamagedDataError
        An array is missing or damaged, or times do not increase.
    """
    episode.check_complete()  # a missing shard would only make the dataset look smaller
    times = {name: _times(episode, stream) for name, stream in episode.streams.items()}
    names = list(times) if required is None else list(required)
    lacking = any(name not in times for name in names)
    ticks = _ticks([times[name] for name in names if name in times], tick_s)
    valid = {
        name: _valid_at(stream, times[name], ticks, tick_s)
        for name, stream in episode.streams.items()
    }
    together = np.ones(len(ticks), dtype=np.bool_)
    for name in names:
        together &= valid.get(name, False)
    frames, active = _tactile_union(episode, times, tick_s)
    sizes = _sizes(episode)
    meta, notes = episode.metadata, episode.metadata.annotations
    return EpisodeMeasure(
        id=episode.id,
        regime=meta.regime,
        duration_s=_duration_s(times),
        streams=tuple(
            _stream(episode, stream, times[name], sizes.get(name, 0), int(valid[name].sum()))
            for name, stream in episode.streams.items()
        ),
        tactile_frames=frames,
        tactile_active=active,
        has_tactile=bool(episode.of_kind("tactile")),
        ticks=len(ticks),
        usable=int(together.sum()),
        lacks_required=lacking,
        task=meta.task.name,
        object_id=notes.object_id if notes else None,
        part_id=notes.part_id if notes else None,
        procedure=notes.procedure if notes else None,
        pad_type=notes.pad_type if notes else None,
        success=meta.success,
        licence=meta.licence,
        source=meta.source.type,
        lossy=tuple(sorted({step.step for step in meta.source.lossy or []})),
        quality=tuple(note.code for note in meta.quality),
        labels=tuple((notes.labels if notes else None) or ()),
        bytes_total=sum(sizes.values()),
        bytes_streams=sum(sizes.get(name, 0) for name in times),
        bytes_derived=sizes.get("derived/", 0),
    )


def _times(episode: Episode, stream: StreamView) -> Times:
    time = stream.time
    sound = time.ndim == 1 and time.dtype == np.int64 and not (time[1:] <= time[:-1]).any()
    if sound and len(time):
        sound = bool(time[0] > -_TIME_LIMIT_NS and time[-1] < _TIME_LIMIT_NS)
    if not sound:
        raise DamagedDataError(
            f"`time` of stream {stream.name!r} is not int64 within ±146 years that increases "
            "strictly",
            where=episode.path,
            fix=f"See all problems with: exumi validate {episode.path}",
        )
    return time


def _duration_s(times: dict[str, Times]) -> float:
    there = [time for time in times.values() if len(time)]
    if not there:
        return 0.0
    return int(max(t[-1] for t in there) - min(t[0] for t in there)) / 1e9


def _ticks(times: list[Times], tick_s: Fraction) -> Times:
    """Return the ticks from the first sample of any stream to the last, (T,) int64 ns."""
    there = [time for time in times if len(time)]
    if not there:
        return np.zeros(0, np.int64)
    start = int(min(time[0] for time in there))
    end = int(max(time[-1] for time in there))
    tick_ns = tick_s * 1_000_000_000
    count = int((end - start) / tick_ns) + 1
    if count > _MAX_TICKS:
        raise LimitError(
            f"the episode lasts {(end - start) * 1e-9:.0f} s: too long for ticks of "
            f"{float(tick_s):g} s",
            fix="Check its times with exumi validate, or choose a longer tick.",
        )
    return start + tick_times_ns(np.arange(count), tick_s)


def _valid_at(stream: StreamView, time: Times, ticks: Times, tick_s: Fraction) -> Mask:
    if not len(time):
        return np.zeros(len(ticks), np.bool_)
    if stream.is_image:
        return nearest_indices(time, ticks, image_tolerance_ns(time, tick_s)) >= 0
    return bracket_indices(time, ticks, max_gap_ns(time)).valid


def active_above(episode: Episode, name: str) -> float:
    """Return the activity above which a tactile frame is active, as it was stored with it.

    Parameters
    ----------
    episode : Episode
    name : str
        Of the stream. Where nothing is stored, it is the standard's own threshold.
    """
    item = episode.derived.items.get(f"{name}/activity") if episode.derived else None
    above = item.parameters.get("active_above") if item else None
    return float(above) if isinstance(above, int | float) else ACTIVE_THRESHOLD


def _active(episode: Episode, stream: StreamView) -> Mask | None:
    """Return which frames are active, (N,) bool, or None without stored activity."""
    activity = stream.activity
    if activity is None:
        return None
    return np.asarray(activity > active_above(episode, stream.name))


def _tactile_union(
    episode: Episode, times: dict[str, Times], tick_s: Fraction
) -> tuple[int | None, int]:
    """Return moments and active moments; (None, 0) where they cannot be known."""
    streams = sorted(episode.of_kind("tactile"), key=lambda stream: stream.name)
    flags = {s.name: _active(episode, s) for s in streams}
    known = {name: active for name, active in flags.items() if active is not None}
    if not streams or len(known) < len(flags):
        return None, 0
    densest = max(known, key=lambda name: len(times[name]))
    moments = times[densest]
    union = known[densest].copy()
    for name, active in known.items():
        if name != densest and len(active):
            nearest = nearest_indices(times[name], moments, image_tolerance_ns(times[name], tick_s))
            union |= active[nearest] & (nearest >= 0)
    return len(moments), int(union.sum())


def _sizes(episode: Episode) -> dict[str, int]:
    """Return bytes by stream, under ``derived/`` for what was derived and ``/`` for the rest."""
    sizes: dict[str, int] = {}
    for path in episode.store.paths():
        top, _, rest = path.partition("/")
        key = "derived/" if top == "derived" else "/"
        if top == "streams" and "/" in rest:
            key = rest.partition("/")[0]
        sizes[key] = sizes.get(key, 0) + episode.store.size(path)
    return sizes


def _stream(
    episode: Episode, stream: StreamView, time: Times, size: int, usable: int
) -> StreamMeasure:
    meta = stream.metadata
    images = images_of(meta)
    active = _active(episode, stream) if stream.kind == "tactile" else None
    return StreamMeasure(
        name=stream.name,
        kind=stream.kind,
        encoding=images.encoding if images else None,
        nominal=meta.nominal_rate,
        measured_times=meta.clock.stamp_point != "nominal_rate",
        rate=rate_statistics(time),
        declared_gaps=len(meta.gaps or []),
        lost=dict(meta.lost or {}),
        active_above=None if active is None else active_above(episode, stream.name),
        active=None if active is None else int(active.sum()),
        bytes=size,
        usable=usable,
    )
