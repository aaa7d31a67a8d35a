"""What of an episode goes into a replay buffer, and at which times."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from typing import Any, Literal, NamedTuple

import numpy as np

from exumi_converters.prepared_combined import pairs_of
from exumi_converters.umi.channels import DIFFERENCES_KIND
from exumi_converters.umi.layout import TACTILE_COMBINED
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UsageError
from exumi_data.model.streams import images_of
from exumi_data.standard import flags
from exumi_data.store.shards import open_array
from exumi_data.ticks import image_tolerance_ns, max_gap_ns
from exumi_data.time import bracket_indices, nearest_indices, nominal_times

__all__ = ["Slots", "Span", "Timeline", "find_slots", "find_span", "good_samples", "tick_times"]

_NUMBERED = re.compile(r"(?:robot|camera)(\d{1,3})$")
_BREAK = 1.5  # periods: more is a hole in the timeline
_LEAST_ROWS = 2


@dataclass(frozen=True, slots=True)
class Slots:
    """Which stream goes where.

    Attributes
    ----------
    poses, widths, cameras : dict of str to str
        Number of the robot or camera to stream.
    tactile : dict of str to str
        ``left`` and ``right``; or ``combined``, with ``differences`` where they were kept. Empty:
        there is none.
    """

    poses: dict[str, str] = field(default_factory=dict)
    widths: dict[str, str] = field(default_factory=dict)
    cameras: dict[str, str] = field(default_factory=dict)
    tactile: dict[str, str] = field(default_factory=dict)

    @property
    def streams(self) -> list[str]:
        """Names of all streams."""
        return [n for group in asdict(self).values() for n in group.values()]

    @property
    def arrays(self) -> tuple[str, ...]:
        """Names of the arrays that they become, without poses' ends."""
        return (
            *(f"robot{number}" for number in self.poses),
            *(f"camera{number}_rgb" for number in self.cameras),
            *((TACTILE_COMBINED,) if self.tactile else ()),
        )

    def json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)


def find_slots(episode: Episode, *, tactile: bool) -> Slots:
    """Find what of an episode a buffer can hold.

    Parameters
    ----------
    episode : Episode
    tactile : bool
        Whether tactile images are wanted.

    Raises
    ------
    UsageError
        What every buffer has is missing.
    """
    poses = _numbered(episode.of_kind("pose"))
    widths = _numbered(episode.of_kind("width"))
    cameras = _numbered(episode.of_kind("rgb"))
    if not poses or not widths:
        missing = "pose" if not poses else "width of the gripper"
        raise UsageError(f"there is no {missing}, which every replay buffer has")
    if set(poses) != set(widths):
        raise UsageError(
            f"{len(poses)} pose(s) and {len(widths)} width(s) do not belong together by their "
            "names",
            fix="Name them pose_robot0, width_robot0 and so on.",
        )
    found = _tactile(episode) if tactile else {}
    if not cameras and not found:
        raise UsageError("there is no camera and no pair of tactile images")
    return Slots(poses, widths, cameras, found)


def _numbered(views: Sequence[StreamView]) -> dict[str, str]:
    """Return streams by number: that in their names, else their place."""
    names = sorted(view.name for view in views)
    matches = [_NUMBERED.search(name) for name in names]
    numbers = [int(match[1]) for match in matches if match]
    if len(set(numbers)) < len(names):
        numbers = list(range(len(names)))
    order = dict(sorted(zip(numbers, names, strict=True)))
    # A buffer counts from 0 without holes.
    return {str(place): name for place, name in enumerate(order.values())}


def _tactile(episode: Episode) -> dict[str, str]:
    views = {view.name: view for view in episode.of_kind("tactile")}
    for name, grey in views.items():
        if "combined" in name:
            kept = [
                view.name
                for view in episode.of_kind(DIFFERENCES_KIND)
                if _belongs(episode, view, grey)
            ]
            return {"combined": name, **({"differences": kept[0]} if kept else {})}
    try:
        pairs = pairs_of(episode)
    except UsageError:
        return {}
    return {"left": pairs[0].left.name, "right": pairs[0].right.name} if pairs else {}


def _belongs(episode: Episode, differences: StreamView, grey: StreamView) -> bool:
    """Whether concave and convex are of a grey image as it is now: not before it was resized."""
    if (differences.metadata.model_extra or {}).get("exumi:of") != grey.name:
        return False
    images = images_of(grey.metadata)
    shape = open_array(episode.store, f"streams/{differences.name}/data").shape
    return images is not None and shape[1:] == (images.height, images.width, 2)


