"""Where in a session a marker was swept past: a clip's sweep against all poses of the session.

Where the marker is in the camera's frame is a sum of the hand's position and of the entries of its
rotation, by gains that need not be known (see `exumi_data.synchronisation.sweep`). The gains are
fitted at every lag of the whole session at once: all sums that least squares need are correlations.
The best places are then judged like any other sweep.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.synchronisation.correlation import sampled
from exumi_data.synchronisation.placing import Placement
from exumi_data.synchronisation.sweep import (
    SWEEP_METHOD,
    MarkerTrack,
    PoseTrack,
    SweepLimits,
    SweepResult,
    estimate_sweep,
)
from exumi_data.synchronisation.timing import Range

__all__ = ["METHOD", "SessionPoses", "place_sweep"]

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

METHOD = f"exumi-sweep-match/1 by {SWEEP_METHOD}"

_STEP_NS = 40_000_000
_MAX_GAP_NS = 250_000_000
# So much of a session is looked at in one go.
_BLOCK_NS = 600_000_000_000
_OVERLAP = 0.8
_RIDGE = 1e-6
_LIKELY = 0.6
_PLACES = 5
_APART_NS = 400_000_000
# Of a whole session, more looks alike than within the half second of a calibration.
_LIMITS = SweepLimits(max_lag_s=0.3, explained=0.98)
# How much more the next best place has to leave unexplained.
_DISTINCT = 3.0
_AROUND_NS = 2_000_000_000


class SessionPoses(Protocol):
    """The poses of a session, read as they are needed."""

    @property
    def span_ns(self) -> tuple[int, int]:
        """Time of the first and of the last one."""

    def between(self, start_ns: int, stop_ns: int) -> PoseTrack:
        """Return those with ``start_ns <= time_ns < stop_ns``, the invalid ones left out."""


@dataclass(frozen=True, slots=True)
class _Place:
    offset_ns: int
    explained: float


def place_sweep(session: SessionPoses, marker: MarkerTrack) -> Placement | str:
    """Find where a clip belongs by the sweep that it shows.

    Parameters
    ----------
    session : SessionPoses
    marker : MarkerTrack
        On the clip's clock.

    Returns
    -------
    Placement or str
        Or why it is not certain.
    """
    places = _places(session, marker)
    if not places:
        return "nothing in the session moves as the marker does in it"
    judged = [(place, _judged(session, marker, place)) for place in places]
    results = [(place, found) for place, found in judged if isinstance(found, SweepResult)]
    accepted = [(place, found) for place, found in results if not found.refusals]
    if not accepted:
        # The likeliest place says best why it is none.
        found = judged[0][1]
        reason = found if isinstance(found, str) else found.refusals[0]
        return f"no place for its sweep: {reason}"
    place, best = min(accepted, key=lambda one: one[1].residual_m)
    offset_ns = place.offset_ns + round(1e9 * best.latency_s)
    elsewhere = max((one.explained for one in places if one is not place), default=0.0)
    if 1.0 - elsewhere < _DISTINCT * (1.0 - float(best.explained.max())):
        return "its sweep suits several places, none much better than the others"
    for other, found in results:
        apart_ns = abs(other.offset_ns + round(1e9 * found.latency_s) - offset_ns)
        alike = found.residual_m < _LIMITS.runner_up * best.residual_m
        if alike and apart_ns > 0.5 * _APART_NS:
            return f"its sweep fits in two places, {apart_ns * 1e-9:.1f} s apart"
    return _placement(offset_ns, best)


def _placement(offset_ns: int, found: SweepResult) -> Placement:
    return Placement(
        offset_ns=offset_ns,
        sigma_s=found.noise_s,
        t_ref_ns=0,
        drift_ppm=0.0,
        drift_sigma_ppm=None,
        correlation=float(np.sqrt(found.explained.max())),
        parts=2,
        disagreement_s=abs(found.halves_s or 0.0),
        agrees=True,
        method=METHOD,
        camera_sigma_s=found.camera_s,
    )


def _judged(session: SessionPoses, marker: MarkerTrack, place: _Place) -> SweepResult | str:
    """Estimate the lag at a place; a text says why there is none."""
    first, last = int(marker.time_ns[0]), int(marker.time_ns[-1])
    near = session.between(
        first + place.offset_ns - _AROUND_NS, last + place.offset_ns + _AROUND_NS
    )
    poses = PoseTrack(near.time_ns - place.offset_ns, near.poses)
    try:
        # What the lag of the poses is uncertain by is in the session's own clock.
        return estimate_sweep(
            marker,
            poses,
            headset_lag_s=Range(0.0, 0.0),
            limits=_LIMITS,
        )
    except CalibrationRefusedError as error:
        return error.what


def _places(session: SessionPoses, marker: MarkerTrack) -> list[_Place]:
    """Return the likeliest places in a session, the best one first."""
    found: list[_Place] = []
    for poses in _blocks(session, int(marker.time_ns[-1] - marker.time_ns[0])):
        for columns in _columns(poses):
            lags, explained = _explained(poses.time_ns, columns, marker)
            found += _peaks(lags, explained)
    chosen: list[_Place] = []
    for place in sorted(found, key=lambda one: -one.explained):
        if all(abs(place.offset_ns - one.offset_ns) > _APART_NS for one in chosen):
            chosen.append(place)
    return chosen[:_PLACES]


def _blocks(session: SessionPoses, length_ns: int) -> Iterator[PoseTrack]:
    """Go through a session; each sweep lies in one block as a whole."""
    start, stop = session.span_ns
    for first in range(start, stop, _BLOCK_NS):
        poses = session.between(first, first + _BLOCK_NS + length_ns)
        if len(poses.time_ns) > 1:
            yield poses


def _columns(poses: PoseTrack) -> Iterator[Float64Array]:
    """Return what a marker's place depends on: for a camera on the hand, and for one in the room.

    No rotation is taken for the middle one, as a session has none.
    """
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(poses.poses[:, 3:].copy())
    entries = rotation.as_matrix().reshape(-1, 9)
    position = poses.poses[:, :3] - poses.poses[:, :3].mean(axis=0)
    yield np.hstack([rotation.inv().apply(position), entries])
    yield np.hstack([position, entries])


def _peaks(lags_ns: Int64Array, explained: Float64Array) -> list[_Place]:
    left = explained.copy()
    found: list[_Place] = []
    while len(found) < _PLACES and len(left) and left.max() >= _LIKELY:
        best = int(left.argmax())
        found.append(_Place(int(lags_ns[best]), float(left[best])))
        left[np.abs(lags_ns - lags_ns[best]) <= _APART_NS] = -np.inf
    return found


def _explained(
    time_ns: Int64Array, columns: Float64Array, marker: MarkerTrack
) -> tuple[Int64Array, Float64Array]:
    """Return which share of a marker's motion poses explain at every lag.

    Returns
    -------
    lag_ns : (L,) int64
        What to add to the marker's times.
    explained : (L,) float64
        -inf where the two do not overlap.
    """
    from scipy import fft

    long = _on_grid(time_ns, np.hstack([columns, np.ones((len(columns), 1))]))
    ones = np.ones((len(marker.time_ns), 1))
    middle = marker.position_m.mean(axis=0)
    short = _on_grid(marker.time_ns, np.hstack([marker.position_m - middle, ones]))
    if len(short.values) > len(long.values):
        return np.empty(0, np.int64), np.empty(0)
    # Where all of the short curve lies within the long one, the transforms do not wrap.
    lags = np.arange(len(long.values) - len(short.values) + 1)
    size = fft.next_fast_len(len(long.values), real=True)

    def sums(of: Float64Array, by: Float64Array) -> Float64Array:
        """Return the sums of products of one column of each, at all lags."""
        spectrum = fft.rfft(of, size) * np.conj(fft.rfft(by, size))
        return np.asarray(fft.irfft(spectrum, size)[lags], np.float64)

    count = long.values.shape[1]
    normal = np.empty((len(lags), count, count))
    for i, j in combinations_with_replacement(range(count), 2):
        of = long.values[:, i] * long.values[:, j]
        normal[:, i, j] = normal[:, j, i] = sums(of, short.known)
    mixed = np.empty((len(lags), count, 3))
    for i, axis in product(range(count), range(3)):
        mixed[:, i, axis] = sums(long.values[:, i], short.values[:, axis])
    squares = sums(long.known, np.sum(short.values[:, :3] ** 2, axis=1))
    enough = normal[:, -1, -1] >= _OVERLAP * short.known.sum()
    lag_ns = long.start_ns - short.start_ns + lags * np.int64(_STEP_NS)
    return lag_ns, _share(normal, mixed, squares, enough)


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Curves on an even grid, (N, C): 0 where nothing is known."""

    start_ns: int
    values: Float64Array
    known: Float64Array


