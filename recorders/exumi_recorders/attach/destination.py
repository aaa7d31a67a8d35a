"""The dataset that clips' episodes go into: one run at a time, and its catalog kept true."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from exumi_data.catalog import CATALOG_NAME, episode_path, read_catalog
from exumi_data.destination import only_run, take_up, update_catalog
from exumi_data.episode import open_episode
from exumi_data.errors import ExumiError
from exumi_data.leftovers import clean_leftovers
from exumi_data.model import DatasetMetadata, EpisodeMetadata
from exumi_data.model.documents import dump

__all__ = ["Destination", "opened"]


class Destination:
    """A dataset that is written into.

    Parameters
    ----------
    root : pathlib.Path
    cleaned : list of str
        What was done about what a killed run had left, for the report.
    """

    def __init__(self, root: Path, cleaned: list[str]) -> None:
        self.root, self.cleaned = root, cleaned
        table = read_catalog(root)
        self._rows = {} if table is None else {row["path"]: row for row in table.to_pylist()}
        self._changed: set[str] = set()

    def path_of(self, metadata: EpisodeMetadata) -> Path:
        """Return where an episode goes, and say that it changes."""
        relative = episode_path(metadata.id)
        self._changed.add(relative)
        (self.root / CATALOG_NAME).unlink(missing_ok=True)  # it would be wrong until the end
        return self.root / relative

    def drop_packed(self, metadata: EpisodeMetadata) -> None:
        """Remove the packed form of an episode that was written anew: they would be two."""
        packed = self.root / episode_path(metadata.id, packed=True)
        if packed.exists():
            packed.unlink()
            self._changed.add(packed.relative_to(self.root).as_posix())

    def is_current(self, metadata: EpisodeMetadata) -> bool:
        """Whether an episode is there, whole, and made of the same bytes and settings.

        Parameters
        ----------
        metadata : EpisodeMetadata
            What an episode made now would say; its revision is set to follow the one that is there.
        """
        for packed in (False, True):
            path = self.root / episode_path(metadata.id, packed=packed)
            if not path.exists():
                continue
            try:
                with open_episode(path) as episode:
                    if _same(episode.metadata, metadata):
                        episode.check_complete()
                        return True
                    metadata.revision = episode.metadata.revision + 1
            except ExumiError:
                continue
        return False

    def refresh_catalog(self) -> list[str]:
        """Write the catalog; read only what changed. Return what could not be read."""
        same = {path: row for path, row in self._rows.items() if path not in self._changed}
        return update_catalog(self.root, same)


def _same(found: EpisodeMetadata, wanted: EpisodeMetadata) -> bool:
    keys = ("inputs", "settings_sha256", "parent_id", "parent_digest", "key")
    old, new = dump(found.source), dump(wanted.source)
    return all(old.get(key) == new.get(key) for key in keys)


@contextmanager
def opened(path: Path, metadata: DatasetMetadata) -> Iterator[Destination]:
    """Make a dataset or take up the one that is there, and keep others out of it meanwhile.

    Parameters
    ----------
    path : pathlib.Path
    metadata : DatasetMetadata
        Of a new one.

    Raises
    ------
    UsageError
        The folder holds something else, cannot be written, or is being written by another command.
    """
    root = take_up(path, metadata)
    with only_run(root):
        yield Destination(root, clean_leftovers(root))
