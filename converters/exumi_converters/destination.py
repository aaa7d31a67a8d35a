"""The dataset that a run writes into: made or taken up, and its catalog and splits kept true."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from exumi_converters.documents import to_json
from exumi_data.catalog import CATALOG_NAME, list_episodes
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.destination import is_current, take_up, update_catalog
from exumi_data.engine import Engine
from exumi_data.model import DatasetMetadata, SplitDocument
from exumi_data.model.documents import dump, parse_dataset, parse_split
from exumi_data.store.files import write_atomic

__all__ = ["drop_catalog", "open_destination", "refresh_catalog", "write_splits"]


def open_destination(path: Path, metadata: DatasetMetadata) -> Path:
    """Make the dataset, or take up the one that is there.

    Parameters
    ----------
    path : pathlib.Path
    metadata : DatasetMetadata
        What it says of itself if it is new. Of one that is there, licence and how it was made are
        brought up to date if the same converter made it; all else is the user's.

    Raises
    ------
    UsageError
        The folder holds something else, or cannot be written.
    """
    root = take_up(path, metadata)
    document = root / DATASET_DOCUMENT
    found = parse_dataset(document.read_bytes(), document)
    if _maker(found) == _maker(metadata):
        found.licence = metadata.licence
        found.made_by = metadata.made_by
        _write_if_changed(document, to_json(dump(found)))
    return root


def _maker(metadata: DatasetMetadata) -> str | None:
    """Return the converter that made a dataset, without its version."""
    made_by = metadata.made_by
    settings = (made_by.settings if made_by else None) or {}
    return str(settings["converter"]).partition("/")[0] if "converter" in settings else None


def _write_if_changed(path: Path, content: bytes) -> None:
    if not path.exists() or path.read_bytes() != content:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, content)


def drop_catalog(root: Path) -> None:
    """Remove the catalog before an episode changes: until the end of the run it would be wrong."""
    (root / CATALOG_NAME).unlink(missing_ok=True)


def refresh_catalog(
    root: Path,
    fresh: Mapping[str, dict[str, Any]],
    known: Iterable[dict[str, Any]],
    *,
    workers: int | None,
    engine: Engine | None,
) -> list[str]:
    """Write the catalog, reading as few episodes as possible.

    Parameters
    ----------
    root : pathlib.Path
    fresh : mapping of str to dict
        Rows of the episodes that were just written, by path.
    known : iterable of dict
        Rows of the catalog before the run: taken where the episode did not change.
    workers : int or None
    engine : Engine or None

    Returns
    -------
    list of str
        Episodes that cannot be read, and why.
    """
    old = {row["path"]: row for row in known}
    unsure = [path for path in list_episodes(root) if path in old and path not in fresh]
    same = {path: old[path] for path in unsure if is_current(root / path, old[path])}
    return update_catalog(root, {**same, **fresh}, workers=workers, engine=engine)


def write_splits(
    root: Path, splits: Sequence[SplitDocument], lists: Mapping[str, Mapping[str, Sequence[str]]]
) -> None:
    """Write splits that the source publishes, and name them in ``dataset.json``.

    Parameters
    ----------
    root : pathlib.Path
    splits : sequence of SplitDocument
        What is said of them; their lists play no part.
    lists : mapping
        Split to list to ids of episodes. Episodes of the dataset that are of another source stay
        where an existing split has them.
    """
    for split in splits:
        path = root / "splits" / f"{split.name}.json"
        existing = parse_split(path.read_bytes(), path) if path.is_file() else None
        document = _updated(existing, split)
        document.lists = _merged(root, existing, lists.get(split.name, {}))
        _write_if_changed(path, to_json(dump(document)))
    path = root / DATASET_DOCUMENT
    metadata = parse_dataset(path.read_bytes(), path)
    names = sorted({*metadata.splits, *(split.name for split in splits)})
    if names != metadata.splits:
        metadata.splits = names
        _write_if_changed(path, to_json(dump(metadata)))


def _updated(existing: SplitDocument | None, split: SplitDocument) -> SplitDocument:
    """Return a split's document with the keys of both that we do not know."""
    if existing is None:
        return split.model_copy(deep=True)
    base, other = (split, existing) if split.is_newer_minor else (existing, split)
    document = base.model_copy(deep=True)
    for field in {"level", "method", "seed"} & split.model_fields_set:
        setattr(document, field, getattr(split, field))
    for key, value in (other.model_extra or {}).items():
        if key not in (document.model_extra or {}):
            setattr(document, key, value)
    return document


def _merged(
    root: Path, existing: SplitDocument | None, lists: Mapping[str, Sequence[str]]
) -> dict[str, list[str]]:
    merged = {name: set(ids) for name, ids in lists.items()}
    placed = {episode_id for ids in lists.values() for episode_id in ids}
    present = {Path(path).name.partition(".")[0] for path in list_episodes(root)}
    for name, ids in (existing.lists if existing else {}).items():
        merged.setdefault(name, set()).update((set(ids) - placed) & present)
    return {name: sorted(ids) for name, ids in sorted(merged.items())}
