"""The common timeline of each episode: a view computed from timestamps, never stored as pixels.

For every tick: which frame of each image stream is nearest, the interpolated pose and width, and
whether each of these is valid. All episodes lie end to end in flat arrays, which are cached in the
user's cache folder, keyed by the catalog's content and the settings.
"""

import json
import os
import shutil
import tempfile
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.dataset import Dataset
from exumi_data.engine import map_items
from exumi_data.episode import Episode, StreamView, open_episode
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.geometry import interpolate_linear, interpolate_poses
from exumi_data.ticks import DEFAULT_TICK_S, image_tolerance_ns, max_gap_ns, tick_times_ns
from exumi_data.time import nearest_indices

__all__ = ["Layout", "Timeline", "TimelineSettings", "build_timeline"]

_VERSION = 1
_FIRST_STEP, _LAST_STEP = -15, 16
_FUTURE_STEPS = (4, 8, 12, 16)
_MANY_EPISODES = 2000


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
    active_above : float
        A tactile frame is active above this activity (format.md: 10⁻³ on one finger's image).
    """

    tick_s: Fraction = DEFAULT_TICK_S
    image_tolerance_s: float | None = None
    max_gap_s: float | None = None
    active_above: float = 1e-3

    def __post_init__(self) -> None:
        """Check the values."""
        if not 0 < self.tick_s <= 10:  # a tick of ten seconds is a mistake
            raise UsageError(f"tick_s is {float(self.tick_s)}, not in (0, 10] seconds")
        for name in ("image_tolerance_s", "max_gap_s"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise UsageError(f"{name} is {value}, not positive")

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
class Layout:
    """Which streams windows are made of, and how their frames look: the same in all episodes.

    Attributes
    ----------
    tactile, rgb : tuple of str
        Image streams.
    pose, width : str or None
    shapes : dict of str to tuple
        (H, W, C) of each image stream.
    references : dict of str to bool
        Whether each tactile stream has a reference image in all episodes.
    """

    tactile: tuple[str, ...]
    rgb: tuple[str, ...]
    pose: str | None
    width: str | None
    shapes: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    references: dict[str, bool] = field(default_factory=dict)

    @property
    def images(self) -> tuple[str, ...]:
        """All image streams."""
        return self.tactile + self.rgb

    @property
    def streams(self) -> tuple[str, ...]:
        """All streams."""
        return self.images + tuple(name for name in (self.pose, self.width) if name)


@dataclass(frozen=True)
class _EpisodeTimeline:
    start_ns: int
    ticks: int
    frame: dict[str, np.ndarray]
    low: dict[str, np.ndarray]
    valid: dict[str, np.ndarray]
    active_all: np.ndarray | None
    active_future: np.ndarray | None
    shapes: dict[str, tuple[int, int, int]]
    references: dict[str, bool]
    encodings: dict[str, str]


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

    @property
    def ticks(self) -> int:
        """Number of ticks in all episodes."""
        return int(self.edges[-1])

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


def choose_layout(
    dataset: Dataset,
    *,
    tactile: tuple[str, ...] | None = None,
    rgb: tuple[str, ...] | None = None,
    pose: str | None = None,
    width: str | None = None,
) -> Layout:
    """Choose the streams: those named, or all of their kind that every episode has.

    Raises
    ------
    UsageError
        A stream is missing in some episodes, or there is a choice to make.
    """
    if not len(dataset):
        raise UsageError("the selection holds no episodes", where=dataset.path)
    names: dict[str, dict[str, int]] = {"tactile": {}, "rgb": {}, "pose": {}, "width": {}}
    for row in dataset.catalog.column("streams").to_pylist():
        for stream in row:
            if stream["kind"] in names:
                kind = names[stream["kind"]]
                kind[stream["name"]] = kind.get(stream["name"], 0) + 1

    def chosen(kind: str, wanted: tuple[str, ...] | None) -> tuple[str, ...]:
        there = names[kind]
        found = tuple(sorted(there)) if wanted is None else wanted
        for name in found:
            if there.get(name, 0) != len(dataset):
                raise UsageError(
                    f"{there.get(name, 0)} of {len(dataset)} episodes have a {kind} stream "
                    f"{name!r}",
                    where=dataset.path,
                    fix=f"Name the streams to use ({kind}=...), or select episodes that have it: "
                    f"dataset.select(stream={name!r}).",
                )
        return found

    def single(kind: str, wanted: str | None) -> str | None:
        found = chosen(kind, None if wanted is None else (wanted,))
        if len(found) > 1:
            raise UsageError(
                f"there are {len(found)} {kind} streams: {', '.join(found)}",
                where=dataset.path,
                fix=f"Name the one to use: {kind}={found[0]!r}.",
            )
        return found[0] if found else None

    layout = Layout(
        chosen("tactile", tactile),
        chosen("rgb", rgb),
        single("pose", pose),
        single("width", width),
    )
    if not layout.images:
        raise UsageError("no tactile and no rgb stream to make windows of", where=dataset.path)
    return layout


def _episode_timeline(path: str, *, layout: Layout, settings: TimelineSettings) -> _EpisodeTimeline:
    with open_episode(path) as episode:
        return _compute(episode, layout, settings)


def _compute(episode: Episode, layout: Layout, settings: TimelineSettings) -> _EpisodeTimeline:
    streams = {name: episode[name] for name in layout.streams}
    times = {name: stream.time for name, stream in streams.items()}
    start, ticks = _span(times, settings.tick_s)
    at = start + tick_times_ns(np.arange(ticks), settings.tick_s)
    frame = {
        name: nearest_indices(times[name], at, settings.tolerance_ns(times[name]))
        for name in layout.images
    }
    low: dict[str, np.ndarray] = {}
    valid: dict[str, np.ndarray] = {}
    for name in (layout.pose, layout.width):
        if name is not None:
            low[name], valid[name] = _low_dimensional(streams[name], times[name], at, settings)
    tactile = [streams[name] for name in layout.tactile]
    active = _activity(tactile, times, at, frame, settings)
    return _EpisodeTimeline(
        start,
        ticks,
        frame,
        low,
        valid,
        *active,
        {name: _shape(streams[name]) for name in layout.images},
        {name: "reference" in streams[name].metadata.arrays for name in layout.tactile},
        {name: streams[name].metadata.images.encoding for name in layout.images},  # type: ignore[attr-defined]  # image kinds
    )


def _shape(stream: StreamView) -> tuple[int, int, int]:
    images = stream.metadata.images  # type: ignore[attr-defined]  # image kinds
    return (images.height, images.width, images.channels)


def _span(times: dict[str, np.ndarray], tick_s: Fraction) -> tuple[int, int]:
    """Return first tick and number of ticks: where all streams overlap."""
    if any(len(time) == 0 for time in times.values()):
        return 0, 0
    start = max(int(time[0]) for time in times.values())
    end = min(int(time[-1]) for time in times.values())
    if end < start:
        return 0, 0
    return start, int(Fraction(end - start, 1_000_000_000) / tick_s) + 1


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
    tactile: list[StreamView],
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
    span = tick_times_ns(np.array([-_FIRST_STEP, _LAST_STEP]), settings.tick_s)
    ahead = np.minimum(np.arange(len(at))[:, None] + _FUTURE_STEPS, max(len(at) - 1, 0))
    for stream in tactile:
        activity = stream.activity
        if activity is None:
            return None, None
        active = activity > settings.active_above
        if len(active) != len(times[stream.name]):
            raise DamagedDataError(
                f"activity of {stream.name} has {len(active)} values, the stream "
                f"{len(times[stream.name])} frames",
                where=stream,
            )
        before = np.concatenate(([0], np.cumsum(active)))
        first = np.searchsorted(times[stream.name], at - span[0] - half, side="left")
        last = np.searchsorted(times[stream.name], at + span[1] + half, side="right")
        everywhere |= before[last] > before[first]
        if len(at):
            at_step = frame[stream.name][ahead]
            future |= (active[at_step] & (at_step >= 0)).any(axis=1)
    return everywhere, future


def build_timeline(
    dataset: Dataset,
    layout: Layout,
    settings: TimelineSettings,
    *,
    cache: Path | None = None,
    workers: int | None = None,
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

    Raises
    ------
    UsageError
        Frames of a stream differ in size between episodes.
    """
    folder = None if cache is None else cache / _key(dataset, layout, settings)
    if folder is not None:
        cached = _load(folder, settings)
        if cached is not None:
            return cached
    locations = [dataset.episode_location(index) for index in range(len(dataset))]
    made: dict[str, _EpisodeTimeline] = {}
    function = partial(_episode_timeline, layout=layout, settings=settings)
    few = len(locations) < _MANY_EPISODES
    for outcome in map_items(function, locations, workers=1 if few else workers):
        if outcome.value is None:
            assert outcome.error is not None  # noqa: S101  # an outcome has one of the two
            raise outcome.error
        made[outcome.item] = outcome.value
    timeline = _join(dataset, [made[path] for path in locations], layout, settings)
    if folder is not None:
        _save(timeline, folder)
    return timeline


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
    references = {name: all(part.references[name] for part in parts) for name in layout.tactile}
    encodings = {}
    for name in layout.images:
        found = {part.encodings[name] for part in parts}
        encodings[name] = found.pop() if len(found) == 1 else "mixed"

    def joined(values: list[np.ndarray | None]) -> np.ndarray | None:
        there = [value for value in values if value is not None]
        return np.concatenate(there) if len(there) == len(values) else None

    low = [name for name in (layout.pose, layout.width) if name is not None]
    return Timeline(
        Layout(layout.tactile, layout.rgb, layout.pose, layout.width, first.shapes, references),
        settings,
        np.concatenate(([0], np.cumsum([part.ticks for part in parts]))).astype(np.int64),
        np.array([part.start_ns for part in parts], dtype=np.int64),
        {name: np.concatenate([part.frame[name] for part in parts]) for name in layout.images},
        {name: np.concatenate([part.low[name] for part in parts]) for name in low},
        {name: np.concatenate([part.valid[name] for part in parts]) for name in low},
        joined([part.active_all for part in parts]),
        joined([part.active_future for part in parts]),
        encodings,
    )


# The cache: one folder of plain .npy files and a small JSON document.


def default_cache() -> Path:
    """Return the cache folder: ``$EXUMI_CACHE``, or the user's own cache folder."""
    import platformdirs  # used here alone

    chosen = os.environ.get("EXUMI_CACHE")
    base = Path(chosen) if chosen else platformdirs.user_cache_path("exumi-data", appauthor=False)
    return base / "windows"


def _key(dataset: Dataset, layout: Layout, settings: TimelineSettings) -> str:
    document = {
        "version": _VERSION,
        "dataset": dataset.fingerprint,
        "streams": [layout.tactile, layout.rgb, layout.pose, layout.width],
        "settings": {key: str(value) for key, value in asdict(settings).items()},
    }
    return sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:40]


