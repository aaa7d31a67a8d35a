"""Batches of touch clips: salient frames, decoded straight into one buffer."""

import operator
from collections.abc import Callable, Sequence
from typing import Any, SupportsIndex

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from exumi_data.errors import DamagedDataError, UsageError
from exumi_loaders.buffers import BatchBuffers
from exumi_loaders.clips import Clips
from exumi_loaders.draws import words
from exumi_loaders.options import one_of
from exumi_loaders.sampler import WindowIndex, WindowSampler
from exumi_loaders.window_frames import OnCorrupt

__all__ = ["ClipBatches", "Item", "as_is", "make_loader", "positions", "replacements"]

Item = dict[str, Tensor]

_MOST_REPLACEMENTS = 100
_REPLACEMENT = 26  # a purpose of draws, see draws.py


def as_is(batch: Any) -> Any:
    """Collate function of loaders whose dataset has filled the batch already."""
    return batch


Redraw = Callable[[np.ndarray, int], np.ndarray]
"""``redraw(rows, tries)``: the clips that take the places of damaged ones."""


class ClipBatches:
    """Fills batches from clips.

    Parameters
    ----------
    clips : Clips
    chosen : sequence of int
        The clips that will be asked for. Whether there are references is a matter of all of them.
    grey : bool
        Give one channel (luma) of colour frames.
    on_corrupt : {"raise", "skip", "substitute"}
        What happens at damaged data. ``raise``: an error that names episode, stream and frame.
        ``skip``: other clips take the place. ``substitute``: damaged frames are black, marked and
        counted.
    """

    def __init__(
        self,
        clips: Clips,
        chosen: Sequence[int],
        *,
        grey: bool = False,
        on_corrupt: OnCorrupt = "raise",
    ) -> None:
        one_of("on_corrupt", on_corrupt, ("raise", "skip", "substitute"))
        self._clips = clips
        self._grey = grey
        self._on_corrupt: OnCorrupt = on_corrupt
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

    def fill(self, chosen: np.ndarray, redraw: Redraw | None = None) -> Item:
        """Decode clips, all of one size.

        Parameters
        ----------
        chosen : (...) int
            Positions in the table of clips.
        redraw : callable, optional
            Draws other clips for ``on_corrupt="skip"``.

        Returns
        -------
        dict of str to Tensor
            ``frames`` (..., K, C, H, W) uint8, ``frames_valid`` (..., K) bool, ``clip`` and
            ``episode`` (...) int64, and ``reference`` (..., C, H, W) uint8 if all clips have one.
            ``replaced`` (...) int64, damaged clips that this one stands for, with ``skip``;
            ``substituted`` (...) int64, damaged frames that are black, with ``substitute``.
        """
        every = np.broadcast_to(np.arange(self._clips.frames), (*chosen.shape, self._clips.frames))
        return self._fill(chosen, every, redraw)

    def fill_single(
        self, chosen: np.ndarray, which: np.ndarray, redraw: Redraw | None = None
    ) -> Item:
        """Decode one frame of each clip.

        Parameters
        ----------
        chosen : (B,) int
            Positions in the table of clips.
        which : (B,) int
            Of its K salient frames.
        redraw : callable, optional
            As of `fill`.

        Returns
        -------
        dict of str to Tensor
            As of `fill`, with ``frames`` (B, C, H, W) and ``valid`` (B,) bool.
        """
        batch = self._fill(chosen, which[:, None], redraw)
        valid = batch.pop("frames_valid")[:, 0]
        return {**batch, "frames": batch["frames"][:, 0], "valid": valid}

    def _fill(self, chosen: np.ndarray, which: np.ndarray, redraw: Redraw | None) -> Item:
        """Decode frames `which` (..., k) of the clips `chosen` (...)."""
        count = which.shape[-1]
        flat = chosen.ravel().copy()
        size = self.size(int(flat[0]))
        # In the order that decoders write: torch sees it as channels-last images without a copy.
        buffer, out = self._buffers.take((*which.shape, *size))
        frames = out.reshape(len(flat), count, *size)
        references = reference_out = None
        if self._references:
            references, space = self._buffers.take((*chosen.shape, *size))
            reference_out = space.reshape(len(flat), *size)
        wanted = which.reshape(len(flat), count)
        damaged = self._read(flat, wanted, frames, reference_out)
        replaced = np.zeros(len(flat), dtype=np.int64)
        while redraw is not None and self._on_corrupt == "skip" and damaged.any():
            rows = np.flatnonzero(damaged.any(axis=1))
            replaced[rows] += 1
            tries = int(replaced.max())
            self._require_room(int(flat[rows[0]]), tries)
            flat[rows] = redraw(rows, tries)
            for row in rows.tolist():  # where it lies in the buffers
                at = slice(row, row + 1)
                into = None if reference_out is None else reference_out[at]
                damaged[at] = self._read(flat[at], wanted[at], frames[at], into)
        valid = ~damaged
        for row in range(len(flat)):
            if not damaged[row].all():
                valid[row] &= self._clips.salient(int(flat[row])).valid[wanted[row]]
        batch = {
            "frames": buffer.movedim(-1, -3),
            "frames_valid": torch.from_numpy(valid.reshape(which.shape)),
            **self._names(flat.reshape(chosen.shape)),
        }
        if references is not None:
            batch["reference"] = references.movedim(-1, -3)
        if self._on_corrupt == "skip":
            batch["replaced"] = torch.from_numpy(replaced.reshape(chosen.shape))
        if self._on_corrupt == "substitute":
            black = damaged.sum(axis=1).reshape(chosen.shape)
            batch["substituted"] = torch.from_numpy(black.astype(np.int64))
        return batch

    def _read(
        self,
        clips: np.ndarray,
        which: np.ndarray,
        out: np.ndarray,
        reference: np.ndarray | None,
    ) -> np.ndarray:
        """Decode clips in place; return which frames are damaged, (B, k) bool."""
        return self._clips.read_batch(
            clips, which, out, reference, on_corrupt=self._on_corrupt
        ).damaged

    def _require_room(self, clip: int, tries: int) -> None:
        if tries > _MOST_REPLACEMENTS:
            raise DamagedDataError(
                f"a clip and {_MOST_REPLACEMENTS} that were drawn to replace it are damaged, the "
                f"last is of episode {self._clips.table[clip].id}",
                where=self._clips.dataset.path,
                fix="See what is damaged: exumi validate --level data",
            )

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
        number = item.window if isinstance(item, WindowIndex) else operator.index(item)
        if not -count <= number < count:
            msg = f"item {number} of {count}"
            raise IndexError(msg)
        found[position] = number % count
    return found


def replacements(
    seed: int,
    indices: Sequence[SupportsIndex | WindowIndex],
    rows: np.ndarray,
    tries: int,
    count: int,
) -> np.ndarray:
    """Draw items that take the place of damaged ones: a function of seed, epoch and index.

    Parameters
    ----------
    seed : int
    indices : sequence of int or WindowIndex
        Items of the batch.
    rows : (R,) int
        The damaged ones of them.
    tries : int
        From 1: the items drawn before were damaged, too.
    count : int
        Items that there are.

    Returns
    -------
    (R,) int64
    """
    asked = [indices[row] for row in rows.tolist()]
    epochs = [one.epoch if isinstance(one, WindowIndex) else 0 for one in asked]
    at = positions(asked, count)
    drawn = words(seed, np.array(epochs), at, tries, purpose=_REPLACEMENT)[:, -1]
    return np.asarray(drawn % np.uint64(count), dtype=np.int64)


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
