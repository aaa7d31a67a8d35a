"""Invalid cases: datasets."""

from collections.abc import Iterator

import numpy as np

from corpus.case import Case, Finding
from corpus.datasets import EGG, RICE, dataset, episode, episodes, place, split_by_part, zipped

__all__ = ["dataset_cases"]

HEAD = "dataset.json"
CATALOG = "catalog.parquet"
SPLIT = "splits/default.json"
OTHER = "018f0000-0000-7000-8000-0000000000c3"


def _episode_cases() -> Iterator[Case]:
    at = Finding("SET-001", HEAD)
    yield dataset("SET-001__no_head", "No dataset.json.", at, drop=(HEAD,))
    old, new = place(EGG), place(OTHER)
    moved = {path.replace(old, new): b for path, b in episodes().items() if path.startswith(old)}
    at = Finding("SET-002", new)
    about = "An episode under another id."
    yield dataset("SET-002__other_id", about, at, drop=(old,), add=moved)
    packed = place(EGG, ".zarr.zip")
    again = {packed: zipped(episode(EGG, "egg"))}
    at = Finding("SET-003", packed)
    yield dataset("SET-003__folder_and_zip", "One id, two episodes.", at, add=again)
    extra = {"episodes/a1/readme.txt": b"the best ones\n"}
    at = Finding("SET-004", "episodes/a1/readme.txt")
    yield dataset("SET-004__readme", "A text among the episodes.", at, add=extra)
    half = {f"episodes/c3/.partial-{OTHER}/streams/zarr.json": b"{}"}
    at = Finding("SET-005", f"episodes/c3/.partial-{OTHER}")
    yield dataset("SET-005__half_written", "An episode that was not finished.", at, add=half)
    aside = {f"episodes/c3/.replaced-{OTHER}.zarr/zarr.json": b"{}"}
    at = Finding("SET-006", f"episodes/c3/.replaced-{OTHER}.zarr")
    yield dataset("SET-006__put_aside", "An episode that was put aside.", at, add=aside)
    broken = {f"{place(RICE)}/streams/width/data/c/0": b""}
    found = Finding("SHARD-002", "streams/width/data/c/0", episode=place(RICE))
    about = "Damage in one episode."
    yield dataset("SHARD-002__in_a_dataset", about, found, replace=broken)


def _head_cases() -> Iterator[Case]:
    at = Finding("META-001", HEAD, "/name")
    yield dataset("META-001__dataset_name", "A dataset without a name.", at, unnamed=True)
    at = Finding("META-002", HEAD, "/release/version")
    about = "A release whose version has two numbers."
    yield dataset("META-002__of_release", about, at, release={"version": "1.1"})
    at = Finding("LIC-001", HEAD, "/licence")
    yield dataset("LIC-001__dataset", "A dataset of unknown licence.", at, licence="n/a")
    at = Finding("EXT-002", HEAD, "/acme:grant")
    about = "A vendor's object that is described nowhere."
    yield dataset("EXT-002__of_dataset", about, at, **{"acme:grant": {"number": 42}})
    at = Finding("DOC-005", HEAD, "/version")
    yield dataset("DOC-005__newer_dataset", "A dataset of version 2.3.", at, version="2.3")
    at = Finding("ROOT-003", HEAD, "/requires/0")
    about = "A dataset with a feature that nobody knows."
    yield dataset("ROOT-003__of_dataset", about, at, version="1.2", requires=["holograms"])


