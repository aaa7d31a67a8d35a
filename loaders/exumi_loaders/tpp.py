"""Windows for Tactile Prediction Pretraining (exUMI)."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from exumi_data.errors import UsageError
from exumi_data.splits import split_ids
from exumi_data.ticks import DEFAULT_TICK_S
from exumi_loaders.actions import (
    action_columns,
    between_columns,
    between_grippers,
    relative_actions,
)
from exumi_loaders.buffers import BatchBuffers
from exumi_loaders.draws import history_steps
from exumi_loaders.layout import Names, choose_layout
from exumi_loaders.readers import FrameReaders
from exumi_loaders.sampler import WindowIndex, WindowSampler
from exumi_loaders.timeline import TimelineSettings, build_timeline
from exumi_loaders.timeline_cache import default_cache

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["TPPWindows"]

STEPS = np.arange(-15, 17)
"""Action steps of a window, in ticks: 16 of history (with 0) and 16 of future."""
_HISTORY = STEPS[:16]
_FIXED_HISTORY = np.array([-12, -8, -4, 0])
_FUTURE = np.array([4, 8, 12, 16])

Item = dict[str, Tensor]


def _as_is(batch: Any) -> Any:
    """Collate function of the loader: ``__getitems__`` has filled the batch already."""
    return batch


class TPPWindows(Dataset[Item]):
    """Windows of tactile frames, one RGB frame and relative actions on a common timeline.

    A window lies around one tick, its step 0. It holds

    - 8 frames of each tactile stream: 4 of the history (drawn without replacement from steps
      −15..0, ascending) and 4 of the future (steps 4, 8, 12, 16);
    - 1 frame of each RGB stream, at step 0;
    - actions at steps −15..16: of each gripper ``inv(T_0)·T_t`` as xyz and the first two rows of
      its rotation matrix, and its absolute width: 10 numbers (9 without width, 1 without pose);
    - with several grippers, where the others are as seen from the first one at step 0.

    Every item is a dict of tensors (a batch has one more axis in front):

    ======================  =======================  =========================================
    key                     shape, dtype             meaning
    ======================  =======================  =========================================
    ``<image stream>``      (K, C, H, W) uint8       frames, K = 8 tactile or 1 RGB
    ``<stream>_valid``      (K,) bool                a frame lies within the tolerance
    ``<stream>_reference``  (C, H, W) uint8          image without contact (tactile)
    ``tactile_steps``       (8,) int64               step of each tactile frame
    ``action``              (32, 10·G) float32       `action_columns` of G grippers
    ``action_valid``        (32,) bool               no sample gap there, and no padding
    ``between``             (32, 9·(G−1)) float32    `between_columns`; of several poses only
    ``between_valid``       (32,) bool               as ``action_valid``
    ``padding``             (32,) bool               the step lies outside the episode
    ``valid``               () bool                  everything above is valid, nothing padded
    ``episode``             () int64                 position in ``windows.episodes``
    ``time_ns``             () int64                 time of step 0 since the episode's start
    ======================  =======================  =========================================

    Keys of streams that the dataset does not have are not there. Steps outside the episode repeat
    its first or last tick and are marked in ``padding``; a frame with no neighbour within the
    tolerance is black and marked in ``<stream>_valid``.

    Parameters
    ----------
    dataset : exumi_data.Dataset
        With frames of one size: ``exumi prepare`` makes them.
    split : str, optional
        ``train`` or ``val`` of a split made on the fly, or ``<name>/<list>`` of a split stored
        with the dataset.
    split_by : {"episode", "object", "part"}
        What is kept together by a split made on the fly.
    split_ratio : (int, int)
        Train to val; 15:1 in exUMI.
    tactile, rgb, pose, width : str or sequence of str, optional
        Streams in the wanted order; default all of the kind, sorted by name. An empty sequence
        takes none.
    grey_tactile : bool
        Give one channel (luma) of tactile frames that are stored in colour.
    random_history : bool
        False takes steps −12, −8, −4, 0.
    edges : {"pad", "drop"}
        Whether every tick is the step 0 of a window, or only those whose steps all lie within
        the episode (an episode that is too short for any gives one padded window at its middle).
    stride : int
        Distance of windows in ticks.
    activity : {"all", "future"}
        What makes a window active: any tactile frame of its span, or one at a future step.
    tick_s : fractions.Fraction or float
        Distance of two ticks; default 3/59.94 s.
    image_tolerance_s, max_gap_s : float, optional
        See `TimelineSettings`.
    active_above : float, optional
        Activity above which a frame is active; default what is stored with the activity.
    seed : int
        Of history draws and splits. Draws are a pure function of (seed, epoch, index).
    cache : bool or path
        Keep the timelines in the user's cache folder (default), in a given folder, or nowhere.

    Raises
    ------
    UsageError
        Streams are missing or differ in size; no activity is stored but asked for.

    Examples
    --------
    >>> windows = TPPWindows(exumi_data.open("training-set"), split="train")  # doctest: +SKIP
    >>> for batch in windows.loader(batch_size=64, reject_inactive=0.9):  # doctest: +SKIP
    ...     batch["tactile_left"].shape
    torch.Size([64, 8, 1, 224, 224])
    """

    def __init__(  # noqa: PLR0913  # keyword-only options, each with a default
        self,
        dataset: "EpisodeDataset",
        *,
        split: str | None = None,
        split_by: Literal["episode", "object", "part"] = "episode",
        split_ratio: tuple[int, int] = (15, 1),
        tactile: Names = None,
        rgb: Names = None,
        pose: Names = None,
        width: Names = None,
        grey_tactile: bool = False,
        random_history: bool = True,
        edges: Literal["pad", "drop"] = "pad",
        stride: int = 1,
        activity: Literal["all", "future"] = "all",
        tick_s: Fraction | float = DEFAULT_TICK_S,
        image_tolerance_s: float | None = None,
        max_gap_s: float | None = None,
        active_above: float | None = None,
        seed: int = 0,
        cache: bool | str | Path = True,
    ) -> None:
        _one_of("edges", edges, ("pad", "drop"))
        _one_of("activity", activity, ("all", "future"))
        if stride < 1:
            raise UsageError(f"stride is {stride}, not a positive number of ticks")
        if split is not None:
            ids = split_ids(dataset, split, by=split_by, ratio=split_ratio, seed=seed)
            dataset = dataset.select(ids)
        self.episodes = dataset
        self.epoch = 0
        self._seed = seed
        self._random_history = random_history
        self._activity = activity
        layout = choose_layout(
            dataset,
            tactile=tactile,
            rgb=rgb,
            pose=pose,
            width=width,
        )
        settings = TimelineSettings(
            Fraction(tick_s).limit_denominator(10**9), image_tolerance_s, max_gap_s, active_above
        )
        folder = default_cache() if cache is True else Path(cache) if cache else None
        self.timeline = build_timeline(dataset, layout, settings, cache=folder)
        self.layout = self.timeline.layout
        self._channels = {
            name: 1 if grey_tactile and name in self.layout.tactile else shape[2]
            for name, shape in self.layout.shapes.items()
        }
        self._anchors, self._episode = _anchors(self.timeline.edges, edges, stride)
        self._motion = self._choose_motion(dataset.path)
        self._readers = FrameReaders(dataset, self.timeline.encodings)
        self._buffers = BatchBuffers()

    def _choose_motion(self, path: str) -> list[tuple[str, Any]]:
        motion: list[tuple[str, Any]] = []
        if self.layout.low:
            motion.append(("action", relative_actions))
        if len(self.layout.pose) > 1:
            if not self.layout.common_parent:
                raise UsageError(
                    f"{', '.join(self.layout.pose)} have different parent frames: where one "
                    "gripper is to the other is not known",
                    where=path,
                    fix=f"Name the poses that belong together: pose={self.layout.pose[:1]}.",
                )
            motion.append(("between", between_grippers))
        return motion

    @property
    def action_columns(self) -> tuple[str, ...]:
        """Name of each column of ``action``: one gripper after the other, pose then width."""
        return action_columns(self.layout)

    @property
    def between_columns(self) -> tuple[str, ...]:
        """Name of each column of ``between``."""
        return between_columns(self.layout)

    def __len__(self) -> int:
        return len(self._anchors)

    def __repr__(self) -> str:
        streams = ", ".join(self.layout.streams)
        return f"<TPPWindows: {len(self)} windows of {len(self.episodes)} episodes ({streams})>"

    @property
    def active(self) -> np.ndarray:
        """(len(self),) bool: which windows are active, from stored activity.

        Raises
        ------
        UsageError
            Not all episodes have stored activity.
        """
        timeline = self.timeline
        flags = timeline.active_all if self._activity == "all" else timeline.active_future
        if flags is None:
            raise UsageError(
                "not all episodes have stored tactile activity",
                where=self.episodes.path,
                fix="Convert or prepare them with exUMI Data, which computes it once.",
            )
        return np.asarray(flags[self._anchors])

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
        dict of str to Tensor
            Each with a first axis of ``len(indices)``.
        """
        epochs, chosen = self._resolve(indices)
        episode = self._episode[chosen]
        anchor = self._anchors[chosen]
        first = self.timeline.edges[episode]
        last = self.timeline.edges[episode + 1] - 1

        def ticks(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return flat ticks of some steps, and which lie outside the episode."""
            wanted = anchor[:, None] + steps
            inside = np.clip(wanted, first[:, None], last[:, None])
            return inside, wanted != inside

        batch: Item = {}
        complete = np.ones(len(chosen), dtype=bool)
        if self.layout.tactile:
            steps = self._tactile_steps(epochs, chosen)
            at, _ = ticks(steps)
            for name in self.layout.tactile:
                complete &= self._add_frames(batch, name, episode, at)
            batch["tactile_steps"] = torch.from_numpy(steps)
        for name in self.layout.rgb:
            complete &= self._add_frames(batch, name, episode, anchor[:, None])
        at, padding = ticks(STEPS[None])
        complete &= ~padding.any(axis=1)
        for name, compute in self._motion:
            values, valid = compute(self.timeline, at, zero=len(_HISTORY) - 1)
            valid &= ~padding
            complete &= valid.all(axis=1)
            batch[name] = torch.from_numpy(values)
            batch[f"{name}_valid"] = torch.from_numpy(valid)
        batch["padding"] = torch.from_numpy(padding)
        batch["valid"] = torch.from_numpy(complete)
        batch["episode"] = torch.from_numpy(episode)
        offset = self.timeline.tick_offset_ns(anchor - first)
        batch["time_ns"] = torch.from_numpy(self.timeline.start_ns[episode] + offset)
        return batch

    def _resolve(
        self, indices: Sequence[SupportsIndex | WindowIndex]
    ) -> tuple[np.ndarray, np.ndarray]:
        epochs = np.empty(len(indices), dtype=np.int64)
        chosen = np.empty(len(indices), dtype=np.int64)
        for position, item in enumerate(indices):
            if isinstance(item, WindowIndex):
                epochs[position], index = item
            else:
                epochs[position], index = self.epoch, item.__index__()
            if not -len(self) <= index < len(self):
                msg = f"window {index} of {len(self)}"
                raise IndexError(msg)
            chosen[position] = index % len(self)
        return epochs, chosen

    def _tactile_steps(self, epochs: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        if self._random_history:
            history = history_steps(self._seed, epochs, chosen, steps=_HISTORY, count=4)
        else:
            history = np.broadcast_to(_FIXED_HISTORY, (len(chosen), 4))
        future = np.broadcast_to(_FUTURE, (len(chosen), 4))
        return np.concatenate((history, future), axis=1)

    def _add_frames(
        self, batch: Item, name: str, episode: np.ndarray, at: np.ndarray
    ) -> np.ndarray:
        """Decode the frames nearest to ticks `at` (B, K) into one buffer.

        Returns
        -------
        (B,) bool
            Whether all frames of each window are there.
        """
        frames = self.timeline.frame[name][at]
        height, width, _ = self.layout.shapes[name]
        size = (height, width, self._channels[name])
        # One buffer for the batch, in the order that JPEG decoders write: torch sees it as
        # channels-last images without a copy.
        buffer, out = self._buffers.take((*frames.shape, *size))
        references = reference_out = None
        if self.layout.references.get(name, False):
            references, reference_out = self._buffers.take((len(frames), *size))
        complete = np.asarray((frames >= 0).all(axis=1))
        for position, (number, wanted) in enumerate(zip(episode, frames, strict=True)):
            source, reference = self._readers.get(int(number), name)
            if complete[position]:
                source.read_into(wanted.tolist(), out[position])
            else:
                out[position] = 0
                for k in np.flatnonzero(wanted >= 0):
                    source.read_into(wanted[k : k + 1], out[position, k : k + 1])
            if reference_out is not None and reference is not None:
                reference_out[position] = _like(reference, size[2])
        batch[name] = buffer.movedim(-1, -3)
        batch[f"{name}_valid"] = torch.from_numpy(frames >= 0)
        if references is not None:
            batch[f"{name}_reference"] = references.movedim(-1, -3)
        return complete

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
            sampler = WindowSampler(
                self, shuffle=shuffle, seed=self._seed, reject_inactive=reject_inactive
            )
        return DataLoader(
            self,
            batch_size=batch_size,
            sampler=sampler,
            drop_last=drop_last,
            num_workers=num_workers,
            collate_fn=_as_is,
            **options,
        )


def _like(reference: np.ndarray, channels: int) -> np.ndarray:
    if reference.shape[2] == channels:
        return reference
    from exumi_data.tactile import to_grey  # OpenCV, only for mixed channels

    return np.asarray(to_grey(reference)[..., None])


def _anchors(edges: np.ndarray, mode: str, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the flat tick of each window's step 0, and its episode; both (W,) int64."""
    anchors = []
    owners = []
    for episode in range(len(edges) - 1):
        first, end = int(edges[episode]), int(edges[episode + 1])
        if first == end:
            continue
        if mode == "pad":
            found = np.arange(first, end, stride)
        else:
            found = np.arange(first - STEPS[0], end - STEPS[-1], stride)
            if not len(found):
                found = np.array([(first + end - 1) // 2])
        anchors.append(found)
        owners.append(np.full(len(found), episode))
    if not anchors:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    return np.concatenate(anchors).astype(np.int64), np.concatenate(owners).astype(np.int64)


def _one_of(name: str, value: str, supported: tuple[str, ...]) -> None:
    if value not in supported:
        raise UsageError(
            f"invalid {name} ({value!r}). Supported values are {', '.join(map(repr, supported))}"
        )
