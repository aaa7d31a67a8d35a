"""Datasets: their documents, the places of their episodes, splits and the catalog."""

from collections import Counter
from collections.abc import Iterator

from exumi_data.catalog import CATALOG_NAME, episode_path
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.model.base import Model
from exumi_data.model.dataset import DATASET_FORMAT, DatasetMetadata, SplitDocument
from exumi_data.model.manifest import MANIFEST_FORMAT, Manifest
from exumi_validators.context import newer_minor
from exumi_validators.dataset_context import DatasetContext
from exumi_validators.document_rules import (
    DOCUMENT_RULES,
    MODEL_RULES,
    document_problems,
    licence_problems,
    model_rule_problems,
)
from exumi_validators.findings import problem
from exumi_validators.json_documents import LoadedDocument
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = [
    "catalog_digests",
    "catalog_is_complete",
    "catalog_is_readable",
    "catalog_rows",
    "documents",
    "fields",
    "is_there",
    "kept_together",
    "licence",
    "links",
    "listed_splits",
    "oddities",
    "once",
    "places",
    "split_coverage",
    "split_ids",
    "split_names",
    "split_overlap",
    "splits_exist",
]

_KEY_OF_LEVEL = {"object": "object_id", "part": "part_id"}
_SPLIT_FORMAT = "exumi-split"


