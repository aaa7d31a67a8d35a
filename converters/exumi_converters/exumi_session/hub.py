"""What the hub recorded, put together from its chunks; what cannot be read is named."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from exumi_converters.exumi_session.layout import SIDES, Chunk, SessionFiles
from exumi_converters.exumi_session.tables import Readings, read_angles, read_stamps
from exumi_data.errors import SourceError
from exumi_data.synchronisation.sweep import PoseTrack
from exumi_data.time import strictly_increasing

__all__ = ["Hub", "PoseSession", "Problem", "StampedChunk", "join_readings", "read_hub", "usable"]

Int64Array = NDArray[np.int64]

_APART_NS = 6 * 3600 * 1_000_000_000
_LONGEST_NS = 48 * 3600 * 1_000_000_000


@dataclass(frozen=True, slots=True)
class Problem:
    """A file of the hub that was left out."""

    path: Path
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class StampedChunk:
    """A chunk, and its stamps.

    Attributes
    ----------
    chunk : Chunk
    time_ns : (N,) int64
        Unix times.
    """

    chunk: Chunk
    time_ns: Int64Array

    def holds(self, first_ns: int, last_ns: int) -> bool:
        """Whether any of it is of a stretch of time."""
        return bool(((self.time_ns >= first_ns) & (self.time_ns <= last_ns)).any())


@dataclass(slots=True)
class Hub:
    """The hub's part of a session.

    Attributes
    ----------
    readings : Readings
        All of them, in the order in which they were saved.
    angle_chunks : list of StampedChunk
    fingers : dict of str to list of StampedChunk
    problems : list of Problem
    repeated : list of pathlib.Path
        Chunks that hold again what others do.
    steps_back : int
        How often the hub's clock went back.
    far_away : int
        Readings whose stamps lie hours away from all others: the hub's clock was wrong then.
    """

    readings: Readings
    angle_chunks: list[StampedChunk] = field(default_factory=list)
    fingers: dict[str, list[StampedChunk]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    repeated: list[Path] = field(default_factory=list)
    steps_back: int = 0
    far_away: int = 0

    @property
    def span_ns(self) -> tuple[int, int]:
        """Unix times of the first and the last reading."""
        return int(self.readings.time_ns.min()), int(self.readings.time_ns.max())


def read_hub(files: SessionFiles) -> Hub:
    """Read all readings of a session, and the stamps of its frames; no frame is decoded.

    Parameters
    ----------
    files : SessionFiles

    Raises
    ------
    SourceError
        There is not one reading.
    """
    angles = _Chunks[Readings]()
    for chunk in files.chunks["angle"]:
        try:
            angles.take(chunk, read_angles(chunk.table))
        except SourceError as error:
            angles.problems.append(Problem(chunk.table, error.what))
    joined = join_readings([readings for _, readings in angles.kept])
    if not len(joined.time_ns):
        raise SourceError(
            "there is no reading of the hub: no poses to place clips by"
            + (f" ({angles.problems[0].reason})" if angles.problems else ""),
            where=files.root,
            fix="Copy the hub's folder tactile_<date>_<time> as a whole beside the videos.",
        )
    hub = Hub(joined, problems=angles.problems, repeated=angles.repeated)
    hub.steps_back = int(np.count_nonzero(np.diff(joined.time_ns) < 0))
    near = _of_one_time(joined.time_ns, files.root)
    hub.far_away = int(np.count_nonzero(~near))
    hub.readings = joined.part(near)
    hub.angle_chunks = [StampedChunk(chunk, found.time_ns) for chunk, found in angles.kept]
    for side in SIDES:
        stamps = _Chunks[_Stamps]()
        for chunk in files.chunks[side]:
            try:
                stamps.take(chunk, _Stamps(read_stamps(chunk.table)))
            except SourceError as error:
                stamps.problems.append(Problem(chunk.table, error.what))
        hub.fingers[side] = [StampedChunk(chunk, found.time_ns) for chunk, found in stamps.kept]
        hub.problems += stamps.problems
        hub.repeated += stamps.repeated
    return hub


def _of_one_time(time_ns: Int64Array, where: Path) -> NDArray[np.bool_]:
    """Return which readings are of the session: most of them, and what is hours away is not.

    A hub without a battery for its clock begins in another year, until the network tells it.
    """
    ordered = np.sort(time_ns)
    cuts = np.flatnonzero(np.diff(ordered) > _APART_NS) + 1
    parts = np.split(ordered, cuts)
    most = max(parts, key=len)
    if most[-1] - most[0] > _LONGEST_NS:
        raise SourceError(
            f"its readings cover {(most[-1] - most[0]) / 3.6e12:.0f} h, a session at most "
            f"{_LONGEST_NS / 3.6e12:.0f} h",
            where=where,
            fix="Divide the hub's folders by session.",
        )
    return np.asarray((time_ns >= most[0]) & (time_ns <= most[-1]))


class _Stamped(Protocol):
    @property
    def time_ns(self) -> Int64Array: ...


@dataclass(frozen=True, slots=True, eq=False)
class _Stamps:
    time_ns: Int64Array


S = TypeVar("S", bound=_Stamped)


class _Chunks(Generic[S]):
    """Keeps chunks in order, and each of them once."""

    def __init__(self) -> None:
        self.kept: list[tuple[Chunk, S]] = []
        self.problems: list[Problem] = []
        self.repeated: list[Path] = []
        self._seen: set[bytes] = set()

    def take(self, chunk: Chunk, found: S) -> None:
        """Take a chunk, unless its stamps are those of one before."""
        said = found.time_ns.tobytes()
        if said and said in self._seen:
            self.repeated.append(chunk.table)
            return
        self._seen.add(said)
        self.kept.append((chunk, found))


def join_readings(parts: Sequence[Readings]) -> Readings:
    """Put readings end to end."""
    return Readings(
        np.concatenate([np.empty(0, np.int64), *(part.time_ns for part in parts)]),
        np.concatenate([np.empty(0, np.int64), *(part.counts for part in parts)]),
        np.concatenate([np.empty((0, 7)), *(part.poses for part in parts)]),
    )


def usable(poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which poses are ones, (N,) bool: finite, with a quaternion that is not zero."""
    with np.errstate(invalid="ignore", over="ignore"):
        norm = np.linalg.norm(poses[:, 3:], axis=1)
    return np.asarray(np.isfinite(poses).all(axis=1) & (norm > 0.5) & (norm < 2.0))


