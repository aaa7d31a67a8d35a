"""Cases of signal quality: labels."""

from collections.abc import Iterator
from typing import Any

from corpus import bases
from corpus.case import EXUMI, Case, Finding, case
from corpus.datasets import EGG, RICE, dataset, episode, place, split_by_part
from corpus.draft import Draft

__all__ = ["labels_cases"]

ROOT = "zarr.json"
SPLIT = "splits/default.json"
LABELS = f"{EXUMI}/annotations/labels"


def _label(value: float = 7.0, **changes: Any) -> dict[str, Any]:
    label = {"property": "hardness", "value": value, "scale": [0.0, 10.0], "provenance": "human"}
    return {**label, "origin": "labels.csv", **changes}


def _labelled(*labels: dict[str, Any], **annotations: Any) -> Draft:
    return bases.poses(annotations={"part_id": "egg", **annotations, "labels": list(labels)})


def _episode_cases() -> Iterator[Case]:
    at = Finding("ANN-004", ROOT, f"{LABELS}/0")
    draft = _labelled(_label(origin=None))
    yield case("ANN-004__someone", "A label of nobody knows whom.", draft, at)
    draft = _labelled(_label(provenance="model", origin=None, raters=3))
    yield case("ANN-004__some_model", "A label of nobody knows which model.", draft, at)
    at = Finding("ANN-005", ROOT, LABELS)
    draft = _labelled(_label(), part_id=None)
    yield case("ANN-005__of_nothing", "The hardness of nothing.", draft, at)
    at = Finding("ANN-006", ROOT, f"{LABELS}/1")
    draft = _labelled(_label(), _label(3.0))
    yield case("ANN-006__seven_and_three", "Hardness 7, and 3.", draft, at)
    at = Finding("ANN-007", ROOT, f"{EXUMI}/annotations/segments/0")
    segment = {"name": "contact", "start_ns": 2_000_000_000, "end_ns": 3_000_000_000}
    draft = bases.poses(annotations={"segments": [segment]})
    yield case("ANN-007__after_the_end", "Contact after the end.", draft, at)


def _changed(episode_id: str, part: str, **annotations: Any) -> dict[str, bytes]:
    """Return the root's document of an episode of the dataset, with other annotations."""
    draft = episode(episode_id, part)
    draft.metadata["annotations"].update(annotations)
    return {f"{place(episode_id)}/zarr.json": draft.files()["zarr.json"]}


def _dataset_cases() -> Iterator[Case]:
    at = Finding("SET-007", place(RICE))
    files = _changed(RICE, "rice", part_id="egg")
    about = "A part of an egg and of rice."
    yield dataset("SET-007__egg_of_rice", about, at, replace=files)
    at = Finding("SET-008", place(RICE))
    files = _changed(EGG, "egg", labels=[_label()])
    files |= _changed(RICE, "egg", labels=[_label(3.0)])
    about = "An egg of hardness 7, and 3."
    yield dataset("SET-008__seven_and_three", about, at, replace=files)
    at = Finding("SPLIT-009", SPLIT, "/lists")
    files = _changed(EGG, "egg", labels=[_label()]) | _changed(RICE, "egg", labels=[_label()])
    files[SPLIT] = split_by_part(level="episode")
    about = "An egg in train and in val."
    name = "SPLIT-009__egg"
    yield dataset(name, about, at, replace=files, splits=["default"])


def labels_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from _episode_cases()
    yield from _dataset_cases()