@check("SET-001")
def is_there(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that there is a ``dataset.json``."""
    if dataset.loaded is None:
        yield problem("SET-001", DATASET_DOCUMENT)


@check(*DOCUMENT_RULES)
def documents(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge ``dataset.json``, the splits and the manifest as documents."""
    if dataset.loaded is not None:
        loaded = dataset.loaded
        yield from document_problems(loaded, loaded.value, DATASET_FORMAT, ())
    for loaded in dataset.split_files.values():
        yield from document_problems(loaded, loaded.value, _SPLIT_FORMAT, ())
    manifest = dataset.manifest_file
    if manifest is not None:
        yield from document_problems(manifest, manifest.value, MANIFEST_FORMAT, ())


@check(*MODEL_RULES)
def fields(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge every field of ``dataset.json``, the splits and the manifest."""
    documents: list[tuple[str, type[Model], LoadedDocument | None]] = [
        ("dataset", DatasetMetadata, dataset.loaded),
        *(("split", SplitDocument, loaded) for loaded in dataset.split_files.values()),
        ("manifest", Manifest, dataset.manifest_file),
    ]
    for name, model, loaded in documents:
        value = loaded.value if loaded else None
        if loaded is None or value is None or value.get("format") != f"exumi-{name}":
            continue
        if newer_minor(value.get("version")) is not None:
            yield from model_rule_problems(name, model, value, loaded.path, ())


@check("LIC-001", "LIC-002")
def licence(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge how the licence is written."""
    found = (dataset.document or {}).get("licence")
    yield from licence_problems(found, DATASET_DOCUMENT, ("licence",))


@check("SET-002")
def places(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that episodes lie where their id puts them."""
    for path, facts in dataset.facts.items():
        if facts.id is None:
            continue
        expected = episode_path(facts.id, packed=path.endswith(".zip"))
        if path != expected:
            yield problem("SET-002", path, expected=expected, found=facts.id)


@check("SET-003")
def once(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that no id stands twice."""
    seen: dict[str, str] = {}
    for path, facts in dataset.facts.items():
        if facts.id in seen:
            yield problem("SET-003", path, expected=seen[facts.id], found=facts.id)
        elif facts.id:
            seen[facts.id] = path


@check("SET-004", "SET-005", "SET-006")
def oddities(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge what else lies among the episodes."""
    codes = {"foreign": "SET-004", "partial": "SET-005", "replaced": "SET-006"}
    for path, kind in dataset.oddities:
        yield problem(codes[kind], path)


@check("SAFE-002")
def links(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that there are only files and folders."""
    for path in dataset.links:
        yield problem("SAFE-002", path, found=path)


@check("SPLIT-001")
def splits_exist(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that splits that are listed are there."""
    for index, name in enumerate(dataset.listed_splits):
        if name not in dataset.split_files:
            yield problem("SPLIT-001", DATASET_DOCUMENT, pointer=("splits", index), found=name)


@check("SPLIT-002")
def listed_splits(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that splits that are there are listed."""
    for name, loaded in dataset.split_files.items():
        if dataset.document is not None and name not in dataset.listed_splits:
            yield problem("SPLIT-002", loaded.path, found=name)


@check("SPLIT-003")
def split_names(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that a split and its file have the same name."""
    for name, split in dataset.splits.items():
        if split.name != name:
            path = dataset.split_files[name].path
            yield problem("SPLIT-003", path, pointer=("name",), expected=name, found=split.name)


@check("SPLIT-004")
def split_ids(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that splits name episodes that are there."""
    for name, split in dataset.splits.items():
        for part, ids in split.lists.items():
            unknown = [episode_id for episode_id in ids if episode_id not in dataset.by_id]
            if unknown:
                path = dataset.split_files[name].path
                pointer = ("lists", part)
                found = len(unknown)
                yield problem("SPLIT-004", path, pointer=pointer, found=found, detail=unknown[0])


@check("SPLIT-005")
def split_overlap(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that no episode is in two lists, or twice in one."""
    for name, split in dataset.splits.items():
        counts = Counter(episode_id for ids in split.lists.values() for episode_id in ids)
        twice = [episode_id for episode_id, count in counts.items() if count > 1]
        if twice:
            path = dataset.split_files[name].path
            found = len(twice)
            yield problem("SPLIT-005", path, pointer=("lists",), found=found, detail=twice[0])


@check("SPLIT-006", "SPLIT-007")
def kept_together(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that a split by object or part keeps each of them in one list."""
    for name, split in dataset.splits.items():
        if split.level in _KEY_OF_LEVEL:
            yield from _straddling(dataset, dataset.split_files[name].path, split)


def _straddling(dataset: DatasetContext, path: str, split: SplitDocument) -> Iterator[Problem]:
    key = _KEY_OF_LEVEL[split.level]
    lists_of: dict[str, set[str]] = {}
    for part, ids in split.lists.items():
        for index, episode_id in enumerate(ids):
            facts = dataset.by_id.get(episode_id)
            group = getattr(facts, key) if facts else None
            if facts is not None and group is None:
                pointer = ("lists", part, index)
                yield problem("SPLIT-007", path, pointer=pointer, expected=key, found=episode_id)
            elif group is not None:
                lists_of.setdefault(group, set()).add(part)
    for group, parts in lists_of.items():
        if len(parts) > 1:
            detail = ", ".join(sorted(parts))
            yield problem(
                "SPLIT-006",
                path,
                pointer=("lists",),
                expected=split.level,
                found=group,
                detail=detail,
            )


@check("SPLIT-008")
def split_coverage(dataset: DatasetContext) -> Iterator[Problem]:
    """Say how many episodes are in no list."""
    for name, split in dataset.splits.items():
        listed = {episode_id for ids in split.lists.values() for episode_id in ids}
        left = sorted(set(dataset.by_id) - listed)
        if left:
            path = dataset.split_files[name].path
            yield problem("SPLIT-008", path, pointer=("lists",), found=len(left), detail=left[0])


@check("CAT-001")
def catalog_is_readable(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that there is a catalog."""
    if isinstance(dataset.catalog, str):
        yield problem("CAT-001", CATALOG_NAME, detail=dataset.catalog)


@check("CAT-002")
def catalog_is_complete(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that the catalog lists what is there."""
    if isinstance(dataset.catalog, str):
        return
    listed, present = {str(row["path"]) for row in dataset.catalog}, set(dataset.episodes)
    gone, new = sorted(listed - present), sorted(present - listed)
    parts = []
    if gone:
        parts.append(f"{len(gone)} listed episodes are not there, the first is {gone[0]}")
    if new:
        parts.append(f"{len(new)} episodes are not listed, the first is {new[0]}")
    if len(dataset.catalog) > len(listed):
        parts.append("an episode is listed twice")
    if parts:
        yield problem("CAT-002", CATALOG_NAME, detail="; ".join(parts))


@check("CAT-003")
def catalog_rows(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that the catalog's rows say what the episodes say."""
    if isinstance(dataset.catalog, str):
        return
    for index, row in enumerate(dataset.catalog):
        facts = dataset.facts.get(str(row["path"]))
        if facts is None or facts.root_sha256 is None or facts.id is None:
            continue
        for column in ("id", "revision", "object_id", "part_id", "root_sha256"):
            expected = getattr(facts, column)
            if column == "revision" and expected is None:
                expected = 1
            if row[column] != expected:
                yield problem(
                    "CAT-003",
                    CATALOG_NAME,
                    index=index,
                    expected=_shown(expected),
                    found=_shown(row[column]),
                    detail=f"{column} of {facts.id}",
                )
                break


def _shown(value: object) -> str:
    return "nothing" if value is None else str(value)


@check("CAT-004")
def catalog_digests(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that no byte has changed since the catalog was written."""
    if isinstance(dataset.catalog, str):
        return
    for index, row in enumerate(dataset.catalog):
        facts = dataset.facts.get(str(row["path"]))
        if facts is None or facts.digest is None or facts.root_sha256 != row["root_sha256"]:
            continue  # a row of other metadata has another digest, which is said already
        if facts.digest != row["digest"]:
            found = str(row["digest"])
            yield problem("CAT-004", CATALOG_NAME, index=index, expected=facts.digest, found=found)
