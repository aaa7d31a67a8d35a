"""Episodes taken out of a dataset; of each a tombstone stays, with the reason."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from exumi_data.editing.copying import Chosen, chosen_of
from exumi_data.editing.documents import write_splits
from exumi_data.store.files import sync_folder, write_atomic

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["TOMBSTONE", "remove_episodes"]

TOMBSTONE = ".removed-"
"""``.removed-<id>.json`` stays beside where an episode was: what it was, and why it went."""


def remove_episodes(
    dataset: "Dataset",
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
    root, gone = Path(dataset.path), set(ids)
    shorter = {}
    for name, document in dataset.splits.items():
        lists = {
            part: [one for one in listed if one not in gone]
            for part, listed in document.lists.items()
        }
        if lists != document.lists:
            shorter[name] = document.model_copy(update={"lists": lists})
    write_splits(root, shorter)
    for number, one in enumerate(chosen_of(dataset, ids)):
        _remove(one, reason)
        on_done(number + 1)


def _remove(one: Chosen, reason: str) -> None:
    path = one.path
    said = {
        "id": one.id,
        "revision": one.row["revision"],
        "digest": one.row["digest"],
        "reason": reason,
    }
    write_atomic(path.with_name(f"{TOMBSTONE}{one.id}.json"), (json.dumps(said) + "\n").encode())
    # From here on it is no episode; a command that is killed leaves what the next one clears away.
    aside = path.with_name(f".partial-{one.id}{'.zip' if path.is_file() else ''}")
    if aside.is_dir():
        shutil.rmtree(aside)
    path.rename(aside)
    sync_folder(path.parent)
    if aside.is_dir():
        shutil.rmtree(aside)
    else:
        aside.unlink()
