"""Contrastive batches of touch clips (Octopi-1.5)."""

import operator
from collections.abc import Iterator, Sequence
from itertools import chain, product
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsIndex

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from exumi_data.errors import DamagedDataError, UsageError
from exumi_loaders.clip_batches import ClipBatches, Item, as_is
from exumi_loaders.clip_splits import SplitLevel, split_dataset
from exumi_loaders.clips import Clip, Clips
from exumi_loaders.epochs import EpochSampler
from exumi_loaders.pairing import PairRules, batch_count, pair_batches, shuffled_batches
from exumi_loaders.window_frames import OnCorrupt

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["BatchIndex", "BatchOrder", "ContrastiveBatches", "ContrastiveGroup"]


class BatchIndex(NamedTuple):
    """A batch in an epoch: what the sampler hands to the dataset, through any worker."""

    epoch: int
    batch: int


class ContrastiveGroup(NamedTuple):
    """Clips that may meet in a batch: one sensor model and one type of pad.

    Attributes
    ----------
    sensor_model, pad_type : str or None
    parts : tuple of str
        Those with clips of at least two episodes.
    batches : int
        Of an epoch; 0 where there are too few parts for one.
    """

    sensor_model: str | None
    pad_type: str | None
    parts: tuple[str, ...]
    batches: int


class _Members(NamedTuple):
    clips: np.ndarray
    part: np.ndarray
    episode: np.ndarray


