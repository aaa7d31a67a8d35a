"""Episodes packed into a release, each into one stored zip; what is packed stays when it is killed.

A journal beside the episodes keeps what was computed of each, one line an episode: what was packed
from the same bytes before is not read again.
"""

import errno
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from exumi_data._version import __version__
from exumi_data.catalog import catalog_row, episode_path
from exumi_data.editing.copying import Chosen
from exumi_data.engine import map_items
from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError
from exumi_data.manifest import Listed, sha256_of
from exumi_data.model.manifest import ManifestEpisode, ManifestFile
from exumi_data.release.privacy import Removal, without_private
from exumi_data.store.access import Store
from exumi_data.store.digest import digest_of
from exumi_data.store.pack import pack_store

__all__ = ["JOURNAL_NAME", "Packed", "pack_episodes"]

JOURNAL_NAME = ".packed.jsonl"

_FULL = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True, slots=True)
class Packed:
    """A packed episode of a release.

    Attributes
    ----------
    row : dict
        Of the release's catalog.
    sha256 : str
        Of its file.
    bytes : int
    mtime_ns : int
        When it was written: a file that was touched since is packed again.
    source : dict
        Of the source's row, what tells these bytes from others.
    """

    row: dict[str, Any]
    sha256: str
    bytes: int
    mtime_ns: int
    source: dict[str, Any]

    @property
    def path(self) -> str:
        """Relative to the release."""
        return str(self.row["path"])

    @property
    def listed(self) -> Listed:
        """What the manifest says of it."""
        return Listed(
            ManifestFile(path=self.path, bytes=self.bytes, sha256=self.sha256),
            ManifestEpisode(id=self.row["id"], path=self.path, digest=self.row["digest"]),
        )


def pack_episodes(
    chosen: Sequence[Chosen],
    root: Path,
    *,
    removal: Removal | None = None,
    workers: int | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Packed]:
    """Pack episodes into a folder; those that an earlier run packed from the same bytes stay.

    Parameters
    ----------
    chosen : sequence of Chosen
        In any form; they stay as they are.
    root : pathlib.Path
        The release that is being made.
    removal : Removal, optional
        What is taken out of each.
    workers : int, optional
        Processes; default all cores.
    on_progress : callable
        Told how many are done, and of how many.

    Returns
    -------
    list of Packed
        By path.

    Raises
    ------
    DamagedDataError
        Episodes cannot be read, or their bytes are not those that the catalog knows: all of them
        are named, after the others are packed.
    """
    by = _maker(removal)
    known = _read_journal(root, by)
    done = {one.id: known[one.id] for one in chosen if _is_packed(root, one, known.get(one.id))}
    todo = [one for one in chosen if one.id not in done]
    problems = []
    on_progress(len(done), len(chosen))
    # A few episodes are packed faster than processes start.
    pack = partial(_pack, root=root, removal=removal)
    outcomes = map_items(pack, todo, workers=1 if len(todo) < 8 else workers)
    with _journal(root, by, done.values()) as note:
        for outcome in outcomes:
            if isinstance(outcome.error, OSError) and outcome.error.errno in _FULL:
                raise outcome.error  # the others would end in the same way
            if outcome.value is None:
                problems.append(str(outcome.error))
                continue
            note(outcome.value)
            done[outcome.item.id] = outcome.value
            on_progress(len(done), len(chosen))
    if problems:
        listed = "\n".join(f"  {problem}" for problem in sorted(problems))
        raise DamagedDataError(f"{len(problems)} episode(s) cannot be packed:\n{listed}")
    return sorted(done.values(), key=lambda one: one.path)


def _pack(one: Chosen, *, root: Path, removal: Removal | None) -> Packed:
    relative = episode_path(one.id, packed=True)
    target = root / relative
    with open_episode(one.path) as episode:
        episode.check_complete()
        store: Store = episode.store
        if removal is not None:
            store = without_private(store, removal, str(one.row["path"])).store
        is_as_it_was = store is episode.store
        if not is_as_it_was:
            _check_digest(digest_of(episode.store), one)
        pack_store(store, target)
    with open_episode(target) as packed:
        row = catalog_row(packed, relative)
    if is_as_it_was:
        try:
            _check_digest(row["digest"], one)
        except DamagedDataError:
            target.unlink()
            raise
    checksum, size = sha256_of(target)
    return Packed(row, checksum, size, target.stat().st_mtime_ns, _source(one))


def _check_digest(digest: str, one: Chosen) -> None:
    if digest != one.row["digest"]:
        raise DamagedDataError(
            "its bytes are not those that the catalog knows",
            where=one.path,
            fix="Copy it again from its source; or, if it was changed on purpose: "
            "exumi validate DATASET --fix --apply --accept-changed",
        )


def _source(one: Chosen) -> dict[str, Any]:
    return {key: one.row[key] for key in ("id", "root_sha256", "derived_digest", "digest")}


def _maker(removal: Removal | None) -> str:
    """Return what tells one way of packing from another; a key does not show in it."""
    kinds, key = (sorted(removal.kinds), removal.key or b"") if removal else ([], b"")
    names = sorted(removal.names) if removal else []
    parts = [",".join(kinds).encode(), key, *(name.encode() for name in names)]
    told = hashlib.sha256(b"\0".join(parts)).hexdigest()
    return f"{__version__} {told[:16]}"


def _is_packed(root: Path, one: Chosen, packed: Packed | None) -> bool:
    """Whether an earlier run packed the very episode, and nobody touched it since."""
    if packed is None:
        return False
    if packed.source != _source(one):
        return False
    try:
        found = (root / packed.path).lstat()
    except OSError:
        return False
    return (found.st_size, found.st_mtime_ns) == (packed.bytes, packed.mtime_ns)


def _read_journal(root: Path, by: str) -> Mapping[str, Packed]:
    known: dict[str, Packed] = {}
    try:
        lines = (root / JOURNAL_NAME).read_text("utf-8").splitlines()
    except FileNotFoundError:
        return known
    for line in lines:
        try:
            entry = json.loads(line)
            if entry.pop("by") == by:
                packed = Packed(**entry)
                known[packed.row["id"]] = packed
        except (ValueError, KeyError, TypeError, AttributeError):
            continue  # the line that was being written
    return known


@contextmanager
def _journal(root: Path, by: str, known: Iterable[Packed]) -> Iterator[Callable[[Packed], None]]:
    """Write what is known anew, and then each episode as it is done."""
    path = root / JOURNAL_NAME
    fresh = path.with_name(f"{JOURNAL_NAME}.new")
    with fresh.open("w", encoding="utf-8") as file:

        def note(one: Packed) -> None:
            file.write(json.dumps({"by": by, **asdict(one)}) + "\n")
            file.flush()

        for one in list(known):
            note(one)
        fresh.replace(path)
        yield note
