"""Where training is in an epoch, for samplers that run ahead of it, each on its rank."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import torch
from torch.utils.data import Sampler

from exumi_data.errors import UsageError

__all__ = ["EpochSampler"]

Index = TypeVar("Index")


class EpochSampler(Sampler[Index]):
    """One epoch after the other, each of them a function of its number; resumable.

    Parameters
    ----------
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

    def __init__(self, rank: int = 0, world_size: int | None = None) -> None:
        self._is_alone = world_size is None
        self._rank, self._world = rank, 1 if world_size is None else world_size
        if not 0 <= self._rank < self._world:
            raise UsageError(f"rank is {rank}, not one of {self._world}")
        self.epoch = 0
        self._start = 0
        # The epoch that was begun last: workers come to its end before training does.
        self._running = 0
        self._ended = False

    @abstractmethod
    def _count(self, epoch: int) -> int:
        """Count what an epoch yields on this rank."""

    @abstractmethod
    def _indices(self, epoch: int, start: int) -> Iterator[Index]:
        """Yield what an epoch holds on this rank, but for the first `start`."""

    @abstractmethod
    def _order_of(self) -> dict[str, Any]:
        """Return what the order of an epoch depends on."""

    def __len__(self) -> int:
        """Count what the next iteration's epoch yields on this rank."""
        return self._count(self.epoch)

    def __iter__(self) -> Iterator[Index]:
        self._refuse_to_repeat()
        epoch, start = self.epoch, self._start
        self._running, self._ended = epoch, False
        # Now and not at the end: workers come to the end of an epoch that is left early, or do
        # not, as they happen to be ahead of training.
        self.epoch, self._start = epoch + 1, 0
        yield from self._indices(epoch, start)
        self._ended = self._running == epoch

    def _refuse_to_repeat(self) -> None:
        group = torch.distributed
        if not self._is_alone or not group.is_available() or not group.is_initialized():
            return
        if group.get_world_size() > 1:
            raise UsageError(
                f"this is one of {group.get_world_size()} ranks, and the sampler was made for one: "
                "all of them would train on the same windows",
                fix="Hand the loader a sampler with rank=torch.distributed.get_rank() and "
                "world_size=torch.distributed.get_world_size(); or with world_size=1, if something "
                "else shares its windows out.",
            )

    def set_epoch(self, epoch: int) -> None:
        """Go to the beginning of an epoch; in that of a loaded state, to where the state is.

        Parameters
        ----------
        epoch : int
        """
        # Trainers call this before each epoch, also before the one that is resumed.
        if epoch != self.epoch:
            self.epoch = epoch
            self._start = 0
        self._running, self._ended = epoch, False

    def state_dict(self, consumed: int) -> dict[str, Any]:
        """Return what it takes to go on.

        Parameters
        ----------
        consumed : int
            What training has used, on each rank, of the epoch that was begun last or named by
            `set_epoch`. (The sampler runs ahead of training by what the workers prefetch, so it
            cannot know.)

        Returns
        -------
        dict
            Of plain values; ``consumed`` counts that of all ranks. Where all of the epoch was
            used, it leads to the next one.

        Raises
        ------
        UsageError
            The epoch has not that many.
        """
        epoch, used = self._position(consumed)
        return {**self._order_of(), "epoch": epoch, "consumed": used * self._world}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state: what comes next is what follows that which was consumed.

        Parameters
        ----------
        state : mapping
            Of `state_dict`.

        Raises
        ------
        UsageError
            The state belongs to another order (seed, windows, options), or the ranks of now
            cannot take over in the middle of a round.
        """
        for name, value in {**self._order_of(), "epoch": None, "consumed": None}.items():
            if name not in state:
                raise UsageError(f"no state of such a sampler: it has no {name}")
            if value is not None and state[name] != value:
                raise UsageError(f"the state has {name} {state[name]}, this sampler {value}")
        epoch, consumed = int(state["epoch"]), int(state["consumed"])
        if consumed % self._world:
            raise UsageError(
                f"{consumed} were consumed, which is no multiple of {self._world} ranks",
                fix="Stop after a whole round of all ranks, or use a number of ranks that divides.",
            )
        self._check_used(epoch, consumed // self._world)
        self.epoch = self._running = epoch
        self._start, self._ended = consumed // self._world, False

    def _check_used(self, epoch: int, used: int) -> None:
        count = self._count(epoch)
        if not 0 <= used <= count:
            raise UsageError(f"{used} used of the {count} of epoch {epoch}")

    def _position(self, consumed: int) -> tuple[int, int]:
        """Return the epoch that training is in, and how much of it has been used."""
        self._check_used(self._running, consumed)
        if consumed == self._count(self._running) or (consumed == 0 and self._ended):
            return self._running + 1, 0
        return self._running, consumed
