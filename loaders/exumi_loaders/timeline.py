"""The common timeline of each episode: a view computed from timestamps, never stored as pixels.

For every tick: which frame of each image stream is nearest, the interpolated pose and width, and
whether each of these is valid. All episodes lie end to end in flat arrays, which are cached in the
user's cache folder, keyed by the catalog's content and the settings.
"""

from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exumi_data.dataset import Dataset
from exumi_data.engine import Engine, map_items, warm_up
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import MetadataError, UsageError
from exumi_data.geometry import interpolate_linear, interpolate_poses
from exumi_data.store.access import open_stores
from exumi_data.tactile.activity import ACTIVE_THRESHOLD
from exumi_data.ticks import DEFAULT_TICK_S, image_tolerance_ns, max_gap_ns, tick_times_ns
from exumi_data.time import nearest_indices
from exumi_loaders.at_hand import Observed, at_hand, first_instant_ns, observation_times_ns
from exumi_loaders.calibration import calibration_digest
from exumi_loaders.layout import Layout
from exumi_loaders.timeline_cache import cache_key, load_timeline, save_timeline

if TYPE_CHECKING:
    from exumi_data.store.remote.reading import Identity

__all__ = ["Timeline", "TimelineSettings", "build_timeline"]

_MANY_EPISODES = 2000
_PIECE = 32
"""Episodes that are sent to a worker at once: to send one costs as much as to read it."""


