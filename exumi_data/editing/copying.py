"""Episodes of one dataset copied into another, byte for byte: each whole, or not at all."""

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exumi_data.catalog import episode_path
from exumi_data.episode import open_episode
from exumi_data.store.files import claim_folder, replace_folder, sync_tree
from exumi_data.store.pack import pack_store
from exumi_data.store.stream_copy import copy_file

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["Chosen", "chosen_of", "copy_episode", "copy_episodes"]


@dataclass(frozen=True, slots=True)
class Chosen:
    """An episode that is to be copied.

    Attributes
    ----------
    root : pathlib.Path
        Its dataset.
    row : dict
        Of the dataset's catalog.
    """

    root: Path
    row: dict[str, Any]

    @property
    def id(self) -> str:
        """Of the episode."""
        return str(self.row["id"])

    @property
    def path(self) -> Path:
        """Where it lies."""
        return self.root / str(self.row["path"])

    @property
    def target(self) -> str:
        """Where it is to lie, below the new dataset."""
        return episode_path(self.id, packed=str(self.row["path"]).endswith(".zip"))


def chosen_of(dataset: "Dataset", ids: Sequence[str] | None = None) -> list[Chosen]:
    """Return episodes of a dataset, with their rows of the catalog.

    Parameters
    ----------
    dataset : Dataset
    ids : sequence of str, optional
        Default: all.
    """
    view = dataset if ids is None else dataset.select(ids)
    return [Chosen(Path(dataset.path), row) for row in view.catalog.to_pylist()]


def copy_episodes(
    chosen: Sequence[Chosen], root: Path, on_done: Callable[[int], None] = lambda _done: None
) -> dict[str, dict[str, Any]]:
    """Copy episodes into a dataset; those that are there already, whole, are passed over.

    Parameters
    ----------
    chosen : sequence of Chosen
    root : pathlib.Path
        The dataset.
    on_done : callable
        Told how many are done.

    Returns
    -------
    dict of str to dict
        Rows for the dataset's catalog, by path.

    Raises
    ------
    DamagedDataError
        An episode cannot be read, or is not complete.
    """
    rows = {}
    for number, one in enumerate(chosen):
        target = root / one.target
        if not _is_there(target, one):
            copy_episode(one.path, target)
        rows[one.target] = {**one.row, "path": one.target}
        on_done(number + 1)
    return rows


def copy_episode(source: Path, target: Path) -> None:
    """Copy an episode, in the form that it has: a folder, or packed.

    Parameters
    ----------
    source : pathlib.Path
    target : pathlib.Path
        Its final name; one that is there is replaced.

    Raises
    ------
    DamagedDataError
        It cannot be read, or is not complete.
    """
    with open_episode(source) as episode:
        episode.check_complete()
        if not source.is_dir():
            pack_store(episode.store, target)
            return
        partial = target.with_name(f".partial-{episode.id}")
        claim = claim_folder(partial)
        try:
            for member in episode.store.paths():
                copy_file(episode.store, member, partial / member)
            sync_tree(partial)
            replace_folder(partial, target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)  # there only if it did not come to its end
            os.close(claim)


def _is_there(target: Path, one: Chosen) -> bool:
    """Whether the very episode is there: of an earlier run that did not come to its end."""
    from exumi_data.destination import is_current

    return target.exists() and is_current(target, one.row)
