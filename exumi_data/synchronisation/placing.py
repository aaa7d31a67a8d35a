"""One clip against a session: where it fits, how well, and what the two halves of it say."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation import search_lag
from exumi_data.synchronisation.correlation import Sampled, SlidingCorrelation, sampled
from exumi_data.synchronisation.motion import SPAN_S, Turning

__all__ = ["CAMERA_SIGMA_S", "METHOD", "Fit", "Placement", "SessionCurve", "place", "still"]

Float64Array = NDArray[np.float64]
Allowed = Callable[[NDArray[np.int64]], NDArray[np.bool_]]

METHOD = "exumi-gyro-match/1"
CAMERA_SIGMA_S = 5e-3
"""How well a camera's pictures are in step with its gyroscope: their exposure and readout are not
known. Taken to be so, not measured."""

# What turns faster counts for little more: a tracker that jumps must not outweigh the motion.
_FAST_RAD_PER_S = 3.0
_STEP_NS = 20_000_000
_MAX_GAP_NS = 250_000_000
_OVERLAP = 0.6
_APART_NS = 1_000_000_000
_REACH_S = 0.1
_FINE_S = 0.005
_PART_S = 10.0
_MOST_PARTS = 30
_PART_REACH_S = 0.1
_LIVELY = 0.3
# Clocks of cameras were seen to run off by 43 ppm.
_MOST_DRIFT = 60e-6
_AGREE_S = 0.004
_AGREE_SIGMAS = 5.0
_USEFUL_DRIFT_PPM = 20.0
_LEAST_SPREAD_RAD_PER_S = 0.05
_LEAST_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """The best place that was found for a clip by its coarse shape.

    Attributes
    ----------
    offset_ns : int
        What to add to the clip's times.
    correlation : float
    second : float
        The next best, elsewhere; -1 where there is none.
    distinct : float
        How much more of the motion the second best leaves unexplained than the best does.
    """

    offset_ns: int
    correlation: float
    second: float
    distinct: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Where a clip belongs, to a fraction of a frame.

    Attributes
    ----------
    offset_ns : int
        What to add to the clip's times, at `t_ref_ns`.
    sigma_s : float
        Its standard deviation, of the comparison alone.
    t_ref_ns : int
        On the clip's clock; 0 where there is no drift.
    drift_ppm : float
        By how much the session's clock is faster than the clip's; 0 where it is not known better
        than that.
    drift_sigma_ppm : float or None
    correlation : float
        Of the two curves, in step.
    parts : int
        How many parts of the clip tell by themselves.
    disagreement_s : float
        The largest difference of one of them from the whole.
    agrees : bool
        Whether that is within what they claim.
    method : str
        How it was found.
    camera_sigma_s : float
        How well it is known when the camera's pictures saw what was compared.
    """

    offset_ns: int
    sigma_s: float
    t_ref_ns: int
    drift_ppm: float
    drift_sigma_ppm: float | None
    correlation: float
    parts: int
    disagreement_s: float
    agrees: bool
    method: str = METHOD
    camera_sigma_s: float = CAMERA_SIGMA_S

    def to_session(self, clip_ns: int) -> int:
        """Return the session's time of a time of the clip."""
        away = clip_ns - self.t_ref_ns
        return clip_ns + self.offset_ns + round(away * self.drift_ppm * 1e-6)


