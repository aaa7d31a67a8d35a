"""What a run finds in its destination: episodes that are complete, and what a crash left behind."""

import os
import shutil
import time
from collections.abc import Sequence
from pathlib import Path

from exumi_data.catalog import EPISODES_FOLDER, episode_path
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import ExumiError, UsageError
from exumi_data.model import EpisodeMetadata, Source
from exumi_data.model.documents import dump
from exumi_data.store.files import claim_folder

__all__ = ["clean_leftovers", "existing_path", "is_current", "next_revision", "read_metadata"]

_PARTIAL = ".partial-"
_REPLACED = ".replaced-"
_PATIENCE_S = 60.0  # a worker whose run was killed finishes the episode it is at


def clean_leftovers(root: Path) -> list[str]:
    """Remove what a killed run left half-written, and bring back what it had put aside.

    Parameters
    ----------
    root : pathlib.Path
        The dataset. No other process may be writing into it.

    Returns
    -------
    list of str
        What was done, for the report.
    """
    removed, restored = _remove_files(root), 0
    for folder in sorted((root / EPISODES_FOLDER).glob("*/")):
        for path in sorted(folder.glob(f"{_REPLACED}*")):
            final = path.with_name(path.name.removeprefix(_REPLACED))
            if not final.exists():
                # The run died between two renames: this is the last complete state.
                path.rename(final)
                restored += 1
            else:
                _remove(path)
        for path in sorted(folder.glob(f"{_PARTIAL}*")):
            removed += _give_up(path)
    notices = []
    if removed:
        notices.append(f"{removed} half-written episode(s) of an earlier run were removed")
    if restored:
        notices.append(f"{restored} episode(s) that an earlier run had put aside were brought back")
    return notices


def _remove_files(root: Path) -> int:
    """Remove documents and packed episodes that were never finished."""
    found = [
        path
        for pattern in (f"{_PARTIAL}*", f"splits/{_PARTIAL}*", f"{EPISODES_FOLDER}/*/{_PARTIAL}*")
        for path in root.glob(pattern)
        if path.is_file()
    ]
    for path in found:
        path.unlink(missing_ok=True)
    return len(found)


def _give_up(path: Path) -> int:
    """Remove a half-written episode, once no worker of a killed run is busy with it any more."""
    deadline = time.monotonic() + _PATIENCE_S
    while path.is_dir():
        try:
            claim = claim_folder(path)
        except UsageError:
            if time.monotonic() > deadline:
                return 0
            time.sleep(0.02)
            continue
        shutil.rmtree(path)
        os.close(claim)
        return 1
    return 0


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


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
