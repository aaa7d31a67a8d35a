"""Memory that a worker shares with the process it works for, used again once dropped there.

PyTorch copies each batch of a worker into fresh shared memory, which comes from the system page by
page and costs a third of decoding the frames, and a handshake for each tensor. Here the worker
decodes into shared memory, sends one handle, and uses the memory again when the receiver has
dropped all that refers to it.
"""

import os
import weakref
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

__all__ = ["Place", "SharedBlock", "SharedBlocks", "received"]

_HEADER = 64  # the mark, in a cache line of its own
_FREE, _SENT, _GONE = 0, 1, 2
_KEPT = 32  # more than a loader has batches on their way

_forks = 0


def _count_fork() -> None:
    global _forks  # noqa: PLW0603  # the system asks for a function, and there is one count of forks
    _forks += 1


# A process that was forked sees what its parent had received: such memory is never written again.
os.register_at_fork(before=_count_fork)


class Place(NamedTuple):
    """Where in a block a tensor of bytes lies."""

    start: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]


class SharedBlock:
    """Shared memory for the images of one batch.

    Its first byte tells the worker whether the receiver still uses it. It may be lent again when
    nothing in the worker refers to it, and it was never sent, or the one receiver has dropped it.

    Parameters
    ----------
    size : int
        Bytes.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        memory = torch.empty(_HEADER + size, dtype=torch.uint8)
        self._memory: Tensor = memory.share_memory_()  # type: ignore[no-untyped-call]  # torch's
        self._mark = self._memory[:1].numpy()
        self._mark[0] = _FREE
        self._used_here = False
        self._receivers = 0

    @property
    def free(self) -> bool:
        """Whether nothing refers to the memory, in any process."""
        return not self._used_here and self._receivers < 2 and self._mark[0] == _FREE

    @property
    def gone(self) -> bool:
        """Whether nobody will say when the memory is free."""
        return self._receivers > 1 or self._mark[0] == _GONE

    def lend(self) -> np.ndarray:
        """Return the memory, (size,) uint8; it is in use as long as there is a view of it."""
        owner = self._memory.numpy()  # another object each time, which all views refer to
        self._used_here = True
        self._receivers = 0
        weakref.finalize(owner, self._returned).atexit = False
        return np.asarray(owner[_HEADER:])

    def _returned(self) -> None:
        self._used_here = False

    def place(self, value: object) -> Place | None:
        """Return where a tensor of bytes lies in this block, or None if it does not."""
        if type(value) is not Tensor or value.dtype != torch.uint8:
            return None
        if not value.is_cpu or not value.numel():
            return None
        start = value.data_ptr() - self._memory.data_ptr()
        if not _HEADER <= start < _HEADER + self.size:
            return None
        return Place(start, tuple(value.shape), value.stride())

    def send(self) -> Tensor:
        """Return what a process is to be sent, for `received`."""
        self._receivers += 1
        self._mark[0] = _SENT
        return self._memory


def received(memory: Tensor, places: dict[str, Place]) -> dict[str, Tensor]:
    """Make the tensors of a block that was sent; once all are dropped, the sender may use it.

    Parameters
    ----------
    memory : Tensor
        As `SharedBlock.send` gave it.
    places : dict of str to Place
    """
    owner = memory.numpy()
    weakref.finalize(owner, _drop, memory[:1].numpy(), _forks).atexit = False
    tensors = {}
    for name, (start, shape, stride) in places.items():
        length = 1 + sum((n - 1) * step for n, step in zip(shape, stride, strict=True))
        # Each with a storage of its own, which PyTorch does not know to be shared: to send it on
        # is to copy it.
        flat = torch.from_numpy(owner[start : start + length])
        tensors[name] = flat.as_strided(shape, stride)
    return tensors


def _drop(mark: np.ndarray, forks: int) -> None:
    mark[0] = _FREE if forks == _forks else _GONE


class SharedBlocks:
    """The blocks of a worker."""

    def __init__(self) -> None:
        self._blocks: list[SharedBlock] = []

    def take(self, size: int) -> SharedBlock:
        """Return a block of at least `size` bytes that is free.

        Parameters
        ----------
        size : int
        """
        self._blocks = [block for block in self._blocks if not block.gone]
        free = [block for block in self._blocks if block.free]
        for block in free:
            if block.size >= size:
                return block
        for block in free:  # too small: there are never more than are in use at once
            self._blocks.remove(block)
        found = SharedBlock(size)
        self._blocks = [*self._blocks, found][-_KEPT:]
        return found
