"""Whether the parts of a release agree: manifest, catalog, episodes, splits."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from exumi_data.catalog import CATALOG_NAME, list_episodes, read_catalog
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.errors import ExumiError
from exumi_data.model.dataset import DatasetMetadata
from exumi_data.model.documents import (
    MAX_DOCUMENT_BYTES,
    parse_dataset,
    parse_episode,
    parse_split,
)
from exumi_data.model.manifest import Manifest, ManifestEpisode
from exumi_data.splits import leaks_of
from exumi_data.store.access import open_store
from exumi_data.store.plain_files import read_plain

__all__ = ["PACKED", "Finding", "structure_of"]

PACKED = ".zarr.zip"

Say = Callable[..., None]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is not as it was released.

    Attributes
    ----------
    kind : {"missing", "extra", "size", "changed", "unreadable", "structure"}
    path : str
        Relative to the release.
    message : str
    expected, found : str or None
    """

    kind: Literal["missing", "extra", "size", "changed", "unreadable", "structure"]
    path: str
    message: str
    expected: str | None = None
    found: str | None = None


def structure_of(root: Path, manifest: Manifest, findings: list[Finding]) -> DatasetMetadata | None:
    """Look whether the parts of a release agree with each other.

    Parameters
    ----------
    root : pathlib.Path
    manifest : Manifest
    findings : list of Finding
        What was found so far, which grows. Files that are in it are passed over: more need not be
        said of them.

    Returns
    -------
    DatasetMetadata or None
        None where ``dataset.json`` cannot be read.
    """
    bad = {one.path for one in findings}

    def say(path: str, message: str, expected: object = None, found: object = None) -> None:
        if path not in bad:
            texts = [None if value is None else str(value) for value in (expected, found)]
            findings.append(Finding("structure", path, message, *texts))

    metadata = None
    try:
        metadata = parse_dataset(
            read_plain(root / DATASET_DOCUMENT, MAX_DOCUMENT_BYTES), DATASET_DOCUMENT
        )
    except FileNotFoundError:
        say(DATASET_DOCUMENT, "is missing")
    except ExumiError as error:
        say(DATASET_DOCUMENT, error.what)
    listed = {one.path: one for one in manifest.episodes}
    try:
        for path in sorted(set(list_episodes(root)) - listed.keys()):
            say(path, "is an episode that the manifest does not list")
    except ExumiError as error:
        say("episodes", error.what)
    rows = _catalog_rows(root, say)
    for path, entry in listed.items():
        if path not in bad:
            _check_episode(root, entry, None if rows is None else rows.get(path), say)
    for path in sorted((rows or {}).keys() - listed.keys()):
        say(CATALOG_NAME, f"names an episode that the manifest does not list: {path}")
    _check_splits(root, metadata, manifest, rows or {}, say)
    _check_folders(manifest, say)
    return metadata


def _catalog_rows(root: Path, say: Say) -> dict[str, dict[str, Any]] | None:
    table = read_catalog(root)
    if table is None:
        say(CATALOG_NAME, "is missing, or cannot be read")
        return None
    return {str(row["path"]): row for row in table.to_pylist()}


def _check_episode(
    root: Path, entry: ManifestEpisode, row: Mapping[str, Any] | None, say: Say
) -> None:
    try:
        store = open_store(root / entry.path)
        try:
            raw = store.read("zarr.json")
        finally:
            store.close()
        found = parse_episode(raw, entry.path).id
    except FileNotFoundError:
        say(entry.path, "the episode has no zarr.json")
        return
    except ExumiError as error:
        say(entry.path, error.what)
        return
    if found != entry.id:
        say(entry.path, "the manifest states another id", entry.id, found)
    if row is None:
        say(CATALOG_NAME, f"does not know {entry.path}")
        return
    for key, value in (
        ("id", entry.id),
        ("digest", entry.digest),
        ("root_sha256", sha256(raw).hexdigest()),
    ):
        if row[key] != value:
            say(CATALOG_NAME, f"states another {key} of {entry.path}", value, row[key])


def _check_splits(
    root: Path,
    metadata: DatasetMetadata | None,
    manifest: Manifest,
    rows: Mapping[str, Mapping[str, Any]],
    say: Say,
) -> None:
    ids = {one.id for one in manifest.episodes}
    by_id = {str(row["id"]): row for row in rows.values()}
    for name in metadata.splits if metadata else []:
        path = f"splits/{name}.json"
        try:
            split = parse_split(read_plain(root / path, MAX_DOCUMENT_BYTES), path)
        except FileNotFoundError:
            say(path, "is missing")
            continue
        except ExumiError as error:
            say(path, error.what)
            continue
        strange = [one for each in split.lists.values() for one in each if one not in ids]
        if strange:
            say(path, f"names {len(strange)} episodes that are not there, first {strange[0]}")
        for leak in leaks_of(split, by_id):
            say(path, leak)


def _check_folders(manifest: Manifest, say: Say) -> None:
    """Compute the digests of episodes that are folders from the checksums of their files."""
    folders: dict[str, list[tuple[bytes, str]]] = {
        one.path: [] for one in manifest.episodes if not one.path.endswith(PACKED)
    }
    for entry in manifest.files if folders else ():
        # episodes/<xx>/<id>.zarr/...
        parts = entry.path.split("/", 3)
        inside = folders.get("/".join(parts[:3]))
        if inside is not None and len(parts) == 4 and not parts[3].startswith("derived/"):
            line = f"{entry.sha256} {entry.bytes} {parts[3]}\n"
            inside.append((parts[3].encode(), line))
    for one in manifest.episodes:
        if one.path in folders:
            text = "".join(line for _, line in sorted(folders[one.path]))
            digest = sha256(text.encode()).hexdigest()
            if digest != one.digest:
                say(one.path, "the manifest states another digest", one.digest, digest)
