"""A dataset as the checks see it: its documents, its catalog, and the facts of its episodes."""

import os
import stat
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from pydantic import TypeAdapter

from exumi_data.catalog import (
    CATALOG_NAME,
    EPISODES_FOLDER,
    list_episodes,
    obstacle_to_catalog,
    open_catalog,
)
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.errors import DamagedDataError, ExumiError
from exumi_data.manifest import MANIFEST_NAME
from exumi_data.model.base import Model
from exumi_data.model.dataset import DATASET_FORMAT, DatasetMetadata, SplitDocument
from exumi_data.model.json_limits import MAX_DOCUMENT_BYTES, MAX_DOCUMENT_PARTS, MAX_LIST_PARTS
from exumi_data.model.manifest import Manifest
from exumi_data.standard import Rule, rules
from exumi_data.store.plain_files import read_plain
from exumi_validators.context import understood
from exumi_validators.episode_run import EpisodeFacts
from exumi_validators.json_documents import LoadedDocument, load_document
from exumi_validators.listing import list_folder
from exumi_validators.model_problems import parse_leniently

__all__ = ["CatalogRows", "DatasetContext"]

M = TypeVar("M", bound=Model)

CatalogRows = list[dict[str, Any]]
_NEEDED = ("id", "path", "revision", "root_sha256", "digest", "object_id", "part_id")
_COMPARED = (
    *_NEEDED, "start", "regime", "task", "success", "licence", "instance_id", "trial", "procedure",
    "pad_type", "labels", "quality",
)  # fmt: skip


