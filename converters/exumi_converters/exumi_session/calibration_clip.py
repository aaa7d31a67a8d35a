"""The latency clip: a sweep before a marker, and, where the gripper moves in it, the fingers.

It is the only video of a session that is decoded to find out when things were. The sweep says how
late the poses are against the camera; the fingers, whose opening the encoder reads in no time, say
how late the camera is against the encoder.
"""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from exumi_converters.exumi_session.hub import PoseSession
from exumi_data.ahead import ahead
from exumi_data.clips.frames import clip_frames, clip_size, fitting
from exumi_data.clips.markers import MarkerSettings
from exumi_data.clips.sweeps import first_sweep
from exumi_data.engine import default_workers
from exumi_data.errors import ExumiError
from exumi_data.model.calibration import Intrinsics
from exumi_data.synchronisation import LatencyEstimate, search_lag
from exumi_data.synchronisation.placing import Placement
from exumi_data.synchronisation.sweep import MarkerTrack
from exumi_data.synchronisation.sweep_search import place_sweep
from exumi_data.synchronisation.timing import CameraTiming

__all__ = ["ClipMotion", "Seen", "fingers_late", "look_at", "place_calibration"]

Int64Array = NDArray[np.int64]
Float64Array = NDArray[np.float64]

# Thirty views a second tell as much as sixty.
_APART_NS = 29_000_000
_LOOK_NS = 600_000_000_000
_SMALL_PX = 160
_STILL_M_PER_S, _STILL_RAD_PER_S = 0.03, 0.15
_STILL_NS = 2_000_000_000
_LEAST_TRAVEL_M = 0.01
_MOST_LAG_S = 0.4
_MOST_SIGMA_S = 0.015
_SPAN_NS = 200_000_000


@dataclass(frozen=True, slots=True, eq=False)
class ClipMotion:
    """By how much each frame of a clip differs from the one before it.

    Attributes
    ----------
    time_ns : (N,) int64
        Half-way between the two, on the clip's clock.
    energy : (N,) float64
        Mean grey levels.
    row : (N,) float64
        In which row of the frame that is, on average: 0 the first, 1 the last.
    """

    time_ns: Int64Array
    energy: Float64Array
    row: Float64Array


@dataclass(frozen=True, slots=True)
class Seen:
    """What a latency clip shows.

    Attributes
    ----------
    marker : MarkerTrack or str
        On the clip's clock; or why there is none.
    motion : ClipMotion
    """

    marker: MarkerTrack | str
    motion: ClipMotion


