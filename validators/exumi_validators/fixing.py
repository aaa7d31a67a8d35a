"""Mending what can be mended without guessing: the catalog, which the episodes themselves say.

An episode is never changed. An episode whose bytes are not those that the catalog knows, while its
metadata is, was changed by something that does not keep the rules (or by a failing disk): that is
evidence, which a new catalog would wipe out. Its row stays as it is unless the user accepts it.
"""

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import count, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exumi_data.catalog import (
    CATALOG_NAME,
    build_catalog,
    list_episodes,
    obstacle_to_catalog,
    read_catalog,
    rows_to_table,
    write_catalog,
)
from exumi_data.engine import Engine
from exumi_data.errors import ExumiError, UnsupportedError, UsageError
from exumi_validators.dataset_context import DatasetContext
from exumi_validators.findings import show

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["CatalogFix", "apply_fix", "plan_fix"]

_LISTED = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class CatalogFix:
    """What a new catalog would change. Episodes are named by their paths below the dataset.

    Attributes
    ----------
    dataset : str
    state : str or None
        Why the old catalog cannot be used; None when it can.
    added, updated, removed : tuple of str
    reordered : bool
        Rows are not in order of their paths, or an episode has two.
    dropped_columns : tuple of str
        Columns that are not the standard's.
    changed : tuple of str
        Episodes whose bytes are not those that the catalog knows.
    accepted : bool
        Whether `changed` are taken as they are.
    unreadable : dict of str to str
        Episodes that cannot be read, with the reason; an old row stays.
    blocked : str or None
        Why nothing at all is mended.
    """

    dataset: str
    state: str | None
    added: tuple[str, ...]
    updated: tuple[str, ...]
    removed: tuple[str, ...]
    reordered: bool
    dropped_columns: tuple[str, ...]
    changed: tuple[str, ...]
    accepted: bool
    unreadable: dict[str, str]
    blocked: str | None

    @property
    def needed(self) -> bool:
        """Whether there is anything to write."""
        changes = self.added or self.updated or self.removed or self.dropped_columns
        return self.blocked is None and bool(self.state or changes or self.reordered)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {**asdict(self), "needed": self.needed}

    def to_text(self, *, applied: bool) -> str:
        """Return it for people.

        Parameters
        ----------
        applied : bool
            Whether it was done.
        """
        lines = [self._headline(applied=applied)]
        if self.needed:
            for word, paths in (
                ("add", self.added),
                ("update", self.updated),
                ("remove", self.removed),
            ):
                lines += [f"  {word} {show(path)}" for path in paths[:_LISTED]]
                if len(paths) > _LISTED:
                    lines.append(f"  {word} {len(paths) - _LISTED:,} more")
        if self.dropped_columns:
            lines.append(f"  drop the columns {show(', '.join(self.dropped_columns))}")
        if self.changed and not self.accepted:
            lines.append(
                "  not mended: the bytes of these changed, their metadata did not (CAT-004)."
            )
            lines.append("  Restore them, or take them as they are with --accept-changed:")
            lines += [f"    {show(path)}" for path in self.changed]
        for path, reason in islice(self.unreadable.items(), _LISTED):
            lines.append(f"  not mended: {show(path)} cannot be read: {show(reason)}")
        if len(self.unreadable) > _LISTED:
            lines.append(f"  not mended: {len(self.unreadable) - _LISTED:,} more")
        if self.blocked is not None:
            lines.append(f"  {self.blocked}")
        if self.needed and not applied:
            lines.append("Nothing was written yet. To do it, add --apply.")
        return "\n".join(lines) + "\n"

    def _headline(self, *, applied: bool) -> str:
        if self.blocked is not None:
            return f"{CATALOG_NAME}: not mended"
        if not self.needed:
            return f"{CATALOG_NAME}: nothing to mend"
        counts = [
            f"{len(paths):,} {word}"
            for word, paths in (
                ("added", self.added),
                ("updated", self.updated),
                ("removed", self.removed),
            )
            if paths
        ]
        counts += ["put in order"] if self.reordered else []
        counts += [show(self.state)] if self.state else []
        verb = "rebuilt" if applied else "would be rebuilt"
        return f"{CATALOG_NAME} {verb}: {', '.join(counts) or 'columns'}"