class ContrastiveBatches(Dataset[Item]):
    """Two clips each of many parts: what InfoNCE learns from.

    Item i is the whole i-th batch of an epoch. The positive of a clip is a clip of the same part
    from another episode; its negatives are the other parts of the batch, touched with the same
    sensor model and type of pad: a look that differs by sensor would give the answer away. A part
    is in a batch once. An epoch uses each clip at most once; pairs, batches and their order change
    with the epoch and are a pure function of (seed, epoch).

    A batch is a dict of tensors, P parts of K frames:

    =====================  ===========================  ====================================
    key                    shape, dtype                 meaning
    =====================  ===========================  ====================================
    ``frames``             (P, 2, K, C, H, W) uint8     salient frames in time order
    ``frames_valid``       (P, 2, K) bool               False: a short clip's last, repeated
    ``reference``          (P, 2, C, H, W) uint8        image without contact, if all have one
    ``part``               (P,) int64                   position in ``parts``
    ``clip``               (P, 2) int64                 position in ``clips.table``
    ``episode``            (P, 2) int64                 position in ``clips.dataset``
    ``group``              () int64                     position in ``groups``
    ``replaced``           (P, 2) int64                 damaged clips that this one stands for
                                                        (``on_corrupt="skip"`` only)
    ``substituted``        (P, 2) int64                 damaged frames that are black
                                                        (``on_corrupt="substitute"`` only)
    =====================  ===========================  ====================================

    Parameters
    ----------
    dataset : exumi_data.Dataset
        Frames of one group have one size: ``exumi prepare`` makes them.
    parts : int
        Most parts of a batch; 32 in Octopi. Batches of a group differ by one part at most.
    min_parts : int
        Fewest parts of a batch. Parts with far more clips than others fill small batches, which
        have few negatives; a larger number leaves some of those clips out of each epoch.
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
        ``skip``: another clip of the same part takes the place, and ``replaced`` counts the
        damaged ones; a part that has none is left out of the batch, unless fewer than `min_parts`
        would remain. ``substitute``: the frame is black, marked in ``frames_valid`` and counted
        in ``substituted``. A dataset that changed since it was opened is an error in any case.
    seed : int
        Of pairs, batches, and a split made on the fly.

    Attributes
    ----------
    clips : Clips
    parts : tuple of str
        All part ids.
    groups : tuple of ContrastiveGroup
        Groups that are too small have no batch, and are here all the same.
    left_out : dict of str to int
        Clips that no batch can hold, by reason.
    epoch : int
        Of plain integer indices (a `BatchIndex` names its own).
    seed : int

    Raises
    ------
    UsageError
        No group fills a batch; frames of one group differ in size.

    Examples
    --------
    >>> batches = ContrastiveBatches(exumi_data.open("training"))  # doctest: +SKIP
    >>> for batch in batches.loader(num_workers=2):  # doctest: +SKIP
    ...     batch["frames"].shape
    torch.Size([32, 2, 10, 1, 224, 224])
    """

    def __init__(  # noqa: PLR0913  # keyword-only options, each with a default
        self,
        dataset: "EpisodeDataset",
        *,
        parts: int = 32,
        min_parts: int = 2,
        frames: int = 10,
        stream: str | Sequence[str] | None = None,
        split: str | None = None,
        split_by: SplitLevel = "part",
        split_ratio: tuple[int, int] = (15, 1),
        grey_tactile: bool = False,
        on_corrupt: OnCorrupt = "raise",
        seed: int = 0,
    ) -> None:
        if not 2 <= min_parts <= parts:
            raise UsageError(f"min_parts is {min_parts}, not in [2, {parts}], the most of a batch")
        dataset = split_dataset(dataset, split, by=split_by, ratio=split_ratio, seed=seed)
        self.clips = Clips(dataset, stream=stream, frames=frames)
        self.epoch = 0
        self.seed = seed
        self._rules = PairRules(parts, min_parts)
        self.left_out: dict[str, int] = {}
        found = self._find_groups()
        self.parts = tuple(sorted({name for group, _ in found for name in group.parts}))
        self.groups = tuple(group for group, _ in found)
        self._members = [members for _, members in found]
        if not len(self):
            raise UsageError(
                f"no batch of {min_parts} parts can be made. {self.describe()}",
                where=dataset.path,
                fix="A part needs clips of two episodes with the same sensor model and pad type.",
            )
        filled = [
            members.clips.tolist()
            for members, group in zip(self._members, self.groups, strict=True)
            if group.batches
        ]
        self._skips = on_corrupt == "skip"
        self._batches = ClipBatches(
            self.clips,
            list(chain(*filled)),
            grey=grey_tactile,
            # Pairs are replaced here: they have to be of one part, and of two episodes.
            on_corrupt="substitute" if self._skips else on_corrupt,
        )
        for chosen in filled:
            self._batches.require_one_size(chosen)
        self._part_index = {name: index for index, name in enumerate(self.parts)}
        self._planned: tuple[int, list[tuple[int, np.ndarray]]] | None = None

    def __len__(self) -> int:
        """Count the batches of an epoch."""
        return sum(group.batches for group in self.groups)

    def __repr__(self) -> str:
        return f"<ContrastiveBatches: {len(self)} an epoch. {self.describe()}>"

    def describe(self) -> str:
        """Say which groups there are, and what was left out and why."""
        said = [
            f"{group.sensor_model}, {group.pad_type or 'pad type not known'}: {len(group.parts)} "
            f"part(s), {f'{group.batches} batch(es)' if group.batches else 'too few for a batch'}"
            for group in self.groups
        ]
        said += [f"left out: {count} clip(s) {why}" for why, count in self.left_out.items()]
        return "; ".join(said)

    def _find_groups(self) -> list[tuple[ContrastiveGroup, _Members]]:
        by_kind: dict[tuple[str, str | None], dict[str, list[int]]] = {}
        for index, clip in enumerate(self.clips.table):
            if clip.part_id is None:
                self._leave_out("without a part id")
            elif clip.sensor_model is None:
                self._leave_out("without a sensor model")
            else:
                parts = by_kind.setdefault((clip.sensor_model, clip.pad_type), {})
                parts.setdefault(clip.part_id, []).append(index)
        found = []
        for kind in sorted(by_kind, key=lambda kind: (kind[0], kind[1] or "")):
            group = self._group(kind, by_kind[kind])
            if group is not None:
                found.append(group)
        return found

    def _group(
        self, kind: tuple[str, str | None], parts: dict[str, list[int]]
    ) -> tuple[ContrastiveGroup, _Members] | None:
        table = self.clips.table
        paired: dict[str, list[int]] = {}
        pairs = []
        for name in sorted(parts):
            episodes = {table[index].episode for index in parts[name]}
            if len(episodes) < 2:
                self._leave_out("of a part with one clip", len(parts[name]))
            else:
                paired[name] = parts[name]
                pairs.append(len(episodes) // 2)
        if not paired:
            return None
        count = batch_count(np.array(pairs), self._rules)
        group = ContrastiveGroup(*kind, tuple(paired), count)
        if not count:
            clips = sum(map(len, paired.values()))
            self._leave_out("of a group with too few parts", clips)
        chosen = np.array([index for clips in paired.values() for index in clips])
        part = np.repeat(np.arange(len(paired)), [len(clips) for clips in paired.values()])
        return group, _Members(chosen, part, np.array([table[i].episode for i in chosen]))

    def _leave_out(self, why: str, count: int = 1) -> None:
        self.left_out[why] = self.left_out.get(why, 0) + count

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch of plain integer indices.

        Parameters
        ----------
        epoch : int
        """
        self.epoch = epoch

    def plan(self, epoch: int) -> list[tuple[int, np.ndarray]]:
        """Return every batch of an epoch, in order; nothing is decoded.

        Parameters
        ----------
        epoch : int

        Returns
        -------
        list of (int, (P, 2) int64)
            Its group, and for each part two positions in ``clips.table``.
        """
        if self._planned is None or self._planned[0] != epoch:
            batches = [
                (number, pairs)
                for number, members in enumerate(self._members)
                for pairs in pair_batches(self.seed, epoch, *members, self._rules)
            ]
            self._planned = (epoch, shuffled_batches(self.seed, epoch, batches))
        return self._planned[1]

    def __getitem__(self, index: SupportsIndex | BatchIndex) -> Item:
        """Read one batch."""
        if isinstance(index, BatchIndex):
            epoch, number = index
        else:
            epoch, number = self.epoch, operator.index(index)
        if not -len(self) <= number < len(self):
            msg = f"batch {number} of {len(self)}"
            raise IndexError(msg)
        group, pairs = self.plan(epoch)[number]
        batch = self._batches.fill(pairs)
        if self._skips:
            batch = self._without_damage(batch, self._members[group])
        clips = batch["clip"][:, 0].tolist()
        part = [self._part_index[self._part_of(clip)] for clip in clips]
        return {**batch, "part": torch.tensor(part), "group": torch.tensor(group)}

    def _without_damage(self, batch: Item, members: _Members) -> Item:
        """Replace clips that are damaged, or leave their parts out."""
        pairs = batch["clip"].numpy()
        replaced = np.zeros_like(pairs)
        damaged: set[int] = set()
        while (bad := batch.pop("substituted").numpy() > 0).any():
            damaged.update(pairs[bad].tolist())
            other = [self._sound_pair(pair, members, damaged) for pair in pairs.tolist()]
            kept = np.array([pair is not None for pair in other])
            if kept.sum() < self._rules.least:
                raise DamagedDataError(
                    f"{len(damaged)} clip(s) of a batch of {len(pairs)} parts are damaged, and too "
                    "few others are there",
                    where=self.clips.dataset.path,
                    fix="See what is damaged: exumi validate --level data",
                )
            replaced = (replaced + bad)[kept]
            pairs = np.array([pair for pair in other if pair is not None])
            batch = self._batches.fill(pairs)
        return {**batch, "replaced": torch.from_numpy(replaced)}

    def _sound_pair(
        self, pair: list[int], members: _Members, damaged: set[int]
    ) -> list[int] | None:
        """Return a pair of the same part of which nothing is known to be damaged, or None."""
        if damaged.isdisjoint(pair):
            return pair
        part = self._part_of(pair[0])
        mine = [clip for clip in members.clips.tolist() if self._part_of(clip) == part]
        sound = [clip for clip in mine if clip not in damaged]
        # What is sound of the pair stays, in its place.
        for one, other in product(*([clip] if clip in sound else sound for clip in pair)):
            if self.clips.table[one].episode != self.clips.table[other].episode:
                return [one, other]
        return None

    def _part_of(self, clip: int) -> str:
        part_id = self.clips.table[clip].part_id
        assert part_id is not None  # noqa: S101  # clips without one are in no group
        return part_id

    def labels(self, batch: Item) -> list[tuple[Clip, Clip]]:
        """Return the two clips of each part of a batch: episode ids, objects, ratings.

        Parameters
        ----------
        batch : dict of str to Tensor
            As this object or its loader gave it.
        """
        table = self.clips.table
        return [(table[one], table[other]) for one, other in batch["clip"].tolist()]

    def loader(
        self,
        *,
        num_workers: int = 0,
        order: "BatchOrder | None" = None,
        **options: Any,
    ) -> DataLoader[Item]:
        """Make a DataLoader of whole batches.

        Parameters
        ----------
        num_workers : int
        order : BatchOrder, optional
            For several ranks, and to go on in the middle of an epoch.
        **options
            Passed on to `torch.utils.data.DataLoader`.
        """
        return DataLoader(
            self,
            batch_size=None,
            sampler=BatchOrder(self) if order is None else order,
            num_workers=num_workers,
            collate_fn=as_is,
            **options,
        )


class BatchOrder(EpochSampler[BatchIndex]):
    """The batches of an epoch, shared out among ranks, resumable.

    All ranks have the same number of batches, none of them twice: what is left over where the
    ranks do not divide them is another part of the data in each epoch.

    Parameters
    ----------
    batches : ContrastiveBatches
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

    Raises
    ------
    UsageError
        There are fewer batches than ranks.
    """

    def __init__(
        self, batches: ContrastiveBatches, *, rank: int = 0, world_size: int | None = None
    ) -> None:
        super().__init__(rank, world_size)
        if len(batches) < self._world:
            raise UsageError(f"{len(batches)} batch(es) an epoch for {self._world} ranks")
        self._batches = batches
        self._turns = len(batches) // self._world

    def _count(self, epoch: int) -> int:  # all epochs are alike
        return self._turns

    def _indices(self, epoch: int, start: int) -> Iterator[BatchIndex]:
        for turn in range(start, self._turns):
            yield BatchIndex(epoch, turn * self._world + self._rank)

    def _order_of(self) -> dict[str, Any]:
        """Return what the order of an epoch depends on."""
        return {
            "seed": self._batches.seed,
            "batches": len(self._batches),
            "world_size": self._world,
        }
