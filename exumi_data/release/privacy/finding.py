"""What in a dataset may be private."""

import os
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

from exumi_data.catalog import list_episodes
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.engine import map_items
from exumi_data.errors import NotAnEpisodeError
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, load_json
from exumi_data.model.json_limits import MAX_LIST_PARTS
from exumi_data.release.privacy.documents import Removal, people_named, without_private_fields
from exumi_data.release.privacy.kinds import Kind, PrivateItem, shortened
from exumi_data.release.privacy.scanning import scan_store
from exumi_data.store.access import Store, open_store
from exumi_data.store.plain_files import read_plain

__all__ = ["find_private", "people_of", "private_in"]

_MANY_EPISODES = 200
_EPISODE_DOCUMENT = "zarr.json"


def find_private(
    root: str | os.PathLike[str],
    *,
    workers: int | None = None,
    on_done: Callable[[int], None] | None = None,
) -> list[PrivateItem]:
    """List what in a dataset, or in an episode, may be private. Nothing is changed.

    Looked at are all strings of all documents; of video files the table of contents and the
    metadata tracks; of JPEG frames the segments before the picture. What pictures show, what sound
    holds and what is in other files of the folder is not looked at.

    Parameters
    ----------
    root : path-like
        The dataset's folder, or an episode.
    workers : int, optional
        Processes. Default: one for up to 200 episodes, else all cores.
    on_done : callable, optional
        Told how many episodes are done.

    Returns
    -------
    list of PrivateItem
        In order of episodes; what an episode says in many places of one file is listed once.

    Raises
    ------
    ExumiError
        Something cannot be read: what was not looked at must not pass for clean.
    """
    folder = Path(root)
    if not (folder / DATASET_DOCUMENT).is_file():
        return _of_episode("", root=str(folder), names={})
    names = people_of(folder, workers=workers)
    found = list(_of_dataset(folder, names))
    paths = list_episodes(folder)
    episodes: dict[str, list[PrivateItem]] = {}
    work = partial(_of_episode, root=str(folder), names=names)
    for outcome in map_items(work, paths, workers=_processes(paths, workers)):
        if outcome.error is not None:
            raise outcome.error
        episodes[outcome.item] = outcome.value or []
        if on_done is not None:
            on_done(len(episodes))
    return found + [item for path in paths for item in episodes[path]]


def people_of(root: str | os.PathLike[str], *, workers: int | None = None) -> dict[str, Kind]:
    """Return the people whom any document of a dataset names as such, for `Removal`.

    Parameters
    ----------
    root : path-like
        The dataset's folder.
    workers : int, optional
        Processes. Default: one for up to 200 episodes, else all cores.

    Returns
    -------
    dict of str to str
        Names, in order, and the kind of each.

    Raises
    ------
    ExumiError
        Something cannot be read.
    """
    folder = Path(root)
    found = people_named(load_json(_dataset_bytes(folder), folder / DATASET_DOCUMENT))
    paths = list_episodes(folder)
    work = partial(_people_of_episode, root=str(folder))
    for outcome in map_items(work, paths, workers=_processes(paths, workers)):
        if outcome.error is not None:
            raise outcome.error
        found |= outcome.value or {}
    return dict(sorted(found.items()))


def _dataset_bytes(root: Path) -> bytes:
    return read_plain(root / DATASET_DOCUMENT, MAX_DOCUMENT_BYTES)


def _processes(paths: list[str], workers: int | None) -> int | None:
    return 1 if workers is None and len(paths) <= _MANY_EPISODES else workers


def _people_of_episode(path: str, *, root: str) -> dict[str, Kind]:
    store = open_store(f"{root}/{path}")
    try:
        return people_named(load_json(store.read(_EPISODE_DOCUMENT), f"{root}/{path}"))
    except FileNotFoundError:
        raise NotAnEpisodeError(
            "no zarr.json: not an exUMI Episode, or one that was never finished",
            where=f"{root}/{path}",
            fix=f"Take out what cannot be read with: exumi dataset remove {root} --unreadable "
            "--reason WHY",
        ) from None
    finally:
        store.close()


def private_in(
    store: Store, episode: str = "", names: Mapping[str, Kind] | None = None
) -> list[PrivateItem]:
    """List what in an episode may be private.

    Parameters
    ----------
    store : Store
    episode : str, optional
        Its path, for the items.
    names : mapping of str to str, optional
        People whom other documents name, and the kind of each.
    """
    found: dict[PrivateItem, None] = {}
    scan_store(store, _Lister(found, episode), Removal(frozenset(), names=names or {}))
    return list(found)


def _of_episode(path: str, *, root: str, names: Mapping[str, Kind]) -> list[PrivateItem]:
    store = open_store(f"{root}/{path}" if path else root)
    try:
        return private_in(store, path, names)
    except FileNotFoundError:
        raise NotAnEpisodeError("neither a dataset nor an episode", where=root) from None
    finally:
        store.close()


def _of_dataset(root: Path, names: Mapping[str, Kind]) -> Iterator[PrivateItem]:
    documents = [DATASET_DOCUMENT]
    documents += sorted(f"splits/{path.name}" for path in (root / "splits").glob("*.json"))
    for name in documents:
        found: dict[PrivateItem, None] = {}
        raw = read_plain(root / name, MAX_DOCUMENT_BYTES)
        document = load_json(raw, root / name, most_parts=MAX_LIST_PARTS)
        nothing = Removal(frozenset(), names=names)
        without_private_fields(document, name, _Lister(found, ""), nothing)
        yield from found


class _Lister:
    """Writes down what it is told of, and takes nothing."""

    def __init__(self, found: dict[PrivateItem, None], episode: str) -> None:
        self._found, self._episode = found, episode

    def __call__(
        self, kind: Kind, where: str, value: str, why: str, *, removable: bool = True
    ) -> bool:
        self._found[PrivateItem(kind, self._episode, where, shortened(value), why, removable)] = (
            None
        )
        return False
