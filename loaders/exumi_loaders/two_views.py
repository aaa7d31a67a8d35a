"""Two views of the same tactile frame, for self-supervised baselines such as BYOL."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, SupportsIndex

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from exumi_loaders.clip_batches import (
    ClipBatches,
    Item,
    make_loader,
    positions,
    replacements,
)
from exumi_loaders.clip_splits import SplitLevel, split_dataset
from exumi_loaders.clips import Clips
from exumi_loaders.sampler import WindowIndex
from exumi_loaders.window_frames import OnCorrupt

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["TwoViews"]

View = Callable[[Tensor], Tensor]


class TwoViews(Dataset[Item]):
    """Single tactile frames, each to be augmented twice on the device.

    Items are the salient frames of all clips; item i is frame ``i % K`` of clip ``i // K``. They
    need no labels. The frames go to the device once, as uint8; `pairs` makes the two views there.

    ==============  =====================  =====================================================
    key             shape, dtype           meaning
    ==============  =====================  =====================================================
    ``frames``      (C, H, W) uint8        one salient frame
    ``reference``   (C, H, W) uint8        image without contact, if all clips have one
    ``valid``       () bool                False: a short clip's last frame once more
    ``clip``        () int64               position in ``clips.table``
    ``episode``     () int64               position in ``clips.dataset``
    ``replaced``    () int64               damaged frames that this one stands for
                                           (``on_corrupt="skip"`` only)
    ``substituted`` () int64               1 where the frame is damaged, and black
                                           (``on_corrupt="substitute"`` only)
    ==============  =====================  =====================================================

    Parameters
    ----------
    dataset : exumi_data.Dataset
        With frames of one size: ``exumi prepare`` makes them. Frames that are stored as video are
        slow to read one by one.
    frames : int
        K, salient frames of a clip.
    stream : str or sequence of str, optional
        Tactile streams; default all.
    split, split_by, split_ratio
        See `split_dataset`.
    grey_tactile : bool
        Give one channel (luma) of colour frames.
    on_corrupt : {"raise", "skip", "substitute"}
        What happens at damaged data. ``raise``: an error that names episode, stream and frame.
        ``skip``: a frame of another clip takes the place (drawn by seed, epoch and index), and
        ``replaced`` counts the damaged ones; batches keep their size. ``substitute``: the frame is
        black, marked in ``valid`` and counted in ``substituted``. A dataset that changed since it
        was opened is an error in any case.
    seed : int
        Of the order and of a split made on the fly.

    Attributes
    ----------
    clips : Clips

    Raises
    ------
    UsageError
        Frames differ in size.

    Examples
    --------
    >>> views = TwoViews(exumi_data.open("training"))  # doctest: +SKIP
    >>> loader = views.loader(256, num_workers=2)  # doctest: +SKIP
    >>> for one, other, batch in views.pairs(loader, augment, device="cuda"):  # doctest: +SKIP
    ...     loss = byol(one, other)
    """

    def __init__(  # noqa: PLR0913  # keyword-only options, each with a default
        self,
        dataset: "EpisodeDataset",
        *,
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
        self.clips = Clips(dataset, stream=stream, frames=frames)
        self._seed = seed
        chosen = range(len(self.clips))
        self._batches = ClipBatches(self.clips, chosen, grey=grey_tactile, on_corrupt=on_corrupt)
        self._batches.require_one_size(chosen)

    def __len__(self) -> int:
        return len(self.clips) * self.clips.frames

    def __repr__(self) -> str:
        return f"<TwoViews: {len(self)} frames of {len(self.clips)} clips>"

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
        clip, which = np.divmod(positions(indices, len(self)), self.clips.frames)

        def redraw(rows: np.ndarray, tries: int) -> np.ndarray:
            drawn = replacements(self._seed, indices, rows, tries, len(self))
            return np.asarray(drawn // self.clips.frames)

        return self._batches.fill_single(clip, which, redraw)

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

    @staticmethod
    def pairs(
        loader: Iterable[Item],
        augment: View,
        other: View | None = None,
        *,
        device: torch.device | str | None = None,
    ) -> Iterator[tuple[Tensor, Tensor, Item]]:
        """Yield two views of each batch, made on the device from one copy of its frames.

        Parameters
        ----------
        loader : iterable of batches
        augment : callable
            Takes frames (B, C, H, W) uint8 on the device. It draws anew at each call.
        other : callable, optional
            Makes the second view; default `augment`.
        device : torch.device or str, optional
            Default: where the batch is.

        Yields
        ------
        one, other : Tensor
            What the callables return.
        batch : dict of str to Tensor
            With ``frames`` on the device.
        """
        for batch in loader:
            frames = batch["frames"].to(device, non_blocking=True) if device else batch["frames"]
            yield augment(frames), (other or augment)(frames), {**batch, "frames": frames}