def plan_fix(
    dataset: str | os.PathLike[str],
    *,
    accept_changed: bool = False,
    workers: int | None = None,
    engine: Engine | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> CatalogFix:
    """Find out what a new catalog would change; writes nothing. Every episode is read.

    Parameters
    ----------
    dataset : path-like
        A dataset's folder.
    accept_changed : bool
        Take episodes as they are whose bytes are not those that the catalog knows.
    workers : int, optional
        Processes; default all cores.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_progress : callable, optional
        Called with the number of episodes that were read, and of all.

    Returns
    -------
    CatalogFix

    Raises
    ------
    UsageError
        It is no dataset: in an episode nothing can be mended without guessing.
    UnsupportedError
        The dataset is of a version that this library does not know.
    """
    return _plan(Path(dataset), accept_changed, workers, engine, on_progress)[0]


def apply_fix(
    dataset: str | os.PathLike[str],
    *,
    accept_changed: bool = False,
    workers: int | None = None,
    engine: Engine | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> CatalogFix:
    """Write the new catalog, whole or not at all, and return what it changed.

    Parameters
    ----------
    dataset : path-like
        A dataset's folder.
    accept_changed : bool
        Take episodes as they are whose bytes are not those that the catalog knows.
    workers : int, optional
        Processes; default all cores.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_progress : callable, optional
        Called with the number of episodes that were read, and of all.

    Returns
    -------
    CatalogFix

    Raises
    ------
    UsageError
        It is no dataset: in an episode nothing can be mended without guessing.
    UnsupportedError
        The dataset is of a version that this library does not know.
    """
    root = Path(dataset)
    fix, table = _plan(root, accept_changed, workers, engine, on_progress)
    if fix.needed:
        write_catalog(root, table)
    return fix


def _plan(
    root: Path,
    accept_changed: bool,
    workers: int | None,
    engine: Engine | None,
    on_progress: Callable[[int, int], None] | None,
) -> "tuple[CatalogFix, pa.Table]":
    context = DatasetContext(root)
    if context.loaded is None:
        raise UsageError(
            "no dataset.json: only a dataset's catalog can be mended without guessing", where=root
        )
    if not context.judgeable:
        raise UnsupportedError("a dataset of a version that this library does not know", where=root)
    present = list_episodes(root)
    counter = count(1)
    told = on_progress or (lambda _done, _total: None)
    built, failed = build_catalog(
        root,
        paths=present,
        workers=workers,
        engine=engine,
        on_done=lambda _: told(next(counter), len(present)),
    )
    old_table = read_catalog(root)
    old = {} if old_table is None else {row["path"]: row for row in old_table.to_pylist()}
    new = {row["path"]: row for row in built.to_pylist()}
    changed = _changed(context, new)
    blocked = obstacle_to_catalog(root)
    if not accept_changed:
        lost = [path for path in changed if path not in old]
        new |= {path: old[path] for path in changed if path in old}
        if lost and blocked is None:
            blocked = (
                "the old catalog cannot be kept in part, and a new one would forget the change"
            )
    unreadable = {outcome.item: _reason(outcome.error) for outcome in failed}
    new |= {path: old[path] for path in unreadable if path in old}
    table = rows_to_table(new.values())
    paths = [] if old_table is None else old_table.column("path").to_pylist()
    columns = [] if old_table is None else old_table.column_names
    fix = CatalogFix(
        dataset=os.fspath(root),
        state=_state(context) if old_table is None else None,
        added=tuple(path for path in new if path not in old),
        updated=tuple(path for path in new if path in old and _differs(new[path], old[path])),
        removed=tuple(path for path in old if path not in new),
        reordered=paths != sorted(set(paths)),
        dropped_columns=tuple(sorted(set(columns) - set(table.column_names))),
        changed=tuple(changed),
        accepted=accept_changed,
        unreadable=unreadable,
        blocked=blocked,
    )
    return fix, table


def _reason(error: BaseException | None) -> str:
    """Say why an episode cannot be read; its path is said beside it."""
    return error.what if isinstance(error, ExumiError) else str(error)


def _state(context: DatasetContext) -> str:
    found = context.catalog
    return found if isinstance(found, str) else "the old one is not of the standard's columns"


def _differs(new: dict[str, Any], old: dict[str, Any]) -> bool:
    # A kept row may have more columns than the standard's.
    return any(old[name] != value for name, value in new.items())


def _changed(context: DatasetContext, rows: dict[str, dict[str, Any]]) -> list[str]:
    """Episodes of which the old catalog, as far as it can be read, knows other bytes."""
    if isinstance(context.catalog, str):
        return []
    digests: dict[tuple[str, str], set[str]] = {}
    for row in context.catalog:
        key = (str(row["path"]), str(row["root_sha256"]))
        digests.setdefault(key, set()).add(str(row["digest"]))
    found = []
    for path, row in rows.items():
        known = digests.get((path, row["root_sha256"]))
        if known is not None and known != {row["digest"]}:
            found.append(path)
    return found
