"""Datasets: their documents, the places of their episodes, splits and the catalog."""

import itertools
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

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
    undescribed_objects,
)
from exumi_validators.episode_run import EpisodeFacts, ReferenceFacts, in_brief
from exumi_validators.findings import problem
from exumi_validators.json_documents import LoadedDocument
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = [
    "catalog_digests",
    "catalog_is_complete",
    "catalog_is_readable",
    "catalog_order",
    "catalog_rows",
    "documents",
    "fields",
    "is_there",
    "kept_together",
    "labels_of_things",
    "licence",
    "links",
    "listed_splits",
    "objects_of_parts",
    "oddities",
    "once",
    "places",
    "same_gel",
    "split_coverage",
    "split_ids",
    "split_names",
    "split_overlap",
    "splits_exist",
    "touched_on_both_sides",
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


@check("EXT-002")
def third_parties(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that objects of third parties say where they are described."""
    yield from undescribed_objects("dataset", dataset.document or {}, DATASET_DOCUMENT, ())
    for loaded in dataset.split_files.values():
        yield from undescribed_objects("split", loaded.value or {}, loaded.path, ())
    manifest = dataset.manifest_file
    if manifest is not None:
        yield from undescribed_objects("manifest", manifest.value or {}, manifest.path, ())


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
            unknown = [episode_id for episode_id in ids if episode_id not in dataset.ids]
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


@check("SET-007")
def objects_of_parts(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that episodes of a part are of the same object; one that names none may be."""
    seen: dict[str, str] = {}
    for path, facts in dataset.facts.items():
        if facts.part_id is None or facts.object_id is None:
            continue
        before = seen.setdefault(facts.part_id, facts.object_id)
        if before != facts.object_id:
            yield problem(
                "SET-007", path, expected=before, found=facts.part_id, detail=facts.object_id
            )


@check("SET-008")
def labels_of_things(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that one source says one thing of a part, or of an object without parts."""
    seen: dict[tuple[str | None, ...], str] = {}
    for path, facts in dataset.facts.items():
        if facts.part_id is None and facts.object_id is None:
            continue
        thing = (facts.object_id, facts.part_id, facts.instance_id)
        # Two values within one episode are the matter of another rule: the first one counts.
        said = {(label.property, label.source): label.value for label in reversed(facts.labels)}
        for (name, source), value in said.items():
            before = seen.setdefault((*thing, name, source), value)
            if before != value:
                named = facts.part_id or facts.object_id
                detail = f"{name} of {named}"
                yield problem("SET-008", path, expected=before, found=value, detail=detail)


@check("SPLIT-009")
def touched_on_both_sides(dataset: DatasetContext) -> Iterator[Finding]:
    """Say of how many things, in a split by episode, there are episodes in several lists.

    That matters where models learn what things feel like: with labels, or by touch alone.
    """
    for name, split in dataset.splits.items():
        if split.level != "episode":
            continue
        path = dataset.split_files[name].path
        lists_of = _lists_of_things(dataset, split)
        if not lists_of:
            yield Skipped("SPLIT-009", "nothing that was touched has an id", path)
        for level in ("part", "object"):
            lists = [found for (kind, _), found in lists_of.items() if kind == level]
            straddling = sum(len(found) > 1 for found in lists)
            if straddling:
                pointer = ("lists",)
                yield problem(
                    "SPLIT-009",
                    path,
                    pointer=pointer,
                    expected=len(lists),
                    found=straddling,
                    detail=level,
                )
                break


def _lists_of_things(
    dataset: DatasetContext, split: SplitDocument
) -> dict[tuple[str, str], set[str]]:
    """Return the lists that episodes of each (level, id) are in."""
    found: dict[tuple[str, str], set[str]] = {}
    for part, ids in split.lists.items():
        for facts in (dataset.by_id.get(episode_id) for episode_id in ids):
            if facts is None or not (facts.labels or facts.regime == "touch"):
                continue
            for level, key in _KEY_OF_LEVEL.items():
                thing = getattr(facts, key)
                if thing is not None:
                    found.setdefault((level, thing), set()).add(part)
    return found


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
        else:
            yield from _columns(index, row, facts)


def _columns(index: int, row: dict[str, Any], facts: EpisodeFacts) -> Iterator[Problem]:
    """Compare the other columns that are the metadata's own; the first that differs is told."""
    for column, expected in facts.columns.items():
        found = in_brief(row[column]) if column in row else expected
        if found != expected:
            detail = f"{column} of {facts.id}"
            yield problem(
                "CAT-003", CATALOG_NAME, index=index, expected=expected, found=found, detail=detail
            )
            return


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
            yield problem(
                "CAT-004",
                CATALOG_NAME,
                index=index,
                expected=facts.digest,
                found=found,
                detail=str(row["path"]),
            )


@check("CAT-005")
def catalog_order(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that rows are in the order of their paths; the first that is not is told."""
    if isinstance(dataset.catalog, str):
        return
    paths = [str(row["path"]) for row in dataset.catalog]
    for index, (before, path) in enumerate(itertools.pairwise(paths), start=1):
        if path < before:
            yield problem("CAT-005", CATALOG_NAME, index=index, expected=before, found=path)
            return


@check("TACT-012")
def same_gel(dataset: DatasetContext) -> Iterator[Finding]:
    """Judge that the reference of a sensor stays what it was, episode after episode."""
    by_sensor: dict[tuple[str, str], list[tuple[str, ReferenceFacts]]] = {}
    in_order = sorted(dataset.facts.items(), key=lambda item: (item[1].start or "", item[0]))
    for path, facts in in_order:
        for reference in facts.references:
            by_sensor.setdefault((reference.model, reference.serial), []).append((path, reference))
    for references in by_sensor.values():
        yield from _gel_findings(references, dataset.limit("TACT-012", "mean_grey_levels"))
    if not any(len(references) > 1 for references in by_sensor.values()):
        yield Skipped("TACT-012", "no sensor with a serial and references of two episodes", ".")


def _gel_findings(references: list[tuple[str, ReferenceFacts]], limit: float) -> Iterator[Finding]:
    """Compare each reference with the one that the sensor had since its last change."""
    since, first = references[0]
    for path, reference in references[1:]:
        levels = np.frombuffer(first.coarse, np.uint8).astype(np.int16)
        levels -= np.frombuffer(reference.coarse, np.uint8)
        found = float(np.abs(levels).mean())
        if found > limit:
            yield problem(
                "TACT-012",
                f"{path}/streams/{reference.stream}/reference",
                expected=since,
                found=round(found, 1),
                sensor=f"{reference.model} {reference.serial}",
                limit=limit,
            )
            since, first = path, reference