class DatasetContext:
    """One dataset under validation.

    Parameters
    ----------
    root : pathlib.Path
    limits : mapping, optional
        Numbers to judge by in place of those in the table of rules, by the rule's id.

    Attributes
    ----------
    facts : dict
        Path of each episode to what is known of it; filled in once the episodes were validated.
    """

    def __init__(self, root: Path, limits: Mapping[str, Mapping[str, float]] | None = None) -> None:
        self.root = root
        self._limits = limits or {}
        self.facts: dict[str, EpisodeFacts] = {}

    def limit(self, code: str | Rule, name: str) -> float:
        """Return a number that a rule judges by.

        Parameters
        ----------
        code : str or Rule
            Id of a rule of the standard, or another package's rule.
        name : str
            Of the limit, as the table of rules has it.
        """
        rule = code if isinstance(code, Rule) else rules()[code]
        return self._limits.get(rule.id, {}).get(name, rule.limits[name])

    @cached_property
    def episodes(self) -> list[str]:
        """Paths of all finished episodes."""
        return [] if EPISODES_FOLDER in self.links else list_episodes(self.root)

    @cached_property
    def loaded(self) -> LoadedDocument | None:
        """``dataset.json``; None when it is not there."""
        return self._load(DATASET_DOCUMENT)

    def _load(self, path: str) -> LoadedDocument | None:
        most = MAX_DOCUMENT_PARTS if path == DATASET_DOCUMENT else MAX_LIST_PARTS
        try:
            raw = read_plain(self.root / path, MAX_DOCUMENT_BYTES)
            return load_document(raw, path, most_parts=most)
        except FileNotFoundError:
            return None
        except ExumiError as error:
            return LoadedDocument(path, mistake=error.what)

    @property
    def document(self) -> dict[str, Any] | None:
        """The object in ``dataset.json``."""
        return self.loaded.value if self.loaded else None

    @cached_property
    def judgeable(self) -> bool:
        """Whether the dataset is of a version and features that are known, as far as it says."""
        document = self.document
        if document is None or document.get("format") != DATASET_FORMAT:
            return True
        version = document.get("version")
        major = version.partition(".")[0] if isinstance(version, str) else ""
        return understood(document) or not major.isdigit()

    @cached_property
    def metadata(self) -> DatasetMetadata | None:
        """The metadata, when it is valid."""
        return self._parse(DatasetMetadata, self.document)

    @staticmethod
    def _parse(model: type[M], document: dict[str, Any] | None) -> M | None:
        if document is None or not understood(document):
            return None
        parsed: M | None = parse_leniently(TypeAdapter(model), document)
        return parsed

    @cached_property
    def listed_splits(self) -> list[str]:
        """The names in ``dataset.json``, whatever is wrong elsewhere in it."""
        names = (self.document or {}).get("splits")
        return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []

    @cached_property
    def split_files(self) -> dict[str, LoadedDocument]:
        """The documents in ``splits``, by name."""
        folder = self.root / "splits"
        if not folder.is_dir():
            return {}
        names = sorted(p.name.removesuffix(".json") for p in folder.glob("*.json"))
        loaded = {name: self._load(f"splits/{name}.json") for name in names}
        return {name: document for name, document in loaded.items() if document is not None}

    @cached_property
    def splits(self) -> dict[str, SplitDocument]:
        """The splits whose document is valid, by the name of their file."""
        parsed = {
            name: self._parse(SplitDocument, loaded.value)
            for name, loaded in self.split_files.items()
        }
        return {name: split for name, split in parsed.items() if split is not None}

    @cached_property
    def manifest_file(self) -> LoadedDocument | None:
        """``manifest.json``; None when it is not there."""
        return self._load(MANIFEST_NAME)

    @cached_property
    def manifest(self) -> Manifest | None:
        """The manifest, when it is valid."""
        return self._parse(Manifest, self.manifest_file.value if self.manifest_file else None)

    @cached_property
    def files(self) -> dict[str, int]:
        """Path to size of all files of the dataset; no link is followed."""
        return list_folder(str(self.root)).files

    @cached_property
    def by_id(self) -> dict[str, EpisodeFacts]:
        """Facts of the episodes by id."""
        return {facts.id: facts for facts in self.facts.values() if facts.id}

    @cached_property
    def ids(self) -> set[str]:
        """The ids of all episodes; of one that cannot be read, that of its file's name."""
        unread = (path for path in self.episodes if not self._id_at(path))
        names = (PurePosixPath(path).name for path in (*unread, *self.links))
        return {*self.by_id, *(name.partition(".")[0] for name in names)}

    def _id_at(self, path: str) -> str | None:
        facts = self.facts.get(path)
        return facts.id if facts else None

    @cached_property
    def oddities(self) -> list[tuple[str, str]]:
        """What lies among the episodes and is none: (path, ``partial | replaced | foreign``)."""
        base = self.root / EPISODES_FOLDER
        found = [(EPISODES_FOLDER, "foreign")] if base.is_file() and not base.is_symlink() else []
        folders = sorted(base.iterdir()) if base.is_dir() else []
        for folder in folders:
            entries = [folder]
            if folder.is_dir() and not folder.is_symlink() and not folder.name.startswith("."):
                entries = sorted(folder.iterdir())
            for entry in entries:
                path = entry.relative_to(self.root).as_posix()
                kind = _kind(entry.name)
                if kind and path not in self.episodes and path not in self.links:
                    found.append((path, kind))
        return found

    @cached_property
    def links(self) -> list[str]:
        """Links and special files that stand where the dataset's own files or folders should."""
        splits = self.root / "splits"
        folders = [self.root / EPISODES_FOLDER, splits, *_inside(self.root / EPISODES_FOLDER)]
        files = [self.root / name for name in (DATASET_DOCUMENT, CATALOG_NAME, MANIFEST_NAME)]
        entries = [entry for folder in folders[2:] for entry in _inside(folder)]
        found = [p for p in (*folders, *files, *_inside(splits), *entries) if _is_special(p)]
        return sorted(path.relative_to(self.root).as_posix() for path in found)

    @cached_property
    def catalog(self) -> CatalogRows | str:
        """The catalog's rows, or why it cannot be used."""
        try:
            with open_catalog(self.root) as file:
                lacking = sorted(set(_NEEDED) - set(file.schema_arrow.names))
                if lacking:
                    return f"catalog.parquet lacks the columns {', '.join(lacking)}"
                rows = file.metadata.num_rows
                # Read only what could be a catalog of these episodes: a file can claim anything.
                if rows > 1000 + 4 * len(self.episodes):
                    return f"catalog.parquet lists {rows} episodes; there are {len(self.episodes)}"
                columns = [name for name in _COMPARED if name in file.schema_arrow.names]
                table: list[dict[str, Any]] = file.read(columns=columns).to_pylist()
                return table
        except FileNotFoundError:
            return obstacle_to_catalog(self.root) or f"{CATALOG_NAME} is missing"
        except DamagedDataError as error:
            return f"{CATALOG_NAME} {error.what}"


def _inside(folder: Path) -> list[Path]:
    """Return what lies in a folder that is one; hidden names are passed over."""
    if folder.is_symlink() or not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def _is_special(path: Path) -> bool:
    try:
        mode = path.lstat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _kind(name: str) -> str | None:
    if name.startswith(".partial-"):
        return "partial"
    if name.startswith(".replaced-"):
        return "replaced"
    return None if name.startswith(".") else "foreign"


def episode_is_packed(path: str | os.PathLike[str]) -> bool:
    """Whether an episode's path is that of a packed one.

    Parameters
    ----------
    path : path-like
    """
    return os.fspath(path).endswith(".zip")
