"""The order of windows in an epoch: shuffled, thinned by stored activity, shared out, resumable."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.draws import uniform
from exumi_loaders.epochs import EpochSampler

__all__ = ["WindowIndex", "WindowSampler"]

_REJECTION = 1


class WindowIndex(NamedTuple):
    """A window in an epoch: what the sampler hands to the dataset, through any worker."""

    epoch: int
    window: int


class _Windows(Protocol):
    def __len__(self) -> int: ...
    @property
    def active(self) -> np.ndarray: ...


class WindowSampler(EpochSampler[WindowIndex]):
    """Order and thin out the windows of each epoch.

    Inactive windows are left out with a probability, decided from *stored* activity: nothing is
    decoded to be thrown away. Whether a window is left out is a pure function of
    (seed, epoch, index).

    Ranks take windows of one order in turn. Where they do not divide an epoch, its first windows
    come once more at its end, so that all ranks have as many.

    Parameters
    ----------
    windows : TPPWindows
    shuffle : bool
    seed : int
    reject_inactive : float
        Probability in [0, 1] that an inactive window is left out of an epoch.
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
    """

    def __init__(
        self,
        windows: _Windows,
        *,
        shuffle: bool = True,
        seed: int = 0,
        reject_inactive: float = 0.0,
        rank: int = 0,
        world_size: int | None = None,
    ) -> None:
        super().__init__(rank, world_size)
        if not 0 <= reject_inactive <= 1:
            raise UsageError(f"reject_inactive is {reject_inactive}, not in [0, 1]")
        self._windows = windows
        self._shuffle = shuffle
        self._seed = seed
        self._reject = reject_inactive
        if reject_inactive:
            _ = windows.active  # says now, not in the middle of an epoch, if there is no activity

    def order(self, epoch: int) -> np.ndarray:
        """Return the window indices of this rank in an epoch, (M,) int64.

        Parameters
        ----------
        epoch : int
        """
        indices = np.arange(len(self._windows))
        if self._reject:
            drawn = uniform(self._seed, np.full(len(indices), epoch), indices, purpose=_REJECTION)
            indices = indices[self._windows.active | (drawn >= self._reject)]
        if self._shuffle:
            # A bit generator of its own for (seed, epoch): NumPy's stream for it never changes.
            generator = np.random.Generator(np.random.Philox(key=[self._seed % 2**64, epoch]))
            indices = generator.permutation(indices)
        # Wrapped round, also more than once where there are more ranks than windows.
        rounds = -(-len(indices) // self._world)
        return np.resize(indices, rounds * self._world)[self._rank :: self._world]

    def _count(self, epoch: int) -> int:
        return len(self.order(epoch))

    def _indices(self, epoch: int, start: int) -> Iterator[WindowIndex]:
        for index in self.order(epoch)[start:]:
            yield WindowIndex(epoch, int(index))

    def _order_of(self) -> dict[str, Any]:
        """Return what the order of an epoch depends on."""
        return {
            "seed": self._seed,
            "windows": len(self._windows),
            "shuffle": self._shuffle,
            "reject_inactive": self._reject,
        }