def _split_cases() -> Iterator[Case]:
    at = Finding("SPLIT-001", HEAD, "/splits/0")
    about = "A split that is not there."
    yield dataset("SPLIT-001__not_there", about, at, splits=["default"])
    newer = {SPLIT: split_by_part(version="2.0")}
    at = Finding("DOC-005", SPLIT, "/version")
    yield dataset(
        "DOC-005__newer_split", "A split of version 2.0.", at, add=newer, splits=["default"]
    )
    needy = {SPLIT: split_by_part(requires=["holograms"])}
    at = Finding("ROOT-003", SPLIT, "/requires/0")
    about = "A split with a feature that nobody knows."
    yield dataset("ROOT-003__of_split", about, at, add=needy, splits=["default"])
    good = {SPLIT: split_by_part()}
    at = Finding("SPLIT-002", SPLIT)
    yield dataset("SPLIT-002__not_listed", "A split that is not listed.", at, add=good)
    odd = {SPLIT: split_by_part(**{"acme:draw": {"dice": 3}})}
    at = Finding("EXT-002", SPLIT, "/acme:draw")
    yield dataset("EXT-002__of_split", about, at, add=odd, splits=["default"])

    def split(name: str, about: str, finding: Finding, /, **changes: object) -> Case:
        files = {SPLIT: split_by_part(**changes)}
        return dataset(name, about, finding, add=files, splits=["default"])

    at = Finding("SPLIT-003", SPLIT, "/name")
    yield split("SPLIT-003__other_name", "A split of another name.", at, name="main")
    lists = {"train": [EGG, OTHER], "val": [RICE]}
    at = Finding("SPLIT-004", SPLIT, "/lists/train")
    yield split("SPLIT-004__unknown_id", "An episode that is not there.", at, lists=lists)
    lists = {"train": [EGG, EGG], "val": [RICE]}
    at = Finding("SPLIT-005", SPLIT, "/lists")
    yield split("SPLIT-005__twice", "An episode that stands twice.", at, lists=lists)
    lists = {"train": [EGG]}
    at = Finding("SPLIT-008", SPLIT, "/lists")
    yield split("SPLIT-008__rice", "An episode in no list.", at, lists=lists)
    eggs = _replaced(RICE, "egg")
    at = Finding("SPLIT-006", SPLIT, "/lists")
    about = "Eggs to train on, and eggs to test on."
    files = {SPLIT: split_by_part(), **eggs}
    yield dataset("SPLIT-006__eggs", about, at, replace=files, splits=["default"])
    at = Finding("SPLIT-007", SPLIT, "/lists/val/0")
    about = "A part that nobody named."
    draft = episode(RICE, "rice")
    del draft.metadata["annotations"]["part_id"]
    files = {SPLIT: split_by_part(), f"{place(RICE)}/zarr.json": draft.files()["zarr.json"]}
    yield dataset("SPLIT-007__no_part", about, at, replace=files, splits=["default"])


def _replaced(episode_id: str, part: str) -> dict[str, bytes]:
    root = episode(episode_id, part).files()["zarr.json"]
    return {f"{place(episode_id)}/zarr.json": root}


def _catalog_cases() -> Iterator[Case]:
    at = Finding("CAT-001", CATALOG)
    yield dataset("CAT-001__missing", "No catalog.", at, drop=(CATALOG,))
    garbage = {CATALOG: b"PAR1 and no more"}
    yield dataset("CAT-001__damaged", "No parquet.", at, replace=garbage)
    at = Finding("CAT-002", CATALOG)
    fresh = episode(OTHER, "egg").files()
    added = {f"{place(OTHER)}/{path}": data for path, data in fresh.items()}
    yield dataset("CAT-002__new_episode", "An episode is not listed.", at, add=added)
    at = Finding("CAT-003", CATALOG, index=1)
    draft = episode(RICE, "rice")
    draft.metadata["revision"] = 2
    files = {f"{place(RICE)}/zarr.json": draft.files()["zarr.json"]}
    yield dataset("CAT-003__revision", "A revision is not listed.", at, replace=files)
    yield dataset("CAT-003__regime", "Another regime than the episode's.", at)
    at = Finding("CAT-004", CATALOG, index=0)
    draft = episode(EGG, "egg")
    draft.put("streams/width/data", np.array([0.0, 0.02], dtype=np.float32))
    shard = "streams/width/data/c/0"
    files = {f"{place(EGG)}/{shard}": draft.blobs[shard]}
    yield dataset("CAT-004__changed", "Other bytes than were listed.", at, replace=files)
    at = Finding("CAT-005", CATALOG, index=1)
    yield dataset("CAT-005__backwards", "The last episode's row comes first.", at)


def dataset_cases() -> Iterator[Case]:
    """Yield the cases of datasets."""
    yield from _episode_cases()
    yield from _head_cases()
    yield from _split_cases()
    yield from _catalog_cases()
