"""Datasets of two tiny episodes, and what can be wrong with them."""

from typing import Any

import numpy as np

from corpus import bases
from corpus.case import Case, Finding, as_zip
from corpus.draft import Draft, dumps

__all__ = [
    "EGG",
    "RICE",
    "dataset",
    "episode",
    "episodes",
    "packed_episodes",
    "place",
    "split_by_part",
    "zipped",
]

EGG = "018f0000-0000-7000-8000-0000000000a1"
RICE = "018f0000-0000-7000-8000-0000000000b2"


def episode(episode_id: str, part: str) -> Draft:
    """Return an episode of a part."""
    annotations = {"object_id": part, "part_id": part}
    draft = Draft(id=episode_id, annotations=annotations)
    draft.stream("width", "width")
    draft.put("streams/width/time", bases.times(2))
    draft.put("streams/width/data", np.array([0.0, 0.01], dtype=np.float32))
    return draft


def place(episode_id: str, suffix: str = ".zarr") -> str:
    """Return an episode's path."""
    return f"episodes/{episode_id[-2:]}/{episode_id}{suffix}"


def zipped(draft: Draft) -> bytes:
    """Return a packed episode."""
    return as_zip(draft.files())


def episodes() -> dict[str, bytes]:
    """Return the files of the two episodes."""
    found = {}
    for episode_id, part in ((EGG, "egg"), (RICE, "rice")):
        for path, data in episode(episode_id, part).files().items():
            found[f"{place(episode_id)}/{path}"] = data
    return found


def packed_episodes() -> dict[str, bytes]:
    """Return the files of the two episodes, packed."""
    parts = ((EGG, "egg"), (RICE, "rice"))
    return {place(e, ".zarr.zip"): zipped(episode(e, part)) for e, part in parts}


def split_by_part(**changes: Any) -> bytes:
    """Return a split of the two parts."""
    document = {
        "format": "exumi-split",
        "version": "1.0",
        "name": "default",
        "level": "part",
        "seed": 0,
        "lists": {"train": [EGG], "val": [RICE]},
        **changes,
    }
    return dumps(document)


def dataset(
    name: str,
    about: str,
    *findings: Finding,
    add: dict[str, bytes] | None = None,
    drop: tuple[str, ...] = (),
    replace: dict[str, bytes] | None = None,
    unnamed: bool = False,
    **document: Any,
) -> Case:
    """Make a case of the dataset of two episodes, with one thing changed."""
    head = {
        "format": "exumi-dataset",
        "version": "1.0",
        "name": "corpus",
        "licence": "CC0-1.0",
        "splits": [],
        **document,
    }
    if unnamed:
        del head["name"]
    # A case whose episodes are others has a catalog of its own: see make_sources.py.
    own = bases.SOURCES / f"catalog_{name}.parquet"
    catalog = own if own.exists() else bases.SOURCES / "catalog.parquet"
    files = {
        "dataset.json": dumps(head),
        "catalog.parquet": catalog.read_bytes(),
        **episodes(),
        **(add or {}),
        **(replace or {}),
    }
    kept = {path: data for path, data in files.items() if not path.startswith(drop or ("\0",))}
    return Case(name, about, "dataset", kept, findings)
