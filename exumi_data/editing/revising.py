"""A new revision of a finished episode: what is said of it changes, its samples do not.

All metadata of an episode are in one document, so a revision of a folder is one file that takes the
place of another, at once. A packed episode is packed again.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from exumi_data.episode import open_episode
from exumi_data.errors import UsageError
from exumi_data.model.documents import dump, episode_root_document, parse_episode, problems_of
from exumi_data.model.episode import EpisodeMetadata
from exumi_data.store.files import write_atomic
from exumi_data.store.pack import pack_store

__all__ = ["Revision", "revise"]

_ROOT = "zarr.json"


@dataclass(frozen=True, slots=True)
class Revision:
    """What became of an episode.

    Attributes
    ----------
    id : str
    path : str
    revision : int
        After the change.
    changed : dict of str to (object, object)
        Fields of the metadata, dotted, with what they were and what they are; None: absent. Of a
        list, what left it and what came.
    """

    id: str
    path: str
    revision: int
    changed: dict[str, tuple[object, object]]


def revise(
    path: Path, change: Callable[[EpisodeMetadata], None], *, dry_run: bool = False
) -> Revision:
    """Change what an episode's metadata say, one revision later; where nothing changes, do nothing.

    Parameters
    ----------
    path : pathlib.Path
        The episode's folder or zip.
    change : callable
        Changes a copy of the metadata in place. It leaves id, revision and streams alone.
    dry_run : bool
        Only tell what would change.

    Returns
    -------
    Revision

    Raises
    ------
    UsageError, MetadataError
        What was changed breaks the standard.
    ExumiError
        The episode cannot be read.
    """
    with open_episode(path) as episode:
        before = episode.metadata
        after = before.model_copy(deep=True)
        try:
            change(after)
        except ValidationError as error:
            problems = tuple(f"{message} @ {where}" for message, where in problems_of(error))
            raise UsageError("; ".join(problems), where=path) from None
        changed = differences(dump(before), dump(after))
        if changed:
            after.revision = before.revision + 1
        root = episode_root_document(after)
        parse_episode(root, path)  # what we could not read again is never written
        if changed and not dry_run:
            if path.is_dir():
                write_atomic(path / _ROOT, root)
            else:
                pack_store(episode.store, path, replaced={_ROOT: root})
    return Revision(before.id, str(path), after.revision, changed)


def differences(before: object, after: object, name: str = "") -> dict[str, tuple[object, object]]:
    """Return which fields of two JSON values differ, by dotted name.

    Parameters
    ----------
    before, after : JSON value
    name : str
        Of both.
    """
    if isinstance(before, list) and isinstance(after, list) and before != after:
        gone = [item for item in before if item not in after]
        return {name: (gone or None, [item for item in after if item not in before] or None)}
    if not isinstance(before, dict) or not isinstance(after, dict):
        return {} if before == after else {name: (before, after)}
    found: dict[str, tuple[object, object]] = {}
    for key in [*before, *(key for key in after if key not in before)]:
        inner = f"{name}.{key}" if name else str(key)
        found |= differences(before.get(key), after.get(key), inner)
    return found