def _on_grid(time_ns: Int64Array, values: Float64Array) -> _Grid:
    curves = [
        sampled(time_ns, column, step_ns=_STEP_NS, max_gap_ns=_MAX_GAP_NS) for column in values.T
    ]
    stacked = np.stack([curve.values for curve in curves], axis=1)
    return _Grid(curves[0].start_ns, stacked, curves[0].known)


def _share(
    normal: Float64Array,
    mixed: Float64Array,
    squares: Float64Array,
    enough: NDArray[np.bool_],
) -> Float64Array:
    """Return the share that least squares explain, by their sums at each lag."""
    explained = np.full(len(normal), -np.inf)
    if not enough.any():
        return explained
    normal, mixed = normal[enough], mixed[enough]
    number = np.maximum(normal[:, -1, -1], 1.0)
    scale = np.sqrt(np.maximum(np.einsum("lii->li", normal), 1e-12))
    scaled = normal / (scale[:, :, None] * scale[:, None, :])
    scaled += _RIDGE * np.eye(normal.shape[1])
    wanted = mixed / scale[:, :, None]
    fitted = np.einsum("lic,lic->l", np.linalg.solve(scaled, wanted), wanted)
    middle = np.sum(mixed[:, -1] ** 2, axis=1) / number
    total = np.maximum(squares[enough] - middle, 1e-12)
    explained[enough] = (fitted - middle) / total
    return explained
