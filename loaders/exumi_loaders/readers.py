"""Frames of many episodes: readers are kept, open files are few."""

import resource
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import (
    ChangedDataError,
    ExumiError,
    MetadataError,
    NotAnEpisodeError,
    UnreachableError,
    UnsupportedError,
)
from exumi_data.store.access import OpenFiles, Store, open_store, open_stores
from exumi_data.store.images import Frames
from exumi_data.store.remote.address import is_url

if TYPE_CHECKING:
    from exumi_data.store.remote.reading import Identity

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
    identities : mapping of str to Identity, optional
        Of remote episodes, by location, which objects they have to be, as far as that is known.

    Attributes
    ----------
    is_remote : bool
        Whether episodes are behind URLs.
    """

    def __init__(
        self,
        dataset: Dataset,
        encodings: dict[str, str],
        roots: np.ndarray | None = None,
        identities: "Mapping[str, Identity] | None" = None,
    ) -> None:
        self._locations = [dataset.episode_location(index) for index in range(len(dataset))]
        self.is_remote = any(map(is_url, self._locations))
        self._identities = dict(identities or {})
        self._roots = roots
        self._kept = {name: _KEPT.get(kind, _KEPT_VIDEO) for name, kind in encodings.items()}
        self._files = OpenFiles(_most_open_files())
        self._readers: dict[str, OrderedDict[int, tuple[Frames, np.ndarray | None]]] = {
            name: OrderedDict() for name in encodings
        }
        self._last: tuple[int, Episode] | None = None

    def __getstate__(self) -> dict[str, object]:
        return {
            "locations": self._locations,
            "kept": self._kept,
            "roots": self._roots,
            "is_remote": self.is_remote,
            "identities": self._identities,
        }

    def __setstate__(self, state: dict[str, object]) -> None:
        self._locations = state["locations"]  # type: ignore[assignment]  # as __getstate__ wrote
        self._kept = state["kept"]  # type: ignore[assignment]
        self._roots = state["roots"]  # type: ignore[assignment]
        self.is_remote = state["is_remote"]  # type: ignore[assignment]
        self._identities = state["identities"]  # type: ignore[assignment]
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
        return self._keep(episode, stream, self.episode(episode))

    def _keep(self, episode: int, stream: str, opened: Episode) -> tuple[Frames, np.ndarray | None]:
        view, readers = opened[stream], self._readers[stream]
        found = (view.frames, view.reference if view.kind == "tactile" else None)
        readers[episode] = found
        if len(readers) > self._kept[stream]:
            readers.popitem(last=False)
        return found

    def open_together(self, episodes: np.ndarray, streams: Iterable[str]) -> None:
        """Open remote episodes at once: one after the other, each would be waited for.

        What is wrong with one of them is said by `get`.

        Parameters
        ----------
        episodes : (B,) int
        streams : iterable of str
            Those that will be read.

        Raises
        ------
        UnreachableError
            The server does not answer or does not let us in.
        """
        if not self.is_remote:
            return
        names = list(streams)
        new = [
            episode
            for episode in np.unique(episodes).tolist()
            if any(episode not in self._readers[name] for name in names)
        ]
        stores = open_stores([self._locations[episode] for episode in new], self._identities)
        for episode, store in zip(new, stores, strict=True):
            try:
                opened = self._checked(episode, store)
                for name in names:
                    if name in opened and episode not in self._readers[name]:
                        source, _ = self._keep(episode, name, opened)
                        source.get_ready()
            except UnreachableError:
                raise
            except ExumiError:
                continue

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
            if self.is_remote:
                (store,) = open_stores([location], self._identities)
            else:
                store = open_store(location, self._files)
        except NotAnEpisodeError as error:
            raise _changed(location, f"can no longer be read ({error.what})") from error
        return self._checked(episode, store)

    def _checked(self, episode: int, store: Store) -> Episode:
        """Return an episode that is the one which is expected."""
        location = self._locations[episode]
        try:
            opened = Episode(store)
        except (NotAnEpisodeError, MetadataError, UnsupportedError) as error:
            raise _changed(location, f"can no longer be read ({error.what})") from error
        if (
            self._roots is not None
            and opened.root_sha256 != np.asarray(self._roots[episode]).tobytes().hex()
        ):
            raise _changed(location, "is another revision than the one these windows were made of")
        if store.identity is not None:
            self._identities[location] = store.identity
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
