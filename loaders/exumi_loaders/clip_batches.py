"""Batches of touch clips: salient frames, decoded straight into one buffer."""

from collections.abc import Sequence
from typing import Any, Literal, SupportsIndex

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from exumi_data.errors import UsageError
from exumi_loaders.buffers import BatchBuffers
from exumi_loaders.clips import Clips
from exumi_loaders.options import one_of
from exumi_loaders.sampler import WindowIndex, WindowSampler

__all__ = ["ClipBatches", "Item", "OnDamage", "as_is", "make_loader", "positions"]

Item = dict[str, Tensor]
OnDamage = Literal["raise", "substitute"]


def as_is(batch: Any) -> Any:
    """Collate function of loaders whose dataset has filled the batch already."""
    return batch


class ClipBatches:
    """Fills batches from clips.

    Parameters
    ----------
    clips : Clips
    chosen : sequence of int
        The clips that will be asked for. Whether there are references is a matter of all of them.
    grey : bool
        Give one channel (luma) of colour frames.
    on_corrupt : {"raise", "substitute"}
        ``substitute`` makes damaged frames black, not valid, and counts them.
    """

    def __init__(
        self,
        clips: Clips,
        chosen: Sequence[int],
        *,
        grey: bool = False,
        on_corrupt: OnDamage = "raise",
    ) -> None:
        one_of("on_corrupt", on_corrupt, ("raise", "substitute"))
        self._clips = clips
        self._on_corrupt: OnDamage = on_corrupt
        self._grey = grey
        self._references = all(clips.table[index].has_reference for index in chosen)
        self._buffers = BatchBuffers()

    def size(self, index: int) -> tuple[int, int, int]:
        """Return height, width and channels that a clip's frames are given in."""
        height, width, channels = self._clips.table[index].shape
        return (height, width, 1 if self._grey else channels)

    def require_one_size(self, chosen: Sequence[int]) -> None:
        """Check that clips can be in one batch.

        Raises
        ------
        UsageError
            Names two clips whose frames differ in size.
        """
        for index in chosen:
            if self.size(index) != self.size(chosen[0]):
                one, other = (self._clips.table[at] for at in (chosen[0], index))
                raise UsageError(
                    f"frames of {other.stream} are {other.shape} in episode {other.id} and "
                    f"{one.shape} in {one.id} (height, width, channels)",
                    where=self._clips.dataset.path,
                    fix="Make frames of one size first: exumi prepare SRC DST --size 224",
                )

    def fill(self, chosen: np.ndarray) -> Item:
        """Decode clips, all of one size.

        Parameters
        ----------
        chosen : (...) int
            Positions in the table of clips.

        Returns
        -------
        dict of str to Tensor
            ``frames`` (..., K, C, H, W) uint8, ``frames_valid`` (..., K) bool, ``clip`` and
            ``episode`` (...) int64, and ``reference`` (..., C, H, W) uint8 if all clips have one;
            ``substituted`` (...) int64, how many frames are damaged, where that is no error.
        """
        count = self._clips.frames
        every = np.broadcast_to(np.arange(count), (*chosen.shape, count))
        return self._fill(chosen, every)

    def fill_single(self, chosen: np.ndarray, which: np.ndarray) -> Item:
        """Decode one frame of each clip.

        Parameters
        ----------
        chosen : (B,) int
            Positions in the table of clips.
        which : (B,) int
            Of its K salient frames.

        Returns
        -------
        dict of str to Tensor
            As of `fill`, with ``frames`` (B, C, H, W) and ``valid`` (B,) bool.
        """
        batch = self._fill(chosen, which[:, None])
        valid = batch.pop("frames_valid")[:, 0]
        return {**batch, "frames": batch["frames"][:, 0], "valid": valid}

    def _fill(self, chosen: np.ndarray, which: np.ndarray) -> Item:
        """Decode frames `which` (..., k) of the clips `chosen` (...)."""
        count = which.shape[-1]
        flat = chosen.ravel()
        size = self.size(int(flat[0]))
        # In the order that decoders write: torch sees it as channels-last images without a copy.
        buffer, out = self._buffers.take((*which.shape, *size))
        frames = out.reshape(len(flat), count, *size)
        references = reference_out = None
        if self._references:
            references, into = self._buffers.take((*chosen.shape, *size))
            reference_out = into.reshape(len(flat), *size)
        valid = np.empty((len(flat), count), dtype=bool)
        damaged = np.zeros(len(flat), dtype=np.int64)
        wanted = which.reshape(len(flat), count)
        for position, index in enumerate(flat.tolist()):
            bad = self._clips.read_into(
                index,
                frames[position],
                None if reference_out is None else reference_out[position],
                which=wanted[position],
                on_corrupt=self._on_corrupt,
            )
            valid[position] = self._clips.salient(index).valid[wanted[position]] & ~bad
            damaged[position] = bad.sum()
        batch = {
            "frames": buffer.movedim(-1, -3),
            "frames_valid": torch.from_numpy(valid.reshape(which.shape)),
            **self._names(chosen),
        }
        if references is not None:
            batch["reference"] = references.movedim(-1, -3)
        if self._on_corrupt == "substitute":
            batch["substituted"] = torch.from_numpy(damaged.reshape(chosen.shape))
        return batch

    def _names(self, chosen: np.ndarray) -> Item:
        episode = np.array([self._clips.table[index].episode for index in chosen.ravel()])
        return {
            "clip": torch.from_numpy(chosen.astype(np.int64)),
            "episode": torch.from_numpy(episode.reshape(chosen.shape).astype(np.int64)),
        }


def positions(indices: Sequence[SupportsIndex | WindowIndex], count: int) -> np.ndarray:
    """Return plain positions of items, (B,) int64; negative ones count from the end."""
    found = np.empty(len(indices), dtype=np.int64)
    for position, item in enumerate(indices):
        number = item.window if isinstance(item, WindowIndex) else item.__index__()
        if not -count <= number < count:
            msg = f"item {number} of {count}"
            raise IndexError(msg)
        found[position] = number % count
    return found


def make_loader(
    dataset: Dataset[Item],
    batch_size: int,
    *,
    shuffle: bool,
    seed: int,
    sampler: Sampler[Any] | None,
    **options: Any,
) -> DataLoader[Item]:
    """Make a DataLoader of a dataset whose ``__getitems__`` fills a batch."""
    if sampler is None:
        sampler = WindowSampler(dataset, shuffle=shuffle, seed=seed)  # type: ignore[arg-type]  # it needs no activity
    return DataLoader(dataset, batch_size=batch_size, sampler=sampler, collate_fn=as_is, **options)
