"""What all kinds of windows have in common: a batch is filled in place, in any worker."""

import operator
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, SupportsIndex

import numpy as np
from torch.utils.data import DataLoader, Dataset, Sampler

from exumi_loaders.buffers import Batch, BatchBuffers, ItemSpec
from exumi_loaders.device.jpeg_frames import pack_files
from exumi_loaders.filled import FilledBatch
from exumi_loaders.sampler import WindowIndex, WindowSampler

__all__ = ["Item", "Windows"]

# Tensors, or JpegFrames in place of images.
Item = dict[str, Any]


def _as_is(batch: Any) -> Any:
    """Collate function of the loader: ``__getitems__`` has filled the batch already."""
    return batch


class Windows(Dataset[Item]):
    """Windows by index; what they hold is for a subclass to say.

    Parameters
    ----------
    seed : int
        Of everything that is drawn.

    Attributes
    ----------
    epoch : int
        The epoch of plain integer indices (a `WindowIndex` names its own).
    """

    def __init__(self, seed: int) -> None:
        self.epoch = 0
        self._seed = seed
        self._buffers = BatchBuffers()

    @abstractmethod
    def __len__(self) -> int:
        """Count the windows."""

    @property
    @abstractmethod
    def active(self) -> np.ndarray:
        """(len(self),) bool: which windows are active, from stored activity.

        Raises
        ------
        UsageError
            Not all episodes have stored activity.
        """

    @property
    @abstractmethod
    def spec(self) -> Mapping[str, ItemSpec]:
        """Shape and type of each key of an item."""

    @property
    @abstractmethod
    def alike(self) -> Mapping[str, object]:
        """What windows must have in common with others to be mixed, beside their shapes."""

    @abstractmethod
    def fill(
        self, arrays: Mapping[str, np.ndarray], rows: np.ndarray, epochs: np.ndarray, at: np.ndarray
    ) -> None:
        """Fill some rows of a batch.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            One for each key of `spec`, with an axis for the batch in front. What stays JPEG files
            is an array of their bytes, with None where there is no frame.
        rows : (R,) int64
            The rows to fill.
        epochs : (R,) int64
            The epoch of each window.
        at : (R,) int64
            Which window it is, in [0, len(self)).
        """

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch of plain integer indices (a `WindowIndex` names its own).

        Parameters
        ----------
        epoch : int
        """
        self.epoch = epoch

    def __getitem__(self, index: SupportsIndex | WindowIndex) -> Item:
        batch = self.__getitems__([index])
        return {name: value[0] for name, value in batch.items()}

    def __getitems__(self, indices: Sequence[SupportsIndex | WindowIndex]) -> Item:
        """Fill one batch: no item is made on its own and collated.

        Parameters
        ----------
        indices : sequence of int or WindowIndex

        Returns
        -------
        dict of str to Tensor or JpegFrames
            Each with a first axis of ``len(indices)``.
        """
        epochs, chosen = self._resolve(indices)
        batch: Batch = self._buffers.batch(self.spec, len(chosen))
        self.fill(batch.arrays, np.arange(len(chosen)), epochs, chosen)
        return FilledBatch(
            {
                name: pack_files(batch.arrays[name], spec.shape[-3:])
                if spec.files
                else batch.tensors[name]
                for name, spec in self.spec.items()
            }
        )

    def _resolve(
        self, indices: Sequence[SupportsIndex | WindowIndex]
    ) -> tuple[np.ndarray, np.ndarray]:
        epochs = np.empty(len(indices), dtype=np.int64)
        chosen = np.empty(len(indices), dtype=np.int64)
        count = len(self)
        for position, item in enumerate(indices):
            if isinstance(item, WindowIndex):
                epochs[position], index = item
            else:
                epochs[position], index = self.epoch, operator.index(item)
            if not -count <= index < count:
                msg = f"window {index} of {count}"
                raise IndexError(msg)
            chosen[position] = index % count
        return epochs, chosen

    def loader(
        self,
        batch_size: int,
        *,
        shuffle: bool = True,
        reject_inactive: float = 0.0,
        drop_last: bool = False,
        num_workers: int = 0,
        sampler: Sampler[WindowIndex] | None = None,
        **options: Any,
    ) -> DataLoader[Item]:
        """Make a DataLoader whose batches are filled in one buffer.

        Parameters
        ----------
        batch_size : int
        shuffle : bool
        reject_inactive : float
            Probability that an inactive window is left out of an epoch; it is never decoded.
        drop_last : bool
        num_workers : int
        sampler : WindowSampler or ActiveWindowSampler, optional
            Instead of `shuffle` and `reject_inactive`.
        **options
            Passed on to `torch.utils.data.DataLoader`.

        Returns
        -------
        torch.utils.data.DataLoader
        """
        if sampler is None:
            sampler = self._default_sampler(shuffle=shuffle, reject_inactive=reject_inactive)
        return DataLoader(
            self,
            batch_size=batch_size,
            sampler=sampler,
            drop_last=drop_last,
            num_workers=num_workers,
            collate_fn=_as_is,
            **options,
        )

    def _default_sampler(self, *, shuffle: bool, reject_inactive: float) -> Sampler[WindowIndex]:
        return WindowSampler(
            self, shuffle=shuffle, seed=self._seed, reject_inactive=reject_inactive
        )