class SessionCurve:
    """How a hand turned during a session, ready to be compared with clips.

    Parameters
    ----------
    turning : Turning
    longest_s : float
        Duration of the longest clip.

    Attributes
    ----------
    turning : Turning
    """

    def __init__(self, turning: Turning, longest_s: float) -> None:
        self.turning = turning
        grid = _on_grid(turning)
        self._sliding = SlidingCorrelation(grid, int(longest_s * 1e9) // _STEP_NS + 2)

    def fit(self, clip: Turning, allowed: Allowed | None = None) -> Fit | None:
        """Find the best place of a clip.

        Parameters
        ----------
        clip : Turning
        allowed : callable, optional
            Says of offsets, (L,) int64, which are possible, (L,) bool. Default: all.

        Returns
        -------
        Fit or None
            None where the two nowhere overlap, or only where it is not possible.
        """
        grid = _on_grid(clip)
        lag_ns, correlation = self._sliding.against(grid, overlap=_OVERLAP)
        here = correlation > -1.0
        if allowed is not None:
            here &= allowed(lag_ns)
        if not here.any():
            return None
        best = int(np.where(here, correlation, -np.inf).argmax())
        others = here & (np.abs(lag_ns - lag_ns[best]) > _APART_NS)
        second = float(correlation[others].max()) if others.any() else -1.0
        return Fit(
            offset_ns=int(lag_ns[best]),
            correlation=float(correlation[best]),
            second=second,
            distinct=_unexplained(second) / max(_unexplained(float(correlation[best])), 1e-6),
        )


def _on_grid(turning: Turning) -> Sampled:
    values = _tamed(turning.rad_per_s)
    return sampled(turning.time_ns, values, step_ns=_STEP_NS, max_gap_ns=_MAX_GAP_NS)


def _tamed(rad_per_s: Float64Array) -> Float64Array:
    return np.asarray(_FAST_RAD_PER_S * np.tanh(rad_per_s / _FAST_RAD_PER_S), np.float64)


def _unexplained(correlation: float) -> float:
    return 1.0 - max(correlation, 0.0) ** 2


def still(clip: Turning) -> str | None:
    """Return why a clip tells nothing of where it belongs; None where it does.

    Parameters
    ----------
    clip : Turning
    """
    if len(clip.time_ns) < 2 or (clip.time_ns[-1] - clip.time_ns[0]) < _LEAST_S * 1e9:
        return f"it is shorter than {_LEAST_S:g} s"
    spread = float(np.std(clip.rad_per_s))
    if spread < _LEAST_SPREAD_RAD_PER_S:
        return f"the camera hardly turns in it ({spread:.2f} rad/s): there is nothing to compare"
    return None


def place(session: Turning, clip: Turning, offset_ns: int) -> Placement | None:
    """Refine a place to a fraction of a frame.

    Parameters
    ----------
    session, clip : Turning
    offset_ns : int
        Right to a tenth of a second or so.

    Returns
    -------
    Placement or None
        None where the curves do not tell.
    """
    shifted = clip.time_ns + offset_ns
    margin = round(1e9 * (_REACH_S + SPAN_S))
    near = session.between(int(shifted[0]) - margin, int(shifted[-1]) + margin)
    near = Turning(near.time_ns, _tamed(near.rad_per_s))
    values = _tamed(clip.rad_per_s)
    whole = search_lag(
        near.time_ns,
        near.rad_per_s,
        shifted,
        values,
        max_lag_s=_REACH_S,
        step_s=_FINE_S,
    )
    if whole is None:
        return None
    offset_ns += round(whole.offset_s * 1e9)
    shifted = clip.time_ns + offset_ns
    moment_s, away_s, sigma_s = _parts(near, shifted, values)
    length_s = float(shifted[-1] - shifted[0]) * 1e-9
    drift = _drift(moment_s, away_s, sigma_s)
    allowed = _AGREE_S + _AGREE_SIGMAS * sigma_s + _MOST_DRIFT * length_s
    useful = (
        drift is not None and drift[2] < _USEFUL_DRIFT_PPM and abs(drift[1]) < 1e6 * _MOST_DRIFT
    )
    known = drift if useful else None
    middle = int(clip.time_ns[0] + clip.time_ns[-1]) // 2
    return Placement(
        offset_ns=offset_ns + (round(known[0] * 1e9) if known else 0),
        sigma_s=whole.sigma_s,
        t_ref_ns=middle if known else 0,
        drift_ppm=known[1] if known else 0.0,
        drift_sigma_ppm=known[2] if known else None,
        correlation=_correlation(near, shifted, values),
        parts=len(away_s),
        disagreement_s=float(np.abs(away_s).max(initial=0.0)),
        agrees=bool((np.abs(away_s) <= allowed).all()),
    )


def _parts(
    session: Turning, shifted_ns: NDArray[np.int64], values: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return what parts of a clip say: their middles from the clip's, lag and sigma, seconds."""
    start, stop = int(shifted_ns[0]), int(shifted_ns[-1])
    count = int(np.clip((stop - start) * 1e-9 / _PART_S, 2, _MOST_PARTS))
    edges = np.linspace(start, stop, count + 1).astype(np.int64)
    whole = float(np.std(values))
    found = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        near = session.between(first, last)
        if len(near.rad_per_s) < 2 or np.std(near.rad_per_s) < _LIVELY * whole:
            continue  # at rest, noise says where it fits best
        lag = search_lag(
            near.time_ns,
            near.rad_per_s,
            shifted_ns,
            values,
            max_lag_s=_PART_REACH_S,
            step_s=_FINE_S,
        )
        if lag is not None:
            moment = (0.5 * (first + last) - 0.5 * (start + stop)) * 1e-9
            found.append((moment, lag.offset_s, lag.sigma_s))
    columns = np.array(found, np.float64).reshape(-1, 3).T
    return columns[0], columns[1], columns[2]


def _drift(
    moment_s: Float64Array, away_s: Float64Array, sigma_s: Float64Array
) -> tuple[float, float, float] | None:
    """Return lag in the middle (seconds), drift and its uncertainty (ppm), by a weighted line."""
    if len(moment_s) < 3:
        return None
    weight = 1.0 / np.maximum(sigma_s, 1e-6) ** 2
    centre = float(np.average(moment_s, weights=weight))
    lever = moment_s - centre
    power = float(np.sum(weight * lever**2))
    if power <= 0:
        return None
    level = float(np.average(away_s, weights=weight))
    slope = float(np.sum(weight * lever * away_s)) / power
    left = away_s - level - slope * lever
    excess = max(1.0, float(np.sum(weight * left**2)) / (len(left) - 2))
    return level - slope * centre, 1e6 * slope, 1e6 * float(np.sqrt(excess / power))


def _correlation(session: Turning, shifted_ns: NDArray[np.int64], values: Float64Array) -> float:
    inside = session.between(int(shifted_ns[0]), int(shifted_ns[-1]) + 1)
    if len(inside.time_ns) < 2:
        return 0.0
    origin = int(shifted_ns[0])
    other = np.interp(inside.time_ns - origin, shifted_ns - origin, values)
    return float(np.corrcoef(inside.rad_per_s, other)[0, 1])
