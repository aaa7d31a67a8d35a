"""What is at hand at a tick: the newest sample of each stream that has arrived by then.

A recorded window and a live stream choose their samples with these functions, and so the same ones.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exumi_data.ticks import tick_times_ns

__all__ = ["Observed", "at_hand", "first_instant_ns", "observation_times_ns"]


@dataclass(frozen=True)
class Observed:
    """What a policy sees, and how late.

    Attributes
    ----------
    steps : tuple of int
        Ticks of the observations around step 0, ascending; the last is 0.
    latency_ns : dict of str to int
        Of each stream: how long after its capture a sample is at hand.
    stale_ns : dict of str to int
        Of each stream: how much older than that a sample may be.
    """

    steps: tuple[int, ...]
    latency_ns: Mapping[str, int]
    stale_ns: Mapping[str, int]


def first_instant_ns(first_ns: Mapping[str, int], latency_ns: Mapping[str, int]) -> int:
    """Return the first time at which every stream has a sample at hand.

    Parameters
    ----------
    first_ns : mapping of str to int
        Capture time of each stream's first sample.
    latency_ns : mapping of str to int
    """
    return max(time + latency_ns[name] for name, time in first_ns.items())


def observation_times_ns(
    now_ns: np.ndarray, steps: tuple[int, ...], tick_s: Fraction, start_ns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of the observations around some ticks.

    Parameters
    ----------
    now_ns : (M,) int64
        Times of step 0.
    steps : tuple of int
        Ticks around step 0, none of them positive.
    tick_s : fractions.Fraction
    start_ns : int
        Nothing is observed before this time: it is observed instead.

    Returns
    -------
    time_ns : (M, n) int64
    padding : (M, n) bool
        Where `start_ns` stands for an earlier time.
    """
    before = tick_times_ns(-np.array(steps, dtype=np.int64), tick_s)
    wanted = now_ns[:, None] - before
    padding = wanted < start_ns
    return np.maximum(wanted, start_ns), padding


def at_hand(
    time_ns: np.ndarray, wanted_ns: np.ndarray, latency_ns: int, stale_ns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the newest sample that has arrived by each time.

    Parameters
    ----------
    time_ns : (N,) int64
        Capture times, ascending.
    wanted_ns : (...) int64
    latency_ns : int
        How long after its capture a sample arrives.
    stale_ns : int
        How much older than that it may be.

    Returns
    -------
    index : (...) int64
        -1 where nothing has arrived.
    fresh : (...) bool
        Whether something has, and is not too old.
    """
    latest = wanted_ns - latency_ns
    index = np.searchsorted(time_ns, latest, side="right") - 1
    fresh = (index >= 0) & (latest - time_ns[np.maximum(index, 0)] <= stale_ns)
    return index, fresh
