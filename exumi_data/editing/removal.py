"""Episodes taken out of a dataset; of each a tombstone stays, with the reason."""

import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exumi_data.catalog import build_catalog
from exumi_data.dataset import DATASET_DOCUMENT, Dataset
from exumi_data.editing.copying import chosen_of
from exumi_data.editing.documents import write_splits
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, parse_dataset
from exumi_data.store.files import sync_folder, write_atomic
from exumi_data.store.plain_files import read_plain

if TYPE_CHECKING:
    from exumi_data.engine import Outcome

__all__ = [
    "TOMBSTONE",
    "find_unreadable",
    "id_in_name",
    "remove_episodes",
    "remove_unreadable",
]

TOMBSTONE = ".removed-"
"""``.removed-<id>.json`` stays beside where an episode was: what it was, and why it went."""


def remove_episodes(
    dataset: Dataset,
    ids: Sequence[str],
    reason: str,
    *,
    on_done: Callable[[int], None] = lambda _done: None,
) -> None:
    """Remove episodes: from the splits first, then one by one, each at once.

    Parameters
    ----------
    dataset : Dataset
    ids : sequence of str
    reason : str
    on_done : callable
        Told how many are done.
    """
    _shorten_splits(dataset, set(ids))
    for number, one in enumerate(chosen_of(dataset, ids)):
        known = {"id": one.id, "revision": one.row["revision"], "digest": one.row["digest"]}
        _remove(one.path, {**known, "reason": reason})
        on_done(number + 1)


def find_unreadable(
    root: Path, on_done: Callable[[int], None] = lambda _done: None
) -> tuple[Dataset, dict[str, str]]:
    """Read every episode of a dataset, as far as its catalog needs it.

    Parameters
    ----------
    root : pathlib.Path
    on_done : callable
        Told how many are read.

    Returns
    -------
    dataset : Dataset
        Of those that can be read.
    unreadable : dict of str to str
        Path of an episode that cannot be read, below the dataset, and why.

    Raises
    ------
    MetadataError, UnsupportedError
        ``dataset.json`` breaks the standard, or is newer.
    FileNotFoundError
        There is none.
    """
    document = root / DATASET_DOCUMENT
    metadata = parse_dataset(read_plain(document, MAX_DOCUMENT_BYTES), document)
    done = 0

    def told(_outcome: "Outcome[str, dict[str, Any]]") -> None:
        nonlocal done
        done += 1
        on_done(done)

    table, failed = build_catalog(root, on_done=told)
    # Without the folder that the dataset happens to lie in: it stays in the note.
    unreadable = {one.item: getattr(one.error, "what", "") for one in failed}
    return Dataset(str(root), metadata, table), dict(sorted(unreadable.items()))


def remove_unreadable(
    dataset: Dataset,
    unreadable: Mapping[str, str],
    reason: str,
    *,
    on_done: Callable[[int], None] = lambda _done: None,
) -> None:
    """Remove episodes that cannot be read, as `remove_episodes` does those that can.

    Parameters
    ----------
    dataset : Dataset
    unreadable : mapping of str to str
        As `find_unreadable` returns them.
    reason : str
    on_done : callable
        Told how many are done.
    """
    _shorten_splits(dataset, {id_in_name(path) for path in unreadable})
    for number, (path, problem) in enumerate(unreadable.items()):
        said = {"id": id_in_name(path), "problem": problem, "reason": reason}
        _remove(Path(dataset.path, path), said)
        on_done(number + 1)


def id_in_name(path: str) -> str:
    """Return the id that an episode has by its path.

    Parameters
    ----------
    path : str
    """
    return Path(path).name.removesuffix(".zip").removesuffix(".zarr")


def _shorten_splits(dataset: Dataset, gone: Iterable[str]) -> None:
    shorter = {}
    for name, document in dataset.splits.items():
        lists = {
            part: [one for one in listed if one not in gone]
            for part, listed in document.lists.items()
        }
        if lists != document.lists:
            shorter[name] = document.model_copy(update={"lists": lists})
    write_splits(Path(dataset.path), shorter)


def _remove(path: Path, said: Mapping[str, Any]) -> None:
    name = said["id"]
    write_atomic(path.with_name(f"{TOMBSTONE}{name}.json"), (json.dumps(said) + "\n").encode())
    # From here on it is no episode; a command that is killed leaves what the next one clears away.
    aside = path.with_name(f".partial-{name}{'.zip' if path.is_file() else ''}")
    if aside.is_dir():
        shutil.rmtree(aside)
    path.rename(aside)
    sync_folder(path.parent)
    if aside.is_dir():
        shutil.rmtree(aside)
    else:
        aside.unlink()
