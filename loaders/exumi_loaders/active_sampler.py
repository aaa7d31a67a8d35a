"""Rejection sampling of windows without decoding: the activity of a window is known beforehand."""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.draws import uniform
from exumi_loaders.epochs import EpochSampler
from exumi_loaders.sampler import WindowIndex

__all__ = ["EXUMI_REJECT", "EXUMI_RETRIES", "ActiveWindowSampler"]

EXUMI_REJECT = 0.9
"""Probability with which exUMI's released loader means to reject an inactive window."""
EXUMI_RETRIES = 5
"""How often it draws again before it takes what it has."""

_KIND, _WITHIN = 2, 3  # purposes of draws, see draws.py
_BLOCK = 65536


class _Windows(Protocol):
    def __len__(self) -> int: ...
    @property
    def active(self) -> np.ndarray: ...


class _Pool:
    """Windows to draw from, with their weights."""

    def __init__(self, indices: np.ndarray, weights: np.ndarray | None) -> None:
        self._indices = indices
        self._edges = None if weights is None else np.cumsum(weights[indices])
        if self._edges is None:
            self.total = float(len(indices))
        else:
            self.total = float(self._edges[-1]) if len(indices) else 0.0

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Turn numbers in [0, 1) into windows."""
        if self._edges is None:
            return self._indices[(uniforms * len(self._indices)).astype(np.int64)]
        at = np.searchsorted(self._edges, uniforms * self.total, side="right")
        return self._indices[np.minimum(at, len(self._indices) - 1)]


class ActiveWindowSampler(EpochSampler[WindowIndex]):
    """Draw windows as the loop "draw, decode, reject, draw again" does, and decode none in vain.

    The loop draws a window; when it is inactive, it rejects it with a probability and draws
    another one, at most so many times, and then takes what it has. Which windows are active is a
    function of their index, so what the loop ends with can be drawn directly: the same
    distribution, one window read for each window yielded.

    An epoch is a row of independent draws, its slots. The window of a slot is a pure function of
    (seed, epoch, slot): the same with any number of workers and ranks. Ranks take slots in turn,
    so that none is left out and none is taken twice, and training goes on with another number of
    ranks where it stopped.

    Parameters
    ----------
    windows : TPPWindows, ConcatWindows or PolicyWindows
    reject : float
        Probability in [0, 1] that an inactive window is drawn again; 0 needs no stored activity.
    retries : int or None
        How often at most; None (default) until a window is accepted.
    weights : (len(windows),) array-like, optional
        How often each window is drawn, relative to the others; not negative. Default: all alike.
    count : int, optional
        Slots of an epoch, of all ranks together; default ``len(windows)``. It is rounded up to a
        multiple of `world_size`, so that all ranks have as many.
    seed : int
    rank : int
        Of this process in distributed training.
    world_size : int, optional
        Ranks that share an epoch out. Default 1, which is refused in a process group of more: all
        of them would train on the same. 1 itself says that something else shares it out.

    Attributes
    ----------
    epoch : int
        The epoch that the next iteration runs. It grows by one when an iteration begins, whether
        that comes to its end or not.
    active_share : float
        The share of active windows that is to be expected.

    Raises
    ------
    UsageError
        An option is out of its range; no activity is stored; no window can be accepted.

    Notes
    -----
    With a the share of active draws, p = `reject`, k = `retries` and q = (1 − a)·p, the loop ends
    with an active window in a·(1 + q + ... + q^k) of all cases.

    Examples
    --------
    >>> sampler = ActiveWindowSampler(windows)  # doctest: +SKIP
    >>> for batch in windows.loader(64, sampler=sampler):  # doctest: +SKIP
    ...     batch["valid"]
    """

    def __init__(
        self,
        windows: _Windows,
        *,
        reject: float = 1.0,
        retries: int | None = None,
        weights: Any = None,
        count: int | None = None,
        seed: int = 0,
        rank: int = 0,
        world_size: int | None = None,
    ) -> None:
        super().__init__(rank, world_size)
        _check(reject=reject, retries=retries, count=count)
        active = _active(windows, reject)
        relative = None if weights is None else _weights(weights, len(active))
        self._active = _Pool(np.flatnonzero(active), relative)
        self._inactive = _Pool(np.flatnonzero(~active), relative)
        self.active_share = _share(self._active.total, self._inactive.total, reject, retries)
        self._seed = seed
        self._rounds = -(-(len(active) if count is None else count) // self._world)

    @classmethod
    def exumi(cls, windows: _Windows, **options: Any) -> "ActiveWindowSampler":
        """Make the sampler with exUMI's figures: rejected in 9 of 10 cases, at most 5 times.

        Parameters
        ----------
        windows : TPPWindows or PolicyWindows
        **options
            As of the class.
        """
        return cls(windows, reject=EXUMI_REJECT, retries=EXUMI_RETRIES, **options)

    def order(self, epoch: int) -> np.ndarray:
        """Return the windows of this rank in an epoch, (len(self),) int64.

        Parameters
        ----------
        epoch : int
        """
        return np.concatenate([*self._blocks(epoch, 0), np.empty(0, dtype=np.int64)])

    def _blocks(self, epoch: int, start: int) -> Iterator[np.ndarray]:
        for first in range(start, self._rounds, _BLOCK):
            rounds = np.arange(first, min(first + _BLOCK, self._rounds))
            yield self._draw(epoch, rounds * self._world + self._rank)

    def _draw(self, epoch: int, slots: np.ndarray) -> np.ndarray:
        epochs = np.full(len(slots), epoch)
        is_active = uniform(self._seed, epochs, slots, purpose=_KIND) < self.active_share
        within = uniform(self._seed, epochs, slots, purpose=_WITHIN)
        drawn = np.empty(len(slots), dtype=np.int64)
        drawn[is_active] = self._active.draw(within[is_active])
        drawn[~is_active] = self._inactive.draw(within[~is_active])
        return drawn

    def _count(self, epoch: int) -> int:  # all epochs are alike
        return self._rounds

    def _indices(self, epoch: int, start: int) -> Iterator[WindowIndex]:
        for block in self._blocks(epoch, start):
            for index in block.tolist():
                yield WindowIndex(epoch, index)

    def _order_of(self) -> dict[str, Any]:
        """Return what the draws of an epoch depend on, whatever the number of ranks."""
        return {"seed": self._seed, "active_share": self.active_share}


def _check(*, reject: float, retries: int | None, count: int | None) -> None:
    if not 0 <= reject <= 1:
        raise UsageError(f"reject is {reject}, not in [0, 1]")
    if retries is not None and retries < 0:
        raise UsageError(f"retries is {retries}, not a number of draws")
    if count is not None and count < 1:
        raise UsageError(f"count is {count}, not a number of windows")


def _active(windows: _Windows, reject: float) -> np.ndarray:
    """Return which windows are active; where nothing is rejected, it need not be known."""
    try:
        return np.asarray(windows.active)
    except UsageError:
        if reject:
            raise
        return np.zeros(len(windows), dtype=bool)


def _weights(weights: Any, count: int) -> np.ndarray:
    found = np.asarray(weights, dtype=np.float64)
    if found.shape != (count,):
        raise UsageError(f"weights have shape {found.shape}, expected ({count},)")
    if not (np.isfinite(found) & (found >= 0)).all():
        raise UsageError("weights are to be finite and not negative")
    return found


def _share(active: float, inactive: float, reject: float, retries: int | None) -> float:
    """Return the probability that the loop ends with an active window."""
    if not active + inactive > 0:
        raise UsageError("there is no window to draw: none is there, or all weights are zero")
    share = active / (active + inactive)
    rejected = (1 - share) * reject
    if retries is not None:
        return float(share * sum(rejected**draws for draws in range(retries + 1)))
    if rejected >= 1:
        raise UsageError(
            "no window is active, and inactive ones are always drawn again",
            fix="Give reject below 1, or retries; exumi stats shows how much of it is active.",
        )
    return float(share / (1 - rejected))