def _save(timeline: Timeline, folder: Path) -> None:
    arrays: dict[str, np.ndarray] = {"edges": timeline.edges, "start_ns": timeline.start_ns}
    for group in ("frame", "low", "valid"):
        arrays |= {f"{group}.{k}": v for k, v in getattr(timeline, group).items()}
    if timeline.active_all is not None and timeline.active_future is not None:
        arrays["active_all"] = timeline.active_all
        arrays["active_future"] = timeline.active_future
    layout = timeline.layout
    document = {"layout": asdict(layout), "encodings": timeline.encodings, "arrays": list(arrays)}
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".partial-", dir=folder.parent))
    except OSError:
        return  # a cache that cannot be written is no reason to stop
    try:
        for name, array in arrays.items():
            np.save(temporary / f"{name}.npy", array, allow_pickle=False)
        (temporary / "timeline.json").write_text(json.dumps(document))
        temporary.rename(folder)
    except OSError:
        shutil.rmtree(temporary, ignore_errors=True)  # another process was first, or no space


def _load(folder: Path, settings: TimelineSettings) -> Timeline | None:
    try:
        document: dict[str, Any] = json.loads((folder / "timeline.json").read_text())
        arrays = {
            name: np.load(folder / f"{name}.npy", mmap_mode="r", allow_pickle=False)
            for name in document["arrays"]
        }
        made = document["layout"]
        layout = Layout(
            tuple(made["tactile"]),
            tuple(made["rgb"]),
            made["pose"],
            made["width"],
            {name: tuple(shape) for name, shape in made["shapes"].items()},
            made["references"],
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None  # not there, or not whole: computed anew

    def group(prefix: str) -> dict[str, np.ndarray]:
        return {
            name.removeprefix(f"{prefix}."): array
            for name, array in arrays.items()
            if name.startswith(f"{prefix}.")
        }

    return Timeline(
        layout,
        settings,
        arrays["edges"],
        arrays["start_ns"],
        group("frame"),
        group("low"),
        group("valid"),
        arrays.get("active_all"),
        arrays.get("active_future"),
        document["encodings"],
    )