class _Watched:
    """Passes frames on, and notes how they differ."""

    def __init__(self, frames: Iterator[tuple[int, NDArray[np.uint8]]]) -> None:
        self._frames = frames
        self._before: tuple[int, NDArray[np.uint8]] | None = None
        self._times: list[int] = []
        self._energies: list[float] = []
        self._rows: list[float] = []

    def __iter__(self) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        for time_ns, frame in self._frames:
            step = max(1, frame.shape[1] // (2 * _SMALL_PX))
            thin = np.ascontiguousarray(frame[::step, ::step])
            height, width = thin.shape
            small = cv2.resize(
                thin,
                (min(_SMALL_PX, width), max(1, height * min(_SMALL_PX, width) // width)),
                interpolation=cv2.INTER_AREA,
            )
            if self._before is not None:
                before_ns, before = self._before
                self._times.append((before_ns + time_ns) // 2)
                profile = cv2.absdiff(small, before).mean(axis=1, dtype=np.float64)
                # Noise is everywhere: what lies above it says where something moves.
                moving = np.maximum(profile - np.median(profile), 0.0) + 1e-9
                place = np.arange(len(profile)) / max(len(profile) - 1, 1)
                self._energies.append(float(profile.mean()))
                self._rows.append(float(np.sum(moving * place) / np.sum(moving)))
            self._before = time_ns, np.asarray(small, np.uint8)
            yield time_ns, frame

    @property
    def motion(self) -> ClipMotion:
        return ClipMotion(
            np.array(self._times, np.int64), np.array(self._energies), np.array(self._rows)
        )


def look_at(path: Path, camera: Intrinsics, settings: MarkerSettings) -> Seen:
    """Decode a latency clip once, and return what it shows.

    Parameters
    ----------
    path : pathlib.Path
        Its first ten minutes are looked at.
    camera : Intrinsics
        How it was filmed; for frames of this shape.
    settings : MarkerSettings
    """
    # The next frames are decoded while the marker is looked for in one.
    decoded = ahead(clip_frames(path, threads=default_workers(), apart_ns=_APART_NS))
    with closing(decoded):
        frames = _Watched(decoded)
        looked = iter(frames)
        try:
            fitted = fitting(camera, *clip_size(path), path)
            marker = first_sweep(looked, fitted, settings)
            for time_ns, _ in looked:
                if time_ns > _LOOK_NS:
                    break
        except (ExumiError, ValueError, OSError) as error:
            marker = f"its frames do not help: {error}"
        return Seen(marker, frames.motion)


def place_calibration(session: PoseSession, seen: Seen) -> Placement | str:
    """Find where in the hub's recording the latency clip is, by its sweep against all poses.

    Parameters
    ----------
    session : PoseSession
    seen : Seen

    Returns
    -------
    Placement or str
        By the poses' stamps; or why it is not certain.
    """
    if isinstance(seen.marker, str):
        return seen.marker
    return place_sweep(session, seen.marker)


def fingers_late(
    session: PoseSession, widths_m: Float64Array, seen: Seen, place: Placement
) -> LatencyEstimate | None:
    """Estimate by how much poses are late, by fingers that move in the clip while the hand rests.

    Parameters
    ----------
    session : PoseSession
    widths_m : (N,) float64
        At ``session.width_ns``; NaN where there is none.
    seen : Seen
    place : Placement
        Of the clip, by the poses' stamps.

    Returns
    -------
    LatencyEstimate or None
        Its `offset_s` is the poses' latency. None where the clip does not tell.
    """
    motion = seen.motion
    known = np.isfinite(widths_m)
    if len(motion.time_ns) < 2 or np.count_nonzero(known) < 2:
        return None
    stamped = np.array([place.to_session(at) for at in motion.time_ns.tolist()], np.int64)
    rest = _longest_rest(session, int(stamped[0]), int(stamped[-1]))
    if rest is None:
        return None
    shown = (stamped >= rest[0]) & (stamped <= rest[1])
    energy = motion.energy[shown]
    if len(energy) < 2:
        return None
    weight = np.maximum(energy - np.median(energy), 0.0)
    row = float(np.average(motion.row[shown], weights=weight + 1e-9))
    timing = CameraTiming()
    stamped = timing.event_ns(stamped[shown], np.full(len(energy), row))
    width_ns, width = session.width_ns[known], widths_m[known]
    inside = (width_ns >= rest[0]) & (width_ns <= rest[1])
    if not inside.any() or float(np.ptp(width[inside])) < _LEAST_TRAVEL_M:
        return None
    half = int(np.median(np.diff(motion.time_ns))) // 2
    near = (width_ns >= rest[0] - 10**9) & (width_ns <= rest[1] + 10**9)
    at, opening = width_ns[near], width[near]
    moved = np.abs(np.interp(at + half, at, opening) - np.interp(at - half, at, opening))
    found = search_lag(stamped, energy, at, moved, max_lag_s=_MOST_LAG_S)
    if found is None or found.sigma_s > _MOST_SIGMA_S:
        return None
    # The exposure is in the sweep as well, and takes itself out; so does the marker's own row.
    assert isinstance(seen.marker, MarkerTrack)  # noqa: S101  # the clip was placed by it
    apart = abs(row - float(seen.marker.row.mean()))
    sigma = float(np.hypot(found.sigma_s, apart * timing.readout_s.sigma))
    return LatencyEstimate(
        offset_s=found.offset_s, sigma_s=sigma, n_events=1, method=f"fingers by {found.method}"
    )


def _longest_rest(session: PoseSession, start_ns: int, stop_ns: int) -> tuple[int, int] | None:
    """Return the longest time in which the hand hardly moved."""
    track = session.between(start_ns, stop_ns)
    time = track.time_ns
    if len(time) < 3:
        return None
    later = np.minimum(np.searchsorted(time, time + _SPAN_NS), len(time) - 1)
    span_s = np.maximum(time[later] - time, 1) * 1e-9
    moved = np.linalg.norm(track.poses[later, :3] - track.poses[:, :3], axis=1) / span_s
    dot = np.abs(np.sum(track.poses[later, 3:] * track.poses[:, 3:], axis=1)).clip(0.0, 1.0)
    turned = 2.0 * np.arccos(dot) / span_s
    still = (moved < _STILL_M_PER_S) & (turned < _STILL_RAD_PER_S)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    runs = [(int(time[a]), int(time[b - 1])) for a, b in edges.reshape(-1, 2)]
    best = max(runs, key=lambda run: run[1] - run[0], default=None)
    if best is None or best[1] - best[0] < _STILL_NS:
        return None
    return best
