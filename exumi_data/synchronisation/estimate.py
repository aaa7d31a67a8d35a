"""An estimated latency, and one made of several."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["LatencyEstimate", "combine"]

_HUBER = 2.0
_ROUNDS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyEstimate:
    """By how much one curve is late relative to another one.

    Attributes
    ----------
    offset_s : float
        Seconds; positive where the first curve is late.
    sigma_s : float
        Standard deviation of `offset_s`, seconds, what is systematic included.
    n_events : int
        Events that it was made of; 1 for a comparison of whole curves.
    method : str
        Id and version of the method.
    """

    offset_s: float
    sigma_s: float
    n_events: int
    method: str


def combine(
    estimates: Sequence[LatencyEstimate | None], *, floor_s: float, method: str
) -> LatencyEstimate | None:
    """Combine estimates of the same latency, so that single wrong ones do little harm.

    A weighted mean with Huber's weights. Where the estimates scatter by more than they claim,
    the uncertainty grows accordingly.

    Parameters
    ----------
    estimates : sequence of LatencyEstimate or None
        None where an event does not tell.
    floor_s : float
        What all of them have in common and no number of events averages out, seconds.
    method : str

    Returns
    -------
    LatencyEstimate or None
        None where less than half of the events tell: what the others say is chance then.
    """
    told = [estimate for estimate in estimates if estimate is not None]
    if not told or 2 * len(told) < len(estimates):
        return None
    offset = np.array([estimate.offset_s for estimate in told])
    sigma = np.array([estimate.sigma_s for estimate in told])
    centre = _weighted_median(offset, 1.0 / sigma**2)
    weight = 1.0 / sigma**2
    for _ in range(_ROUNDS):
        away = np.abs(offset - centre) / sigma
        weight = np.minimum(1.0, _HUBER / np.maximum(away, 1e-12)) / sigma**2
        centre = float(np.sum(weight * offset) / np.sum(weight))
    variance = 1.0 / float(np.sum(weight))
    if len(offset) > 1:
        scatter = float(np.sum(weight * (offset - centre) ** 2)) / (len(offset) - 1)
        variance *= max(1.0, scatter)
    return LatencyEstimate(
        offset_s=centre,
        sigma_s=float(np.hypot(np.sqrt(variance), floor_s)),
        n_events=sum(estimate.n_events for estimate in told),
        method=method,
    )


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, 0.5 * reached[-1])])
