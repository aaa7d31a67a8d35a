"""What a run finds in its destination: the episodes that are complete."""

from collections.abc import Sequence
from pathlib import Path

from exumi_data.catalog import episode_path
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import ExumiError
from exumi_data.model import EpisodeMetadata, Source
from exumi_data.model.documents import dump

__all__ = ["existing_path", "is_current", "next_revision", "read_metadata"]


def existing_path(root: Path, episode_id: str) -> Path | None:
    """Return where an episode is, as a folder or packed; None if it is not there."""
    for packed in (False, True):
        path = root / episode_path(episode_id, packed=packed)
        if path.exists():
            return path
    return None


def is_current(path: Path, wanted: Source, derived: Sequence[str] | None = None) -> Episode | None:
    """Open an episode, if it is complete and was made from the same bytes and settings.

    Parameters
    ----------
    path : pathlib.Path
    wanted : Source
        What an episode made now would say of its source.
    derived : sequence of str, optional
        Derived arrays that it has to have; default: the activity of all tactile streams.

    Returns
    -------
    Episode or None
        None: it has to be made again.
    """
    try:
        episode = open_episode(path)
    except ExumiError:
        return None
    try:
        if _same(episode.metadata.source, wanted) and _is_whole(episode, derived):
            return episode
    except (ExumiError, OSError):
        pass
    episode.close()
    return None


def _same(found: Source, wanted: Source) -> bool:
    keys = ("converter", "key", "inputs", "settings_sha256", "parent_id", "parent_digest")
    old, new = dump(found), dump(wanted)
    return all(old.get(key) == new.get(key) for key in keys)


def _is_whole(episode: Episode, derived: Sequence[str] | None) -> bool:
    """Whether nothing is missing, also of what is derived: its list may be lost as a whole."""
    episode.check_complete()
    items = episode.derived.items if episode.derived else {}
    if derived is None:
        derived = [f"{stream.name}/activity" for stream in episode.of_kind("tactile")]
    return set(derived) <= set(items)


def read_metadata(path: Path) -> EpisodeMetadata | None:
    """Return an episode's metadata, or None where they cannot be read."""
    try:
        with open_episode(path) as episode:
            return episode.metadata
    except ExumiError:
        return None


def next_revision(old: EpisodeMetadata | None, new: EpisodeMetadata) -> int:
    """Return the revision of an episode that is made again.

    The same tool makes the same bytes from the same source and settings: that is a repair, not
    another revision.
    """
    if old is None:
        return 1
    before, after = dump(old.source), dump(new.source)
    # Steps at which something was lost are known only once the data was read.
    before.pop("lossy", None)
    after.pop("lossy", None)
    return old.revision if before == after else old.revision + 1