class Timeline(NamedTuple):
    """The times of a buffer's rows.

    Attributes
    ----------
    kind : {"camera", "rate"}
        Those of the first camera's frames, or regular ones.
    rate : Fraction
        Of regular ones.
    """

    kind: str
    rate: Fraction


class Span(NamedTuple):
    """The rows that an episode gives.

    Attributes
    ----------
    first, stop : int
        Of the ticks.
    ticks : int
        All there are.
    runs : int
        Stretches without a hole.
    """

    first: int
    stop: int
    ticks: int
    runs: int


def good_samples(view: StreamView) -> np.ndarray:
    """Return which samples of a stream are not flagged invalid, (N,) bool."""
    if "flags" not in view.metadata.arrays:
        return np.ones(len(view), np.bool_)
    return np.asarray((view.array("flags") & flags()["invalid"].mask) == 0)


def tick_times(episode: Episode, slots: Slots, timeline: Timeline) -> np.ndarray:
    """Return the times of an episode's rows, before any are cut.

    Returns
    -------
    (M,) int64
    """
    if timeline.kind == "camera":
        lead = slots.cameras or slots.tactile
        return episode[next(iter(lead.values()))].time
    times = [episode[name].time for name in slots.streams]
    if not all(map(len, times)):
        return np.empty(0, np.int64)
    start, end = max(int(t[0]) for t in times), min(int(t[-1]) for t in times)
    count = int((end - start) * timeline.rate / 1_000_000_000) + 1
    return start + nominal_times(max(0, count), timeline.rate)


def find_span(
    episode: Episode, slots: Slots, timeline: Timeline, gaps: Literal["refuse", "longest"]
) -> Span:
    """Find the rows at which everything is known.

    Parameters
    ----------
    episode : Episode
    slots : Slots
    timeline : Timeline
    gaps : {"refuse", "longest"}

    Raises
    ------
    UsageError
        There are none, or there are holes between them.
    """
    ticks = tick_times(episode, slots, timeline)
    if len(ticks) < _LEAST_ROWS:
        raise UsageError("its streams have no two frames in common")
    usable = np.ones(len(ticks), np.bool_)
    causes: dict[str, int] = {}
    for name in slots.streams:
        here = _usable(episode[name], ticks, timeline)
        if not here.all():
            causes[name] = int(np.count_nonzero(~here))
        usable &= here
    runs = _runs(ticks, usable)
    if not runs:
        named = ", ".join(f"{name} at {count}" for name, count in causes.items())
        raise UsageError(f"there is no time at which all is known (unknown: {named})")
    if len(runs) > 1 and gaps == "refuse":
        raise UsageError(
            f"its rows have {len(runs) - 1} hole(s), where samples are missing or invalid: a "
            "replay buffer has no times, so they would be lost unseen",
            fix="Pass -o gaps=longest to write the longest stretch without one.",
        )
    first, stop = max(runs, key=lambda run: (run[1] - run[0], -run[0]))
    return Span(first, stop, len(ticks), len(runs))


def _runs(ticks: np.ndarray, usable: np.ndarray) -> list[tuple[int, int]]:
    """Return the stretches of usable ticks without a hole, two rows at least."""
    period = float(np.median(np.diff(ticks)))
    joined = usable[1:] & usable[:-1] & (np.diff(ticks) <= _BREAK * period)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], joined, [False])).astype(np.int8)))
    return [(int(a), int(b) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _usable(view: StreamView, ticks: np.ndarray, timeline: Timeline) -> np.ndarray:
    """Return at which ticks a stream has a value, (M,) bool."""
    good = good_samples(view)
    time = view.time[good]
    if not len(time):
        return np.zeros(len(ticks), np.bool_)
    if not (view.is_image or view.kind == DIFFERENCES_KIND):
        return bracket_indices(time, ticks, max_gap_ns(view.time)).valid
    return nearest_indices(time, ticks, tolerance_ns(view, ticks, timeline)) >= 0


def tolerance_ns(view: StreamView, ticks: np.ndarray, timeline: Timeline) -> int:
    """Return how far the frame that is nearest to a tick may be."""
    period = 1 / timeline.rate
    if timeline.kind == "camera":
        period = Fraction(max(1, int(np.median(np.diff(ticks)))), 1_000_000_000)
    return image_tolerance_ns(view.time, period)


def common_slots(found: Mapping[str, Slots]) -> tuple[str, ...]:
    """Return the arrays that most episodes have; of as many, the larger set.

    Parameters
    ----------
    found : mapping of str to Slots
        By episode.
    """
    counts: dict[tuple[str, ...], int] = {}
    for slots in found.values():
        counts[slots.arrays] = counts.get(slots.arrays, 0) + 1
    if not counts:
        return ()
    return max(counts, key=lambda arrays: (counts[arrays], len(arrays), arrays))
