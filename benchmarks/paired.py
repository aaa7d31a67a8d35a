"""Intervals of paired differences."""

import numpy as np

__all__ = ["over_groups", "over_seeds"]


def over_seeds(differences: np.ndarray, confidence: float = 0.95) -> tuple[float, float]:
    """Return Student's interval of the mean of paired differences.

    Parameters
    ----------
    differences : (N,) ndarray
        One for each pair.
    confidence : float
    """
    from scipy import stats

    count = len(differences)
    half = stats.t.ppf((1 + confidence) / 2, count - 1) * differences.std(ddof=1) / np.sqrt(count)
    middle = differences.mean()
    return float(middle - half), float(middle + half)


def over_groups(
    differences: np.ndarray, confidence: float = 0.95, draws: int = 10_000
) -> tuple[float, float]:
    """Return the bootstrap interval (percentiles) of the mean of paired differences.

    Parameters
    ----------
    differences : (N,) ndarray
        One for each pair.
    confidence : float
    draws : int
    """
    rng = np.random.default_rng(0)
    means = differences[rng.integers(0, len(differences), (draws, len(differences)))].mean(axis=1)
    low, high = np.quantile(means, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)
