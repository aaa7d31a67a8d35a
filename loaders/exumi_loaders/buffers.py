"""Memory of batches, used again once a batch has been dropped.

A batch of colour windows has some 80 MB. Memory of that size comes fresh from the system each time
and is zeroed page by page, which costs half as much as decoding the frames into it.
"""

import math
import weakref
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import get_worker_info

from exumi_loaders.shared_memory import SharedBlock, SharedBlocks

__all__ = ["Batch", "BatchBuffers", "ItemSpec"]

_KEPT = 4
_LINE = 64  # bytes: each image stream begins at a cache line


class ItemSpec(NamedTuple):
    """Shape and type of one key of an item, without the axis of the batch.

    Images are (..., H, W, C) in memory and are shown as (..., C, H, W). Where `files` is set there
    are `JpegFrames` in their place, which become images of this shape and type.
    """

    shape: tuple[int, ...]
    dtype: str
    image: bool = False
    files: bool = False

    def __str__(self) -> str:
        shape = self.shape
        if self.image:
            shape = (*shape[:-3], shape[-1], *shape[-3:-1])
        return f"{shape} {self.dtype}{' as JPEG files' if self.files else ''}"


class Batch(NamedTuple):
    """One batch: as tensors, and the same memory as arrays, for filling it in place.

    The arrays must not be kept: see `BatchBuffers.take`. Images are undefined until they are
    filled; everything else is zero. In place of images that stay JPEG files there is no tensor, and
    an array of objects: `bytes`, or None where there is no frame. In a worker of a DataLoader the
    images are in a block of shared memory.
    """

    tensors: dict[str, Tensor]
    arrays: dict[str, np.ndarray]
    block: SharedBlock | None


class BatchBuffers:
    """Hand out tensors; their memory comes back when nothing refers to it any more.

    Views, and arrays that a tensor is shown as, keep the memory: a batch that is still in use is
    never written over.
    """

    def __init__(self) -> None:
        self._free: dict[tuple[int, str], deque[np.ndarray]] = {}
        self._shared = SharedBlocks()

    def take(
        self, shape: tuple[int, ...], dtype: npt.DTypeLike = np.uint8
    ) -> tuple[Tensor, np.ndarray]:
        """Return a tensor of undefined content, and the same memory as an array.

        The array is for filling it, and must not be kept: it does not hold on to the memory.
        """
        size = math.prod(shape)
        free = self._free.setdefault((size, np.dtype(dtype).str), deque(maxlen=_KEPT))
        memory = free.pop() if free else np.empty(size, dtype=dtype)
        # The tensor refers to this array object and to no other: when it goes, so did the tensor.
        owner = memory[:].reshape(shape)
        weakref.finalize(owner, free.append, memory).atexit = False
        return torch.from_numpy(owner), memory.reshape(shape)

    def images(
        self, shapes: Mapping[str, tuple[int, ...]]
    ) -> tuple[dict[str, tuple[Tensor, np.ndarray]], SharedBlock | None]:
        """Return the memory of several streams of images of one batch.

        Parameters
        ----------
        shapes : mapping of str to tuple of int

        Returns
        -------
        images : dict of str to (Tensor, ndarray)
            Each as of `take`.
        block : SharedBlock or None
            In a worker of a DataLoader: where they are, for `FilledBatch`.
        """
        if get_worker_info() is None or not shapes:
            return {name: self.take(shape) for name, shape in shapes.items()}, None
        rooms = [-(-math.prod(shape) // _LINE) * _LINE for shape in shapes.values()]
        block = self._shared.take(sum(rooms))
        memory, start = block.lend(), 0
        taken = {}
        for room, (name, shape) in zip(rooms, shapes.items(), strict=True):
            array = memory[start : start + math.prod(shape)].reshape(shape)
            taken[name] = torch.from_numpy(array), array
            start += room
        return taken, block

    def batch(self, spec: Mapping[str, ItemSpec], size: int) -> Batch:
        """Return memory for `size` items.

        Parameters
        ----------
        spec : mapping of str to ItemSpec
        size : int
        """
        taken, block = self.images(
            {name: (size, *one.shape) for name, one in spec.items() if one.image and not one.files}
        )
        tensors: dict[str, Tensor] = {}
        arrays: dict[str, np.ndarray] = {}
        for name, (shape, dtype, image, files) in spec.items():
            if files:
                arrays[name] = np.full((size, *shape[:-3]), None, dtype=object)
            elif image:
                # In the order that JPEG decoders write: torch sees it as channels-last images
                # without a copy.
                tensor, arrays[name] = taken[name]
                tensors[name] = tensor.movedim(-1, -3)
            else:
                arrays[name] = np.zeros((size, *shape), dtype=dtype)
                tensors[name] = torch.from_numpy(arrays[name])
        return Batch(tensors, arrays, block)

    def __getstate__(self) -> dict[str, object]:
        return {}

    def __setstate__(self, state: dict[str, object]) -> None:
        self._free = {}
        self._shared = SharedBlocks()
