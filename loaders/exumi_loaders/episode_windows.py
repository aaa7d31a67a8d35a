"""What windows of one dataset have in common: their episodes, timeline, and damaged frames."""

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.splits import split_ids
from exumi_loaders.draws import words
from exumi_loaders.layout import Layout
from exumi_loaders.options import one_of, require_dataset
from exumi_loaders.readers import FrameReaders
from exumi_loaders.reading_ahead import parts_at_hand
from exumi_loaders.steps import window_anchors
from exumi_loaders.timeline import TimelineSettings, build_timeline
from exumi_loaders.timeline_cache import default_cache
from exumi_loaders.window_frames import OnCorrupt, read_frames
from exumi_loaders.windows import Windows

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["EpisodeWindows"]

_REPLACEMENT = 21  # a purpose of draws, see draws.py
_MOST_REPLACEMENTS = 100


class EpisodeWindows(Windows):
    """Windows around the ticks of one dataset's episodes; what they hold is for a subclass to say.

    A subclass calls `_select`, chooses a layout, and calls `_open`.

    Parameters
    ----------
    edges : {"pad", "drop"}
        Whether every tick is the step 0 of a window, or only those whose steps all lie within
        the episode.
    stride : int
        Distance of windows in ticks.
    on_corrupt : {"raise", "skip", "substitute"}
        What happens at damaged data.
    seed : int
        Of draws and splits.

    Attributes
    ----------
    episodes : exumi_data.Dataset
        Those of the split.
    split : str or None
    timeline : Timeline
    layout : Layout
    """

    def __init__(
        self, *, edges: Literal["pad", "drop"], stride: int, on_corrupt: OnCorrupt, seed: int
    ) -> None:
        super().__init__(seed)
        one_of("edges", edges, ("pad", "drop"))
        one_of("on_corrupt", on_corrupt, ("raise", "skip", "substitute"))
        if stride < 1:
            raise UsageError(f"stride is {stride}, not a positive number of ticks")
        self._edges = edges
        self._stride = stride
        self._on_corrupt: OnCorrupt = on_corrupt
        self._activity: Literal["all", "future"] = "all"

    def _select(
        self,
        dataset: "EpisodeDataset",
        split: str | None,
        by: Literal["episode", "object", "part"],
        ratio: tuple[int, int],
    ) -> None:
        require_dataset(dataset)
        if split is not None:
            ids = split_ids(dataset, split, by=by, ratio=ratio, seed=self._seed)
            if not ids:
                raise UsageError(f"the split {split!r} holds no episodes", where=dataset.path)
            dataset = dataset.select(ids)
        self.split = split
        self.episodes = dataset

    def _open(self, layout: Layout, settings: TimelineSettings, cache: bool | str | Path) -> None:
        folder = default_cache() if cache is True else Path(cache) if cache else None
        self.timeline = build_timeline(self.episodes, layout, settings, cache=folder)
        self.layout = self.timeline.layout
        self._check_parents()
        self._anchors, self._episode = window_anchors(
            self.timeline.edges, self._edges, self._stride, settings.span
        )
        self._readers = FrameReaders(
            self.episodes, self.timeline.encodings, self.timeline.roots, self.timeline.identities
        )

    def _check_parents(self) -> None:
        layout = self.layout
        if len(layout.pose) > 1 and not layout.common_parent:
            raise UsageError(
                f"{', '.join(layout.pose)} have different parent frames: where one gripper is to "
                "the other is not known",
                where=self.episodes.path,
                fix=f"Name the poses that belong together: pose={layout.pose[:1]}.",
            )

    def __len__(self) -> int:
        return len(self._anchors)

    def __repr__(self) -> str:
        streams = ", ".join(self.layout.streams)
        name = type(self).__name__
        return f"<{name}: {len(self)} windows of {len(self.episodes)} episodes ({streams})>"

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
        damaged = self._fill_parts(arrays, rows, epochs, at)
        if self._on_corrupt == "substitute":
            arrays["substituted"][rows] = damaged
        if self._on_corrupt != "skip":
            return
        tries = 0
        while damaged.any():
            tries += 1
            again = damaged > 0
            rows, epochs, at = rows[again], epochs[again], at[again]
            if tries > _MOST_REPLACEMENTS:
                raise DamagedDataError(
                    f"window {at[0]} and {_MOST_REPLACEMENTS} that were drawn to replace it are "
                    "damaged",
                    where=self.episodes.path,
                    fix="See what is damaged: exumi validate --level data",
                )
            arrays["replaced"][rows] = tries
            at_instead = self._replacements(epochs, at, tries)
            damaged = self._fill_parts(arrays, rows, epochs, at_instead)

    def _fill_parts(
        self, arrays: Mapping[str, np.ndarray], rows: np.ndarray, epochs: np.ndarray, at: np.ndarray
    ) -> np.ndarray:
        """Fill rows, those of remote episodes part by part: see `parts_at_hand`."""
        if not self._readers.is_remote:
            return self._fill(arrays, rows, epochs, at)
        damaged = np.zeros(len(at), dtype=np.int64)
        wanted = self._frames(epochs, at)
        for part in parts_at_hand(self._readers, self._episode[at], wanted):
            damaged[part] = self._fill(arrays, rows[part], epochs[part], at[part])
        return damaged

    @abstractmethod
    def _frames(self, epochs: np.ndarray, at: np.ndarray) -> dict[str, np.ndarray]:
        """Return of each image stream the frames of windows, (R, K) int; -1 is none."""

    @abstractmethod
    def _fill(
        self, arrays: Mapping[str, np.ndarray], rows: np.ndarray, epochs: np.ndarray, at: np.ndarray
    ) -> np.ndarray:
        """Fill rows; return how many frames of each are damaged, (R,) int."""

    def _ticks(self, at: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return flat ticks of some steps of windows, and which lie outside the episode.

        Those repeat the episode's first or last tick.
        """
        episode = self._episode[at]
        first, last = self.timeline.edges[episode], self.timeline.edges[episode + 1] - 1
        flat = self._anchors[at][:, None] + steps
        inside = np.clip(flat, first[:, None], last[:, None])
        return inside, flat != inside

    def _time_ns(self, at: np.ndarray) -> np.ndarray:
        """Return the time of step 0 of windows, since their episode's start."""
        timeline, episode = self.timeline, self._episode[at]
        tick = self._anchors[at] - timeline.edges[episode]
        return np.asarray(timeline.start_ns[episode] + timeline.tick_offset_ns(tick))

    def _replacements(self, epochs: np.ndarray, at: np.ndarray, tries: int) -> np.ndarray:
        """Draw other windows, each as active as the one that it stands for."""
        drawn = words(self._seed, epochs, at, tries, purpose=_REPLACEMENT)[:, -1]
        try:
            active = self.active
        except UsageError:  # no activity is stored: all windows are alike
            return np.asarray(drawn % np.uint64(len(self)), dtype=np.int64)
        out = np.empty(len(at), dtype=np.int64)
        for kind in (False, True):
            mine = active[at] == kind
            if mine.any():
                pool = np.flatnonzero(active == kind)
                out[mine] = pool[drawn[mine] % np.uint64(len(pool))]
        return out

    def _add_frames(  # what, where from, where to
        self,
        arrays: Mapping[str, np.ndarray],
        name: str,
        rows: np.ndarray,
        at: np.ndarray,
        frames: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Decode frames (R, K) of windows `at`; -1 leaves one black.

        Returns
        -------
        there : (R, K) bool
            Decoded.
        damaged : (R,) int
            How many are damaged.
        """
        outcome = read_frames(
            self._readers,
            name,
            self._episode[at],
            frames,
            rows,
            arrays[name],
            arrays.get(f"{name}_reference"),
            on_corrupt=self._on_corrupt,
        )
        arrays[f"{name}_valid"][rows] = outcome.there
        return outcome.there, outcome.damaged.sum(axis=1)
