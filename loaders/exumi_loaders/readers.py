"""Frames of many episodes: readers are kept, open files are few."""

import resource
from collections import OrderedDict

import numpy as np

from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import ChangedDataError, MetadataError, NotAnEpisodeError, UnsupportedError
from exumi_data.store.access import OpenFiles, open_store
from exumi_data.store.images import Frames

__all__ = ["FrameReaders"]

_OPEN_FILES = 128, 1024  # at least, at most: to open one costs a sixth of decoding a frame
_SHARE = 16  # of what a process may have open
_KEPT = {"encoded": 2048, "array": 2048}
_KEPT_VIDEO = 8  # each holds a whole video file and a decoder


class FrameReaders:
    """Read frames and reference images by (episode, stream).

    Parameters
    ----------
    dataset : Dataset
    encodings : dict of str to str
        How each image stream is stored: decides how many readers are kept.
    roots : (E, 32) uint8, optional
        SHA-256 of the root documents that episodes have to have: `Timeline.roots`.
    """

    def __init__(
        self, dataset: Dataset, encodings: dict[str, str], roots: np.ndarray | None = None
    ) -> None:
        self._locations = [dataset.episode_location(index) for index in range(len(dataset))]
        self._roots = roots
        self._kept = {name: _KEPT.get(kind, _KEPT_VIDEO) for name, kind in encodings.items()}
        self._files = OpenFiles(_most_open_files())
        self._readers: dict[str, OrderedDict[int, tuple[Frames, np.ndarray | None]]] = {
            name: OrderedDict() for name in encodings
        }
        self._last: tuple[int, Episode] | None = None

    def __getstate__(self) -> dict[str, object]:
        return {"locations": self._locations, "kept": self._kept, "roots": self._roots}

    def __setstate__(self, state: dict[str, object]) -> None:
        self._locations = state["locations"]  # type: ignore[assignment]  # as __getstate__ wrote
        self._kept = state["kept"]  # type: ignore[assignment]
        self._roots = state["roots"]  # type: ignore[assignment]
        self._files = OpenFiles(_most_open_files())
        self._readers = {name: OrderedDict() for name in self._kept}
        self._last = None

    def location(self, episode: int) -> str:
        """Return the full path of an episode."""
        return self._locations[episode]

    def get(self, episode: int, stream: str) -> tuple[Frames, np.ndarray | None]:
        """Return the frames of a stream, and its reference image (H, W, C) or None.

        Raises
        ------
        ChangedDataError
            The episode is gone, or is not the one that the timeline was made of.
        DamagedDataError
        """
        readers = self._readers[stream]
        found = readers.get(episode)
        if found is not None:
            readers.move_to_end(episode)
            return found
        view = self.episode(episode)[stream]
        found = (view.frames, view.reference if view.kind == "tactile" else None)
        readers[episode] = found
        if len(readers) > self._kept[stream]:
            readers.popitem(last=False)
        return found

    def episode(self, episode: int) -> Episode:
        """Return an episode; of several calls in a row for the same one it is opened once.

        Raises
        ------
        ChangedDataError
            As of `get`.
        """
        if self._last is None or self._last[0] != episode:
            # A window asks for several streams of one episode: its metadata is read once.
            self._last = (episode, self._open(episode))
        return self._last[1]

    def _open(self, episode: int) -> Episode:
        location = self._locations[episode]
        try:
            opened = Episode(open_store(location, self._files))
        except (NotAnEpisodeError, MetadataError, UnsupportedError) as error:
            raise _changed(location, f"can no longer be read ({error.what})") from error
        if (
            self._roots is not None
            and opened.root_sha256 != np.asarray(self._roots[episode]).tobytes().hex()
        ):
            raise _changed(location, "is another revision than the one these windows were made of")
        return opened


def _most_open_files() -> int:
    allowed, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    least, most = _OPEN_FILES
    if allowed == resource.RLIM_INFINITY:
        return most
    return min(max(allowed // _SHARE, least), most)


def _changed(location: str, what: str) -> ChangedDataError:
    return ChangedDataError(
        what,
        where=location,
        fix="Write the catalog again (exumi index) and open the dataset again; while it is read, "
        "nothing may write to it.",
    )
