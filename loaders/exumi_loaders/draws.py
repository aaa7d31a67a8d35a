"""Random draws that are a pure function of (seed, epoch, index): the same with any workers.

Every window hashes its own counter (SplitMix64, Steele et al. 2014), so a draw needs no state
that workers could share or lose, and a whole batch is drawn at once. What a draw is for is a
number: 0 history, 1 rejection, 2 and 3 sampling by activity, 16 to 19 dropout, 20 noise of the
start pose, 21 replacements of damaged windows, 26 of damaged clips.
"""

import numpy as np
import numpy.typing as npt

__all__ = ["history_steps", "normal", "uniform", "words"]

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


Words = npt.NDArray[np.uint64]


def _mix(state: Words) -> Words:
    with np.errstate(over="ignore"):
        state = (state ^ (state >> _S30)) * _MIX_1
        state = (state ^ (state >> _S27)) * _MIX_2
        return state ^ (state >> _S31)


def words(seed: int, epochs: np.ndarray, indices: np.ndarray, count: int, *, purpose: int) -> Words:
    """Draw 64-bit words.

    Parameters
    ----------
    seed : int
    epochs, indices : (B,) int
    count : int
        Words a window.
    purpose : int
        Draws for different purposes are independent.

    Returns
    -------
    (B, count) uint64
    """
    with np.errstate(over="ignore"):
        start = np.array(seed % (1 << 64), dtype=np.uint64) + _GAMMA * np.uint64(purpose + 1)
        key = _mix(_mix(start) ^ (epochs.astype(np.uint64) * _GAMMA))
        key = _mix(key + indices.astype(np.uint64) * _GAMMA)
        counters = np.arange(1, count + 1, dtype=np.uint64) * _GAMMA
        return _mix(key[:, None] + counters)


def uniform(seed: int, epochs: np.ndarray, indices: np.ndarray, *, purpose: int) -> np.ndarray:
    """Draw one number in [0, 1) a window, (B,) float64."""
    return (words(seed, epochs, indices, 1, purpose=purpose)[:, 0] >> _S11) * 2.0**-53


def normal(
    seed: int, epochs: np.ndarray, indices: np.ndarray, count: int, *, purpose: int
) -> np.ndarray:
    """Draw `count` numbers of the standard normal distribution a window, (B, count) float64."""
    half = -(-count // 2)
    drawn = (words(seed, epochs, indices, 2 * half, purpose=purpose) >> _S11) * 2.0**-53
    # Box and Muller (1958); 1 - u is in (0, 1], so the logarithm is finite.
    radius = np.sqrt(-2 * np.log1p(-drawn[:, :half]))
    angle = 2 * np.pi * drawn[:, half:]
    both = np.concatenate((radius * np.cos(angle), radius * np.sin(angle)), axis=1)
    return np.asarray(both[:, :count])


def history_steps(
    seed: int, epochs: np.ndarray, indices: np.ndarray, *, steps: np.ndarray, count: int
) -> np.ndarray:
    """Draw `count` of `steps` without replacement, ascending; uniform over all subsets.

    Returns
    -------
    (B, count) int64
    """
    keys = words(seed, epochs, indices, len(steps), purpose=0)
    chosen = np.argpartition(keys, count - 1, axis=1)[:, :count]
    return np.sort(steps[chosen], axis=1)
