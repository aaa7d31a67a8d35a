"""Clips with ratings of what was touched: hardness, roughness, and others (Octopi)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, SupportsIndex

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset, Sampler

from exumi_data.errors import UsageError
from exumi_loaders.clip_batches import (
    ClipBatches,
    Item,
    make_loader,
    positions,
    replacements,
)
from exumi_loaders.clip_splits import SplitLevel, split_dataset
from exumi_loaders.clips import Clips, Provenance
from exumi_loaders.filled import FilledBatch
from exumi_loaders.sampler import WindowIndex
from exumi_loaders.window_frames import OnCorrupt

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["PropertyWindows"]


class PropertyWindows(Dataset[Item]):
    """Salient frames of a clip, and how it was rated from 0 to 10.

    ==================  =======================  ==============================================
    key                 shape, dtype             meaning
    ==================  =======================  ==============================================
    ``frames``          (K, C, H, W) uint8       salient frames in time order
    ``frames_valid``    (K,) bool                False: a short clip's last frame, repeated
    ``reference``       (C, H, W) uint8          image without contact, if all clips have one
    ``rating``          (P,) float32             one a property, 0 to 10; 0 where there is none
    ``rating_valid``    (P,) bool                whether there is a rating
    ``clip``            () int64                 position in ``clips.table``
    ``episode``         () int64                 position in ``clips.dataset``
    ``replaced``        () int64                 damaged clips that this one stands for
                                                 (``on_corrupt="skip"`` only)
    ``substituted``     () int64                 damaged frames that are black
                                                 (``on_corrupt="substitute"`` only)
    ==================  =======================  ==============================================

    A missing label is masked, never made up: a loss takes ``rating_valid`` as its weight.

    Parameters
    ----------
    dataset : exumi_data.Dataset
        With frames of one size: ``exumi prepare`` makes them.
    properties : sequence of str
        Any property that is rated as a number with a scale; given on 0 to 10, whatever its scale.
    provenance : {"human", "any"}
        Whose labels count. With ``any``, a model's label is taken where there is no person's.
    keep_unlabelled : bool
        Whether clips without any of the ratings are items too.
    frames : int
        K, salient frames of a clip.
    stream : str or sequence of str, optional
        Tactile streams; default all.
    split, split_by, split_ratio
        See `split_dataset`; by default parts of ``val`` are unseen in ``train``.
    grey_tactile : bool
        Give one channel (luma) of colour frames.
    on_corrupt : {"raise", "skip", "substitute"}
        What happens at damaged data. ``raise``: an error that names episode, stream and frame.
        ``skip``: another clip takes the place (drawn by seed, epoch and index), and ``replaced``
        counts the damaged ones; batches keep their size. ``substitute``: the frame is black,
        marked in ``frames_valid`` and counted in ``substituted``. A dataset that changed since it
        was opened is an error in any case.
    seed : int
        Of the order and of a split made on the fly.

    Attributes
    ----------
    clips : Clips
    properties : tuple of str
    rating : (len(self), P) float32
    rating_valid : (len(self), P) bool
    left_out : int
        Clips without any of the ratings.

    Raises
    ------
    UsageError
        No clip has a rating of a property; frames differ in size.

    Examples
    --------
    >>> windows = PropertyWindows(exumi_data.open("training"), split="train")  # doctest: +SKIP
    >>> for batch in windows.loader(32):  # doctest: +SKIP
    ...     error = (model(batch["frames"]) - batch["rating"]) ** 2
    ...     loss = error[batch["rating_valid"]].mean()
    """

    def __init__(  # noqa: PLR0913  # keyword-only options, each with a default
        self,
        dataset: "EpisodeDataset",
        *,
        properties: Sequence[str] = ("hardness", "roughness"),
        provenance: Provenance = "human",
        keep_unlabelled: bool = False,
        frames: int = 10,
        stream: str | Sequence[str] | None = None,
        split: str | None = None,
        split_by: SplitLevel = "part",
        split_ratio: tuple[int, int] = (15, 1),
        grey_tactile: bool = False,
        on_corrupt: OnCorrupt = "raise",
        seed: int = 0,
    ) -> None:
        dataset = split_dataset(dataset, split, by=split_by, ratio=split_ratio, seed=seed)
        self.clips = Clips(dataset, stream=stream, frames=frames, provenance=provenance)
        self.properties = tuple(properties)
        self._require_known(provenance)
        ratings = np.array(
            [[c.labels.get(name, np.nan) for name in self.properties] for c in self.clips.table],
            dtype=np.float32,
        )
        known = ~np.isnan(ratings)
        kept = known.any(axis=1) | keep_unlabelled
        self.left_out = int((~kept).sum())
        self._clip = np.flatnonzero(kept)
        self.rating_valid = known[kept]
        self.rating = np.where(self.rating_valid, ratings[kept], np.float32(0))
        self._seed = seed
        self._batches = ClipBatches(
            self.clips, self._clip.tolist(), grey=grey_tactile, on_corrupt=on_corrupt
        )
        self._batches.require_one_size(self._clip.tolist())

    def _require_known(self, provenance: Provenance) -> None:
        found = {name for clip in self.clips.table for name in clip.labels}
        for name in self.properties:
            if name not in found:
                whose = "a person's rating" if provenance == "human" else "a rating"
                raise UsageError(
                    f"no clip has {whose} of {name!r} on a stated scale; there are: "
                    f"{', '.join(sorted(found)) or 'none'}",
                    where=self.clips.dataset.path,
                )
        if not self.properties:
            raise UsageError("no property is asked for")

    def __len__(self) -> int:
        return len(self._clip)

    def __repr__(self) -> str:
        counts = ", ".join(
            f"{count} of {name}"
            for name, count in zip(self.properties, self.rating_valid.sum(axis=0), strict=True)
        )
        return f"<PropertyWindows: {len(self)} clips ({counts}); {self.left_out} left out>"

    def __getitem__(self, index: SupportsIndex | WindowIndex) -> Item:
        return {name: value[0] for name, value in self.__getitems__([index]).items()}

    def __getitems__(self, indices: Sequence[SupportsIndex | WindowIndex]) -> Item:
        """Fill one batch.

        Parameters
        ----------
        indices : sequence of int or WindowIndex

        Returns
        -------
        dict of str to Tensor
            Each with a first axis of ``len(indices)``.
        """
        chosen = positions(indices, len(self))

        def redraw(rows: np.ndarray, tries: int) -> np.ndarray:
            chosen[rows] = replacements(self._seed, indices, rows, tries, len(self))
            return np.asarray(self._clip[chosen[rows]])

        filled = self._batches.fill(self._clip[chosen], redraw)
        ratings = {
            "rating": torch.from_numpy(self.rating[chosen]),
            "rating_valid": torch.from_numpy(self.rating_valid[chosen]),
        }
        return FilledBatch({**filled, **ratings}, filled.block)

    def loader(
        self,
        batch_size: int,
        *,
        shuffle: bool = True,
        num_workers: int = 0,
        sampler: Sampler[Any] | None = None,
        **options: Any,
    ) -> DataLoader[Item]:
        """Make a DataLoader whose batches are filled in one buffer.

        Parameters
        ----------
        batch_size : int
        shuffle : bool
        num_workers : int
        sampler : Sampler, optional
            Instead of `shuffle`: a `WindowSampler` to go on in the middle of an epoch, or PyTorch's
            ``DistributedSampler``.
        **options
            Passed on to `torch.utils.data.DataLoader`.
        """
        return make_loader(
            self,
            batch_size,
            shuffle=shuffle,
            seed=self._seed,
            sampler=sampler,
            num_workers=num_workers,
            **options,
        )
