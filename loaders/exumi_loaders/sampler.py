"""The order of windows in an epoch: shuffled, thinned by stored activity, resumable."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.draws import uniform
from exumi_loaders.epochs import EpochSampler, refuse_other

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

    Parameters
    ----------
    windows : TPPWindows
    shuffle : bool
    seed : int
    reject_inactive : float
        Probability in [0, 1] that an inactive window is left out of an epoch.

    Attributes
    ----------
    epoch : int
        The epoch that the next iteration runs; grows by one at the end of each.
    """

    def __init__(
        self,
        windows: _Windows,
        *,
        shuffle: bool = True,
        seed: int = 0,
        reject_inactive: float = 0.0,
    ) -> None:
        super().__init__()
        if not 0 <= reject_inactive <= 1:
            raise UsageError(f"reject_inactive is {reject_inactive}, not in [0, 1]")
        self._windows = windows
        self._shuffle = shuffle
        self._seed = seed
        self._reject = reject_inactive
        if reject_inactive:
            _ = windows.active  # says now, not in the middle of an epoch, if there is no activity

    def order(self, epoch: int) -> np.ndarray:
        """Return the window indices of an epoch, (M,) int64.

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
        return indices

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

    def state_dict(self, consumed: int) -> dict[str, Any]:
        """Return what it takes to go on.

        Parameters
        ----------
        consumed : int
            Windows that training has used of the epoch that was begun last. (The sampler
            runs ahead of training by what the workers prefetch, so it cannot know.)

        Returns
        -------
        dict
            Of plain values. Where all of the epoch was used, it leads to the next one.

        Raises
        ------
        UsageError
            The epoch has not that many.
        """
        epoch, used = self._position(consumed)
        return {**self._order_of(), "epoch": epoch, "consumed": used}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state: the next window is the one after those consumed.

        Parameters
        ----------
        state : dict
            Of `state_dict`.

        Raises
        ------
        UsageError
            The state belongs to other windows, another seed or other options.
        """
        refuse_other(state, self._order_of())
        self._go_on(int(state["epoch"]), int(state["consumed"]))
