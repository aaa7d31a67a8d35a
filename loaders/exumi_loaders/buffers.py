"""Memory of batches, used again once a batch has been dropped.

A batch of colour windows has some 80 MB. Memory of that size comes fresh from the system each time
and is zeroed page by page, which costs half as much as decoding the frames into it.
"""

import math
import weakref
from collections import deque

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

__all__ = ["BatchBuffers"]

_KEPT = 4


class BatchBuffers:
    """Hand out tensors; their memory comes back when nothing refers to it any more.

    Views, and arrays that a tensor is shown as, keep the memory: a batch that is still in use is
    never written over.
    """

    def __init__(self) -> None:
        self._free: dict[tuple[int, str], deque[np.ndarray]] = {}

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

    def __getstate__(self) -> dict[str, object]:
        return {}

    def __setstate__(self, state: dict[str, object]) -> None:
        self._free = {}
