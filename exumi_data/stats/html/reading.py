"""Reading an episode's figures: times, stored activity, low-dimensional streams; no frame."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from exumi_data.episode import Episode, StreamView
from exumi_data.model.streams import PoseStream, WrenchStream
from exumi_data.stats.episode import active_above
from exumi_data.stats.html.blocks import step_of, valid_blocks
from exumi_data.stats.html.figures import (
    STEPS,
    ClockFigures,
    EpisodeFigures,
    PoseFigures,
    TouchFigures,
    ValueFigures,
)
from exumi_data.stats.html.sound_figures import read_sound
from exumi_data.stats.html.taxel_figures import grid_of, read_taxels

__all__ = ["even", "read_figures"]

_MOST_CELLS = 2_000  # a pose beyond 20 m is counted at the edge
_MOST_BINS = 20_000
_MOST_COMPONENTS = 12
_CELL_M = 0.01
_TILT_DEG = 5
_STEP_OF = {"width": 0.0001, "opening": 0.001, "f": 0.02, "t": 0.001}

Floats = npt.NDArray[np.float64]


def read_figures(episode: Episode) -> EpisodeFigures:
    """Read what the page shows of an episode.

    Parameters
    ----------
    episode : Episode

    Returns
    -------
    EpisodeFigures

    Raises
    ------
    DamagedDataError
        An array is missing or damaged.
    """
    meta, notes = episode.metadata, episode.metadata.annotations
    streams = list(episode.streams.values())
    start, end = _span(streams)
    labels = (notes.labels if notes else None) or []
    taxels, large = [], []
    for stream in episode.of_kind("taxels"):
        found = read_taxels(stream, (start, end))
        if found is None:
            large.append((stream.name, grid_of(stream)))
        else:
            taxels.append(found)
    return EpisodeFigures(
        id=episode.id,
        duration_s=(end - start) * 1e-9,
        regime=meta.regime,
        task=meta.task.name,
        instruction=meta.task.instruction,
        object_id=notes.object_id if notes else None,
        part_id=notes.part_id if notes else None,
        operator=meta.operator,
        site=meta.site,
        device=meta.device.name if meta.device else None,
        embodiment=meta.embodiment.name if meta.embodiment else None,
        sensors={s.name: s.metadata.sensor.model for s in streams if s.metadata.sensor},
        kinds={s.name: s.kind for s in streams},
        touches=tuple(_touch(episode, s, start, end) for s in episode.of_kind("tactile")),
        clocks=tuple(_clock(stream) for stream in streams),
        values=tuple(v for s in streams for v in _values(episode, s)),
        poses=tuple(_pose(stream) for stream in episode.of_kind("pose")),
        taxels=tuple(taxels),
        large_taxels=tuple(large),
        sounds=tuple(read_sound(stream, (start, end)) for stream in episode.of_kind("audio")),
        numbers=tuple(
            (label.property, float(label.value))
            for label in labels
            if isinstance(label.value, int | float)
        ),
    )


def even(count: int, wanted: int) -> npt.NDArray[np.int64]:
    """Return evenly spread positions among `count`, at most `wanted`, ascending.

    Parameters
    ----------
    count, wanted : int

    Returns
    -------
    (min(count, wanted),) int64
    """
    if count <= wanted:
        return np.arange(count, dtype=np.int64)
    return ((2 * np.arange(wanted, dtype=np.int64) + 1) * count) // (2 * wanted)


def _span(streams: list[StreamView]) -> tuple[int, int]:
    there = [stream for stream in streams if len(stream)]
    if not there:
        return 0, 0
    begins = [int(stream.rows("time", 0, 1)[0]) for stream in there]
    ends = [int(stream.rows("time", len(stream) - 1, len(stream))[0]) for stream in there]
    return min(begins), max(ends)


def _touch(episode: Episode, stream: StreamView, start: int, end: int) -> TouchFigures:
    activity = stream.activity
    frames = active = np.zeros(STEPS, np.int64)
    peak = 0.0
    if activity is not None and len(activity):
        step = step_of(stream.time, (start, end), STEPS)
        frames = np.bincount(step, minlength=STEPS)
        above = activity > active_above(episode, stream.name)
        active = np.bincount(step[above], minlength=STEPS)
        peak = float(np.nan_to_num(activity).max())
    return TouchFigures(
        stream=stream.name,
        measured=activity is not None,
        has_reference="reference" in stream.metadata.arrays,
        frames=tuple(frames.tolist()),
        active=tuple(active.tolist()),
        peak=peak,
    )


def _clock(stream: StreamView) -> ClockFigures:
    clock = stream.metadata.clock
    return ClockFigures(
        stream=stream.name,
        source=clock.source,
        stamp_point=clock.stamp_point,
        latency_ns=clock.latency_ns,
        latency_sigma_ns=clock.latency_sigma_ns,
        offset_sigma_ns=clock.offset_sigma_ns,
        drift_ppm=clock.drift_ppm,
        method=clock.method,
    )


def _values(episode: Episode, stream: StreamView) -> Iterator[ValueFigures]:
    model = stream.metadata
    if stream.kind == "width":
        body = episode.metadata.embodiment
        turns = body is not None and body.gripper == "angular"
        names, unit = ["opening" if turns else "width"], "rad" if turns else "m"
    elif isinstance(model, WrenchStream):
        names, unit = model.components[:_MOST_COMPONENTS], ""
    else:
        return
    counts: list[dict[int, int]] = [{} for _ in names]
    steps = np.array([_STEP_OF.get(name) or _STEP_OF[name[0]] for name in names])
    left_out = [0] * len(names)
    for _, data, valid in valid_blocks(stream):
        table = data.reshape(len(data), -1)[:, : len(names)]
        for column in range(table.shape[1]):
            kept = table[valid & np.isfinite(table[:, column]), column]
            left_out[column] += len(table) - len(kept)
            _count(counts[column], _bins(kept, float(steps[column])))
    for name, found, step, without in zip(names, counts, steps, left_out, strict=True):
        yield ValueFigures(
            stream=stream.name,
            component=name,
            kind=stream.kind,
            unit=unit or ("N·m" if name.startswith("t") else "N"),
            step=float(step),
            counts=found,
            left_out=without,
        )


def _bins(values: Floats, step: float) -> npt.NDArray[np.int64]:
    # To the nearest: a median is then off by half a step at most, and round numbers stay round.
    return np.clip(np.round(values / step), -_MOST_BINS, _MOST_BINS).astype(np.int64)


def _count(counts: dict[int, int], bins: npt.NDArray[np.int64]) -> None:
    for value, count in zip(*(a.tolist() for a in np.unique_counts(bins)), strict=True):
        counts[value] = counts.get(value, 0) + count


def _pose(stream: StreamView) -> PoseFigures:
    model = stream.metadata
    assert isinstance(model, PoseStream)  # noqa: S101  # by its kind
    above: dict[tuple[int, int], int] = {}
    side: dict[tuple[int, int], int] = {}
    tilts: dict[int, int] = {}
    low, high = np.full(4, np.inf), np.full(4, -np.inf)  # of x, y, z and the tilt
    left_out = 0
    for _, data, valid in valid_blocks(stream):
        kept = data[valid & np.isfinite(data).all(axis=1)]
        left_out += len(data) - len(kept)
        cells = np.clip(np.floor(kept[:, :3] / _CELL_M), -_MOST_CELLS, _MOST_CELLS)
        for found, columns in ((above, [0, 1]), (side, [0, 2])):
            places, counts = np.unique(cells[:, columns].astype(int), axis=0, return_counts=True)
            for (a, b), count in zip(places.tolist(), counts.tolist(), strict=True):
                found[a, b] = found.get((a, b), 0) + count
        tilt = _tilt_deg(kept)
        _count(tilts, (tilt // _TILT_DEG).astype(np.int64))
        exact = np.column_stack([kept[:, :3], tilt])
        low = np.minimum(low, exact.min(axis=0, initial=np.inf))
        high = np.maximum(high, exact.max(axis=0, initial=-np.inf))
    ends = (low.tolist(), high.tolist()) if tilts else ([], [])
    return PoseFigures(
        stream=stream.name,
        parent=model.frames.parent,
        child=model.frames.child,
        from_above=above,
        from_side=side,
        low=tuple(ends[0][:3]),
        high=tuple(ends[1][:3]),
        tilts=tilts,
        tilt_ends=(*ends[0][3:], *ends[1][3:]),
        left_out=left_out,
    )


def _tilt_deg(poses: Floats) -> Floats:
    """Return the angles between the z axes of both reference frames, (N,) degrees below 180."""
    x, y = poses[:, 3], poses[:, 4]
    cosine = np.clip(1 - 2 * (x * x + y * y), -1, 1)  # of a rotation matrix, its last entry
    return np.asarray(np.minimum(np.degrees(np.arccos(cosine)), 179.999))