class PoseSession:
    """The poses of a session as its clips are placed by them.

    Parameters
    ----------
    readings : Readings
    epoch_ns : int
        Unix time of the session's second 0.

    Attributes
    ----------
    track : PoseTrack
        The usable ones, by their stamps, in the session's time.
    width_ns, counts : (N,) int64
        Stamps of all readings in the session's time, strictly increasing, and their counts.
    """

    def __init__(self, readings: Readings, epoch_ns: int) -> None:
        time, _ = strictly_increasing(readings.time_ns - epoch_ns)
        good = usable(readings.poses)
        # The hub reads faster than the headset sends: the same pose twice is one that is old.
        fresh = good.copy()
        fresh[1:] &= (readings.poses[1:] != readings.poses[:-1]).any(axis=1)
        self.track = PoseTrack(time[fresh], readings.poses[fresh])
        self.width_ns = time
        self.counts = readings.counts

    @property
    def span_ns(self) -> tuple[int, int]:
        """Time of the first and the last pose."""
        time = self.track.time_ns
        return (int(time[0]), int(time[-1])) if len(time) else (0, 0)

    def between(self, start_ns: int, stop_ns: int) -> PoseTrack:
        """Return those with ``start_ns <= time_ns < stop_ns``."""
        first, last = np.searchsorted(self.track.time_ns, [start_ns, stop_ns])
        return PoseTrack(self.track.time_ns[first:last], self.track.poses[first:last])