@dataclass(frozen=True)
class TimelineSettings:
    """How streams are put on a common timeline.

    Attributes
    ----------
    tick_s : fractions.Fraction
        Distance of two ticks. Default 3/59.94 s.
    image_tolerance_s : float or None
        How far the nearest frame may be from a tick. Default: one tick, or 0.6 of the stream's
        median frame interval if that is longer (so that 10 fps streams work).
    max_gap_s : float or None
        Longest stretch that poses and widths are interpolated over. Default: 0.1 s, or 2.5 median
        sample intervals if that is longer.
    active_above : float or None
        A tactile frame is active above this activity. Default: what is stored with the activity
        of each stream (10⁻³ on one finger's image, 5·10⁻⁴ on both fingers' combined one).
    span : (int, int)
        First and last step of a window, in ticks around its step 0: any active frame between
        them makes the window active (`Timeline.active_all`).
    future_steps : tuple of int
        The steps whose frames make a window active by `Timeline.active_future`.
    observed : Observed or None
        What a policy has at hand at each tick, with which latencies; None does not compute it.
    """

    tick_s: Fraction = DEFAULT_TICK_S
    image_tolerance_s: float | None = None
    max_gap_s: float | None = None
    active_above: float | None = None
    span: tuple[int, int] = (-15, 16)
    future_steps: tuple[int, ...] = (4, 8, 12, 16)
    observed: Observed | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if not 0 < self.tick_s <= 10:  # a tick of ten seconds is a mistake
            raise UsageError(f"tick_s is {float(self.tick_s)}, not in (0, 10] seconds")
        for name in ("image_tolerance_s", "max_gap_s"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise UsageError(f"{name} is {value}, not positive")
        if not self.span[0] <= 0 <= self.span[1]:
            raise UsageError(f"a window's span is {self.span}, which step 0 is not in")

    def tolerance_ns(self, time_ns: np.ndarray) -> int:
        """Return the image tolerance for a stream, nanoseconds.

        Parameters
        ----------
        time_ns : (N,) int64
            The stream's times.
        """
        if self.image_tolerance_s is not None:
            return round(self.image_tolerance_s * 1e9)
        return image_tolerance_ns(time_ns, self.tick_s)

    def gap_ns(self, time_ns: np.ndarray) -> int:
        """Return the longest interpolated stretch for a stream, nanoseconds.

        Parameters
        ----------
        time_ns : (N,) int64
            The stream's times.
        """
        if self.max_gap_s is not None:
            return round(self.max_gap_s * 1e9)
        return max_gap_ns(time_ns)


@dataclass(frozen=True)
class _Seen:
    """What is at hand at each tick of an episode; see `Timeline`."""

    frame: dict[str, np.ndarray] = field(default_factory=dict)
    low: dict[str, np.ndarray] = field(default_factory=dict)
    valid: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class _EpisodeTimeline:
    start_ns: int
    ticks: int
    frame: dict[str, np.ndarray]
    low: dict[str, np.ndarray]
    valid: dict[str, np.ndarray]
    seen: _Seen
    active_all: np.ndarray | None
    active_future: np.ndarray | None
    shapes: dict[str, tuple[int, int, int]]
    references: dict[str, bool]
    encodings: dict[str, str]
    children: dict[str, str]
    parents: dict[str, str]
    calibrations: dict[str, str]
    root: np.ndarray
    identity: "Identity | None"


@dataclass(frozen=True)
class Timeline:
    """The common timelines of all episodes, end to end.

    Attributes
    ----------
    layout : Layout
    edges : (E+1,) int64
        Ticks of episode e are ``edges[e]:edges[e+1]``.
    start_ns : (E,) int64
        Time of each episode's first tick, since the episode's start.
    frame : dict of str to (T,) int32
        Nearest frame of each image stream; -1 beyond the tolerance.
    low : dict of str to (T, 7) float64 or (T,) float32
        Interpolated pose (x y z qx qy qz qw) and width (m).
    valid : dict of str to (T,) bool
        Where `low` is not beyond a gap.
    active_all, active_future : (T,) bool or None
        Whether the window around each tick is active; None without stored activity.
    encodings : dict of str to str
        How each image stream is stored: ``encoded``, ``array``, ``video`` or ``mixed``.
    roots : (E, 32) uint8
        SHA-256 of each episode's root document, as it was read for the timeline: another one
        belongs to another revision.
    seen_frame : dict of str to (T, n) int32
        Of each image stream the newest frame at hand at each of the n observed steps of a window
        around each tick; -1 where it is stale. Empty unless ``settings.observed`` is given, as
        are the next two.
    seen_low : dict of str to (T, n, 7) float64 or (T, n) float32
        Of each pose and width stream the newest sample at hand.
    seen_valid : dict of str to (T, n) bool
        Whether `seen_low` is not stale.
    identities : dict of str to Identity
        Of remote episodes, by location, which objects were read for the timeline. Empty where it
        comes from the cache.
    """

    layout: Layout
    settings: TimelineSettings
    edges: np.ndarray
    start_ns: np.ndarray
    frame: dict[str, np.ndarray]
    low: dict[str, np.ndarray]
    valid: dict[str, np.ndarray]
    active_all: np.ndarray | None
    active_future: np.ndarray | None
    encodings: dict[str, str]
    roots: np.ndarray
    seen_frame: dict[str, np.ndarray] = field(default_factory=dict)
    seen_low: dict[str, np.ndarray] = field(default_factory=dict)
    seen_valid: dict[str, np.ndarray] = field(default_factory=dict)
    identities: "dict[str, Identity]" = field(default_factory=dict, kw_only=True)

    @property
    def ticks(self) -> int:
        """Number of ticks in all episodes."""
        return int(self.edges[-1])

    def motion(self, ticks: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return all poses and widths at some ticks.

        Parameters
        ----------
        ticks : (B, S) int64
            Flat ticks.

        Returns
        -------
        values : dict of str to (B, S, 7) float64 or (B, S) float32
        valid : (B, S) bool
            Whether all of them are measured there.
        """
        values = {name: np.asarray(self.low[name])[ticks] for name in self.layout.low}
        valid = np.ones(ticks.shape, dtype=bool)
        for name in self.layout.low:
            valid &= self.valid[name][ticks]
        return values, valid

    def tick_offset_ns(self, tick: np.ndarray) -> np.ndarray:
        """Return how long after its episode's first tick each tick lies.

        Parameters
        ----------
        tick : (M,) int64
            Ticks counted from their episode's first.

        Returns
        -------
        (M,) int64
            Nanoseconds.
        """
        return tick_times_ns(tick, self.settings.tick_s)


def _compute(episode: Episode, layout: Layout, settings: TimelineSettings) -> _EpisodeTimeline:
    streams = {name: episode[name] for name in layout.streams}
    times = {name: stream.time for name, stream in streams.items()}
    start, ticks = _span(times, settings)
    at = start + tick_times_ns(np.arange(ticks), settings.tick_s)
    frame = {
        name: nearest_indices(times[name], at, settings.tolerance_ns(times[name]))
        for name in layout.images
    }
    low: dict[str, np.ndarray] = {}
    valid: dict[str, np.ndarray] = {}
    for name in layout.low:
        low[name], valid[name] = _low_dimensional(streams[name], times[name], at, settings)
    active = _activity(episode, layout.tactile, times, at, frame, settings)
    frames = {name: streams[name].metadata.frames for name in layout.pose}  # type: ignore[attr-defined]  # pose streams
    return _EpisodeTimeline(
        start,
        ticks,
        frame,
        low,
        valid,
        _seen(streams, times, at, settings),
        *active,
        {name: _shape(streams[name]) for name in layout.images},
        {name: "reference" in streams[name].metadata.arrays for name in layout.tactile},
        {name: streams[name].metadata.images.encoding for name in layout.images},  # type: ignore[attr-defined]  # image kinds
        {name: pair.child for name, pair in frames.items()},
        {name: pair.parent for name, pair in frames.items()},
        {name: calibration_digest(episode, name) for name in layout.images + layout.pose},
        np.frombuffer(bytes.fromhex(episode.root_sha256), dtype=np.uint8),
        episode.store.identity,
    )


def _shape(stream: StreamView) -> tuple[int, int, int]:
    images = stream.metadata.images  # type: ignore[attr-defined]  # image kinds
    return (images.height, images.width, images.channels)


def _span(times: dict[str, np.ndarray], settings: TimelineSettings) -> tuple[int, int]:
    """Return first tick and number of ticks: where all streams overlap, and are at hand."""
    if any(len(time) == 0 for time in times.values()):
        return 0, 0
    latency = dict.fromkeys(times, 0)
    if settings.observed is not None:
        latency |= settings.observed.latency_ns
    start = first_instant_ns({name: int(time[0]) for name, time in times.items()}, latency)
    end = min(int(time[-1]) for time in times.values())
    if end < start:
        return 0, 0
    return start, int(Fraction(end - start, 1_000_000_000) / settings.tick_s) + 1


def _seen(
    streams: dict[str, StreamView],
    times: dict[str, np.ndarray],
    at: np.ndarray,
    settings: TimelineSettings,
) -> _Seen:
    """Return what is at hand at the observed steps around each tick."""
    seen, observed = _Seen(), settings.observed
    if observed is None:
        return seen
    start = int(at[0]) if len(at) else 0
    wanted, _ = observation_times_ns(at, observed.steps, settings.tick_s, start)
    for name, stream in streams.items():
        index, fresh = at_hand(
            times[name], wanted, observed.latency_ns[name], observed.stale_ns[name]
        )
        if stream.is_image:
            seen.frame[name] = np.where(fresh, index, -1).astype(np.int32)
        else:
            dtype = np.float64 if stream.kind == "pose" else np.float32
            seen.low[name] = stream.data[index].astype(dtype)
            seen.valid[name] = fresh
    return seen


def _low_dimensional(
    stream: StreamView, time: np.ndarray, at: np.ndarray, settings: TimelineSettings
) -> tuple[np.ndarray, np.ndarray]:
    gap = settings.gap_ns(time)
    if not len(at):
        shape = (0, 7) if stream.kind == "pose" else (0,)
        return np.zeros(shape), np.zeros(0, dtype=bool)
    if stream.kind == "pose":
        return interpolate_poses(time, stream.data, at, gap)
    values, valid = interpolate_linear(time, stream.data, at, gap)
    return values.astype(np.float32), valid


def _activity(
    episode: Episode,
    tactile: tuple[str, ...],
    times: dict[str, np.ndarray],
    at: np.ndarray,
    frame: dict[str, np.ndarray],
    settings: TimelineSettings,
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return for each tick whether its window is active, by modes ``all`` and ``future``."""
    if not tactile:
        return None, None
    everywhere = np.zeros(len(at), dtype=bool)
    future = np.zeros(len(at), dtype=bool)
    half = int(settings.tick_s * 500_000_000)
    # Ticks are counted from 0: the time before step 0 is the time of as many steps after it.
    before, after = tick_times_ns(np.abs(np.array(settings.span)), settings.tick_s)
    ahead = np.arange(len(at))[:, None] + np.array(settings.future_steps, dtype=np.int64)
    ahead = np.clip(ahead, 0, max(len(at) - 1, 0))
    for name in tactile:
        active = _active_frames(episode, name, settings.active_above)
        if active is None:
            return None, None
        time = times[name]
        counted = np.concatenate(([0], np.cumsum(active)))
        first = np.searchsorted(time, at - before - half, side="left")
        last = np.searchsorted(time, at + after + half, side="right")
        everywhere |= counted[last] > counted[first]
        if len(at):
            at_step = frame[name][ahead]
            future |= (active[at_step] & (at_step >= 0)).any(axis=1)
    return everywhere, future


def _active_frames(episode: Episode, name: str, active_above: float | None) -> np.ndarray | None:
    """Return which frames of a tactile stream are active, or None without stored activity."""
    activity = episode[name].activity
    if activity is None or episode.derived is None:
        return None
    if active_above is None:
        item = episode.derived.items[f"{name}/activity"]
        active_above = item.parameters.get("active_above", ACTIVE_THRESHOLD)
        if isinstance(active_above, bool) or not isinstance(active_above, int | float):
            raise MetadataError(
                f"active_above of {name}/activity is {active_above!r}, not a number",
                where=f"{episode.path}/derived",
            )
    return np.asarray(activity > active_above)


def build_timeline(
    dataset: Dataset,
    layout: Layout,
    settings: TimelineSettings,
    *,
    cache: Path | None = None,
    workers: int | None = None,
    engine: Engine | None = None,
) -> Timeline:
    """Compute the timelines of all episodes, or take them from the cache.

    Parameters
    ----------
    dataset : Dataset
    layout : Layout
    settings : TimelineSettings
    cache : pathlib.Path, optional
        Folder of the cache; None neither reads nor writes one.
    workers : int, optional
        Processes, used for thousands of episodes.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.

    Raises
    ------
    UsageError
        Frames of a stream differ in size between episodes, or poses in their child frame.
    """
    folder = None if cache is None else cache / cache_key(dataset, layout, settings)
    if folder is not None:
        cached = load_timeline(folder, settings)
        if cached is not None:
            return cached
    locations = [dataset.episode_location(index) for index in range(len(dataset))]
    timeline = _join(
        dataset, _timelines(locations, layout, settings, workers, engine), layout, settings
    )
    if folder is not None:
        save_timeline(timeline, folder)
    return timeline


def _timelines(
    locations: list[str],
    layout: Layout,
    settings: TimelineSettings,
    workers: int | None,
    engine: Engine | None,
) -> list[_EpisodeTimeline]:
    """Compute the timelines of episodes, in their order; many of them in several processes."""
    if engine is None and len(locations) < _MANY_EPISODES:
        workers = 1
    warm_up(__name__, workers=workers, engine=engine)
    pieces = [tuple(locations[at : at + _PIECE]) for at in range(0, len(locations), _PIECE)]
    made: dict[tuple[str, ...], list[_EpisodeTimeline]] = {}
    function = partial(_piece, layout=layout, settings=settings)
    for outcome in map_items(function, pieces, workers=workers, engine=engine):
        if outcome.value is None:
            assert outcome.error is not None  # noqa: S101  # an outcome has one of the two
            raise outcome.error
        made[outcome.item] = outcome.value
    return [timeline for piece in pieces for timeline in made[piece]]


def _piece(
    paths: tuple[str, ...], *, layout: Layout, settings: TimelineSettings
) -> list[_EpisodeTimeline]:
    timelines = []
    for store in open_stores(paths):
        with Episode(store) as episode:
            timelines.append(_compute(episode, layout, settings))
    return timelines


def _join(
    dataset: Dataset,
    parts: list[_EpisodeTimeline],
    layout: Layout,
    settings: TimelineSettings,
) -> Timeline:
    first = parts[0]
    for index, part in enumerate(parts):
        for name, shape in part.shapes.items():
            if shape != first.shapes[name]:
                raise UsageError(
                    f"frames of {name} are {shape} in episode {dataset.ids[index]} and "
                    f"{first.shapes[name]} in {dataset.ids[0]} (height, width, channels)",
                    where=dataset.path,
                    fix="Make frames of one size first: exumi prepare SRC DST --size 224",
                )
        for name, child in part.children.items():
            if child != first.children[name]:
                raise UsageError(
                    f"{name} is the pose of {child!r} in episode {dataset.ids[index]} and of "
                    f"{first.children[name]!r} in {dataset.ids[0]}: their relative actions are "
                    "not the same thing",
                    where=dataset.path,
                    fix="Select episodes of one tool frame.",
                )
    references = {name: all(part.references[name] for part in parts) for name in layout.tactile}
    encodings = {}
    for name in layout.images:
        found = {part.encodings[name] for part in parts}
        encodings[name] = found.pop() if len(found) == 1 else "mixed"

    def joined(values: list[np.ndarray | None]) -> np.ndarray | None:
        there = [value for value in values if value is not None]
        return np.concatenate(there) if len(there) == len(values) else None

    identities = {
        dataset.episode_location(index): part.identity
        for index, part in enumerate(parts)
        if part.identity is not None
    }
    timeline = Timeline(
        replace(
            layout,
            shapes=first.shapes,
            references=references,
            children=first.children,
            parents=_first_with(dataset, [part.parents for part in parts]),
            calibrations=_first_with(dataset, [part.calibrations for part in parts]),
            common_parent=all(len(set(part.parents.values())) <= 1 for part in parts),
        ),
        settings,
        np.concatenate(([0], np.cumsum([part.ticks for part in parts]))).astype(np.int64),
        np.array([part.start_ns for part in parts], dtype=np.int64),
        {name: np.concatenate([part.frame[name] for part in parts]) for name in layout.images},
        {name: np.concatenate([part.low[name] for part in parts]) for name in layout.low},
        {name: np.concatenate([part.valid[name] for part in parts]) for name in layout.low},
        joined([part.active_all for part in parts]),
        joined([part.active_future for part in parts]),
        encodings,
        np.stack([part.root for part in parts]),
        *(
            {name: np.concatenate([seen[name] for seen in group]) for name in group[0]}
            for group in (
                [part.seen.frame for part in parts],
                [part.seen.low for part in parts],
                [part.seen.valid for part in parts],
            )
        ),
    )
    return replace(timeline, identities=identities)


def _first_with(dataset: Dataset, parts: list[dict[str, str]]) -> dict[str, dict[str, str]]:
    """Return of each stream every value that it has, and the first episode that has it."""
    found: dict[str, dict[str, str]] = {name: {} for name in parts[0]}
    for episode_id, part in zip(dataset.ids, parts, strict=True):
        for name, value in part.items():
            found[name].setdefault(value, episode_id)
    return found
