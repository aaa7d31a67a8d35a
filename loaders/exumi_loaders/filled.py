"""Batches that are filled already: what a DataLoader need not collate."""

from collections.abc import Mapping
from multiprocessing.reduction import ForkingPickler
from typing import Any, NoReturn

import numpy as np
import torch
from torch import Tensor

from exumi_data.errors import UsageError
from exumi_loaders.shared_memory import Place, SharedBlock, received

__all__ = ["FilledBatch"]

_SMALL = 1 << 20  # bytes: sent with the message, which is cheaper than a handle of its own


class FilledBatch(dict[str, Any]):
    """A dict of tensors with one axis for the batch; not the list that PyTorch collates.

    Parameters
    ----------
    values : mapping of str to Tensor or JpegFrames
    block : SharedBlock, optional
        Where images are, in a worker.
    """

    def __init__(self, values: Mapping[str, Any], block: SharedBlock | None = None) -> None:
        super().__init__(values)
        self.block = block

    def __missing__(self, key: object) -> NoReturn:
        if isinstance(key, int):  # PyTorch's default collate function asks for the first item
            raise UsageError(
                "the windows have filled a whole batch, which is not to be collated",
                fix="Take .loader(batch_size), or give your DataLoader a collate_fn that returns "
                "what it is given.",
            )
        raise KeyError(key)

    def __copy__(self) -> "FilledBatch":
        return FilledBatch(self, self.block)

    def __reduce__(self) -> tuple[type, tuple[dict[str, Any]]]:
        return FilledBatch, (dict(self),)


def _sent(batch: FilledBatch) -> tuple[Any, ...]:
    """Say how a batch goes to another process: with one handle, for all of its images."""
    block = batch.block
    places: dict[str, Place] = {}
    arrays: dict[str, np.ndarray] = {}
    others: dict[str, Any] = {}
    for name, value in batch.items():
        place = None if block is None else block.place(value)
        array = None if place is not None else _as_array(value)
        if place is not None:
            places[name] = place
        elif array is not None:
            arrays[name] = array
        else:
            others[name] = value
    memory = block.send() if block is not None and places else None
    return _received, (tuple(batch), memory, places, arrays, others)


def _as_array(value: object) -> np.ndarray | None:
    """Return a tensor as the array that stands for it in a message, if there is one."""
    if type(value) is not Tensor:
        return None
    try:
        return value.numpy() if value.nbytes <= _SMALL else None
    except (RuntimeError, TypeError):  # of a type or device that NumPy does not have
        return None


def _received(
    names: tuple[str, ...],
    memory: Tensor | None,
    places: dict[str, Place],
    arrays: dict[str, np.ndarray],
    others: dict[str, Any],
) -> FilledBatch:
    images = {} if memory is None else received(memory, places)
    small = {name: torch.from_numpy(array) for name, array in arrays.items()}
    values = {**images, **small, **others}
    return FilledBatch({name: values[name] for name in names})


# For messages between processes only: files and copies are as of any dict.
ForkingPickler.register(FilledBatch, _sent)
