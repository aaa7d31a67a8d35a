"""Where training is in an epoch, for samplers that run ahead of it."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from torch.utils.data import Sampler

from exumi_data.errors import UsageError

__all__ = ["EpochSampler", "refuse_other"]

Index = TypeVar("Index")


class EpochSampler(Sampler[Index]):
    """One epoch after the other, each of them a function of its number; resumable.

    Attributes
    ----------
    epoch : int
        The epoch that the next iteration runs; grows by one at the end of each.
    """

    def __init__(self) -> None:
        self.epoch = 0
        self._start = 0
        self._running = 0

    @abstractmethod
    def _count(self, epoch: int) -> int:
        """Count what an epoch yields on this rank."""

    @abstractmethod
    def _indices(self, epoch: int, start: int) -> Iterator[Index]:
        """Yield what an epoch holds, but for the first `start`."""

    def __len__(self) -> int:
        """Count what the current epoch yields on this rank."""
        return self._count(self.epoch)

    def __iter__(self) -> Iterator[Index]:
        epoch = self._running = self.epoch
        yield from self._indices(epoch, self._start)
        self.epoch = epoch + 1
        self._start = 0

    def set_epoch(self, epoch: int) -> None:
        """Go to the beginning of an epoch; in that of a loaded state, to where the state is.

        Parameters
        ----------
        epoch : int
        """
        # Trainers call this before each epoch, also before the one that is resumed.
        if epoch != self.epoch:
            self.epoch = self._running = epoch
            self._start = 0

    def _go_on(self, epoch: int, start: int) -> None:
        self._check_used(epoch, start)
        self.epoch = self._running = epoch
        self._start = start

    def _check_used(self, epoch: int, used: int) -> None:
        count = self._count(epoch)
        if not 0 <= used <= count:
            raise UsageError(f"{used} used of the {count} of epoch {epoch}")

    def _position(self, consumed: int) -> tuple[int, int]:
        """Return the epoch that training is in, and how much of it has been used.

        Workers prefetch: the sampler may have come to the end of an epoch before training has.
        """
        self._check_used(self._running, consumed)
        if consumed == 0:
            return self.epoch, 0
        if consumed == self._count(self._running):
            return self._running + 1, 0
        return self._running, consumed


def refuse_other(state: Mapping[str, Any], mine: Mapping[str, object]) -> None:
    """Refuse a state of other windows, another order, or none at all."""
    for name, value in mine.items():
        if name not in state:
            raise UsageError(f"no state of such a sampler: it has no {name}")
        if state[name] != value:
            raise UsageError(f"the state has {name} {state[name]}, this sampler {value}")
