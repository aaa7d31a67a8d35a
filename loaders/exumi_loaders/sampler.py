"""The order of windows in an epoch: shuffled, thinned by stored activity, resumable."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
from torch.utils.data import Sampler

from exumi_data.errors import UsageError
from exumi_loaders.draws import uniform

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


class WindowSampler(Sampler[WindowIndex]):
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
        if not 0 <= reject_inactive <= 1:
            raise UsageError(f"reject_inactive is {reject_inactive}, not in [0, 1]")
        self._windows = windows
        self._shuffle = shuffle
        self._seed = seed
        self._reject = reject_inactive
        if reject_inactive:
            _ = windows.active  # says now, not in the middle of an epoch, if there is no activity
        self.epoch = 0
        self._start = 0

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

    def __len__(self) -> int:
        """Count the windows of the current epoch."""
        return len(self.order(self.epoch))

    def __iter__(self) -> Iterator[WindowIndex]:
        epoch, start = self.epoch, self._start
        for index in self.order(epoch)[start:]:
            yield WindowIndex(epoch, int(index))
        self.epoch = epoch + 1
        self._start = 0

    def set_epoch(self, epoch: int) -> None:
        """Go to the beginning of an epoch.

        Parameters
        ----------
        epoch : int
        """
        self.epoch = epoch
        self._start = 0

    def state_dict(self, consumed: int) -> dict[str, Any]:
        """Return what it takes to go on.

        Parameters
        ----------
        consumed : int
            Windows of this epoch that training has used. (The sampler itself runs ahead of
            training by what the workers prefetch, so it cannot know.)
        """
        return {"seed": self._seed, "epoch": self.epoch, "consumed": consumed}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state: the next window is the one after those consumed.

        Parameters
        ----------
        state : dict
            Of `state_dict`.

        Raises
        ------
        UsageError
            The state belongs to another seed.
        """
        if state["seed"] != self._seed:
            raise UsageError(f"the state has seed {state['seed']}, this sampler {self._seed}")
        self.epoch = int(state["epoch"])
        self._start = int(state["consumed"])
