"""Bringing a catalog up to date: only what changed is read."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any

from exumi_data.catalog import (
    CATALOG_NAME,
    build_catalog,
    list_episodes,
    read_catalog,
    rows_to_table,
    write_catalog,
)
from exumi_data.dataset import DATASET_DOCUMENT, is_unfinished, unfinished
from exumi_data.destination import is_current
from exumi_data.engine import Engine
from exumi_data.errors import NotAnEpisodeError
from exumi_data.model.documents import parse_dataset

__all__ = ["Change", "refresh_catalog"]


@dataclass(frozen=True, slots=True)
class Change:
    """What became of a catalog; episodes are named by their paths below the dataset.

    Attributes
    ----------
    catalog : str
        The file.
    episodes : int
        Its rows.
    added, updated, removed : list of str
    failed : dict of str to str
        Path of an episode that cannot be read, and why. It is not in the catalog.
    written : bool
        False when the catalog was up to date.
    """

    catalog: str
    episodes: int
    added: list[str]
    updated: list[str]
    removed: list[str]
    failed: dict[str, str]
    written: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON document."""
        return asdict(self)

    def lines(self) -> list[str]:
        """Return the text for people."""
        counts = [
            f"{len(paths):,} {what}"
            for what, paths in (
                ("added", self.added),
                ("updated", self.updated),
                ("removed", self.removed),
            )
            if paths
        ]
        state = ", ".join(counts) if counts else "nothing changed"
        return [f"{self.catalog}: {self.episodes:,} episodes ({state})"]


def refresh_catalog(
    root: Path,
    *,
    everything: bool = False,
    workers: int | None = None,
    engine: Engine | None = None,
    on_done: Callable[[int, int], None] = lambda _done, _total: None,
) -> Change:
    """Write the catalog of a dataset where it is missing or stale.

    An episode is read again when its root document or what was derived from it is not what the
    catalog knows. The bytes of streams are not read: ``everything`` does that.

    Parameters
    ----------
    root : pathlib.Path
        The dataset.
    everything : bool
        Read every episode.
    workers : int, optional
        Processes; default all cores.
    engine : Engine, optional
        Where the episodes are read; default processes of this machine.
    on_done : callable
        Called after each episode that was read, with the number of those read and of all to read.

    Returns
    -------
    Change

    Raises
    ------
    NotAnEpisodeError
        `root` is no dataset.
    MetadataError, UnsupportedError
        ``dataset.json`` breaks the standard, or is newer.
    """
    document = root / DATASET_DOCUMENT
    if is_unfinished(root):
        raise unfinished(root)
    if not document.is_file():
        raise NotAnEpisodeError(
            "no dataset.json: not an exUMI dataset",
            where=root,
            fix="Name the dataset's folder, not one of its episodes.",
        )
    parse_dataset(document.read_bytes(), document)
    table = read_catalog(root)
    known = {} if table is None else {row["path"]: row for row in table.to_pylist()}
    present = list_episodes(root)
    stale = [
        path
        for path in present
        if everything or path not in known or not is_current(root / path, known[path])
    ]
    counter = count(1)
    new, failed = build_catalog(
        root,
        paths=stale,
        workers=workers,
        engine=engine,
        on_done=lambda _: on_done(next(counter), len(stale)),
    )
    fresh = {row["path"]: row for row in new.to_pylist()}
    kept = {path: known[path] for path in present if path in known and path not in stale}
    changed = bool(stale) or set(known) != set(present) or table is None
    if changed:
        write_catalog(root, rows_to_table([*kept.values(), *fresh.values()]))
    return Change(
        catalog=str(root / CATALOG_NAME),
        episodes=len(kept) + len(fresh),
        added=[path for path in fresh if path not in known],
        updated=[path for path in fresh if path in known and fresh[path] != known[path]],
        removed=[path for path in known if path not in kept and path not in fresh],
        failed={outcome.item: str(outcome.error) for outcome in failed},
        written=changed,
    )
