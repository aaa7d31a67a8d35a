"""A small part of a release that shows what is in it: a valid dataset of its own."""

import heapq
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from exumi_data.catalog import EPISODES_FOLDER, rows_to_table, write_catalog
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.editing.documents import document_bytes, write_splits
from exumi_data.manifest import Listed, write_manifest
from exumi_data.model.dataset import DatasetMetadata, SplitDocument
from exumi_data.model.documents import dump
from exumi_data.release.licence import LICENCE_NAME
from exumi_data.release.packing import Packed
from exumi_data.store.files import atomic_file, write_atomic

__all__ = ["PREVIEW_FOLDER", "choose_preview", "write_preview"]

PREVIEW_FOLDER = "preview"

_DOCUMENT_BYTES = 64 << 10  # dataset.json, splits, an empty catalog, a page about it
_ENTRY_BYTES = 4 << 10  # of an episode: its rows in catalog and manifest, its ids in splits
_SHARE = 0.1
_LONGEST_NAME = 240
_BINS = 5
_COLUMNS = ("task", "regime", "object_id", "part_id", "procedure", "pad_type", "success")


def choose_preview(
    rows: Sequence[Mapping[str, Any]],
    sizes: Mapping[str, int],
    most_bytes: int,
    splits: Mapping[str, SplitDocument] | None = None,
) -> list[str]:
    """Choose episodes that together show as much as fits of what a dataset holds.

    What an episode shows: its task, object, part, labels, streams, notes of quality, and lists of
    splits. Each step takes the episode that adds most for its size; what was shown once counts
    half, and so on. It ends when all is shown and a tenth of the dataset is taken, or nothing more
    fits.

    Parameters
    ----------
    rows : sequence of mapping
        The catalog.
    sizes : mapping of str to int
        Bytes of each episode, by id.
    most_bytes : int
        Of the whole preview.
    splits : mapping of str to SplitDocument, optional

    Returns
    -------
    list of str
        Ids, sorted: the same for the same dataset, in whatever order its rows are.
    """
    shows = _facets(rows, splits or {})
    left = most_bytes - _DOCUMENT_BYTES
    costs = {one: sizes[one] + _ENTRY_BYTES for one in shows}
    if not costs:
        return []
    usual = median(costs.values())
    enough = _SHARE * sum(costs.values())
    seen: dict[object, int] = {}
    missing = {facet for facets in shows.values() for facet in facets}

    def gain(one: str) -> float:
        # Halves add up exactly. A tiny episode is no better than a small one.
        return sum(0.5 ** min(seen.get(facet, 0), 30) for facet in shows[one]) / (
            costs[one] + usual
        )

    # Gains only shrink: the first of the heap whose gain is still what it was is the best.
    heap = [(-gain(one), one) for one in sorted(shows)]
    heapq.heapify(heap)
    chosen: list[str] = []
    taken = 0
    while heap and (missing or taken < enough):
        before, one = heapq.heappop(heap)
        if costs[one] > left:
            continue
        now = -gain(one)
        if heap and (now, one) > heap[0] and now != before:
            heapq.heappush(heap, (now, one))
            continue
        chosen.append(one)
        left -= costs[one]
        taken += costs[one]
        for facet in shows[one]:
            seen[facet] = seen.get(facet, 0) + 1
            missing.discard(facet)
    return sorted(chosen)


def write_preview(
    root: Path,
    ids: Iterable[str],
    packed: Sequence[Packed],
    metadata: DatasetMetadata,
    splits: Mapping[str, SplitDocument],
) -> Path:
    """Write the preview of a release into its folder.

    Parameters
    ----------
    root : pathlib.Path
        The release that is being made, with its licence.
    ids : iterable of str
        Of the episodes, which are copied.
    packed : sequence of Packed
        All episodes of the release.
    metadata : DatasetMetadata
        Of the release.
    splits : mapping of str to SplitDocument
        Of the release; the preview's are what is left of them.

    Returns
    -------
    pathlib.Path
        Its folder.
    """
    folder, wanted = root / PREVIEW_FOLDER, set(ids)
    chosen = [one for one in packed if one.row["id"] in wanted]
    (folder / EPISODES_FOLDER).mkdir(parents=True)
    document = metadata.model_copy(deep=True)
    document.name = f"{metadata.name[:_LONGEST_NAME].strip()} (preview)"
    document.description = (
        f"{len(chosen)} of the {len(packed)} episodes, chosen to show what there is."
    )
    document.splits = []
    write_atomic(folder / DATASET_DOCUMENT, document_bytes(dump(document)))
    for one in chosen:
        with atomic_file(folder / one.path) as target:
            shutil.copyfile(root / one.path, target)
    write_splits(folder, _shrunk(splits, wanted))
    write_catalog(folder, rows_to_table([one.row for one in chosen]))
    shutil.copyfile(root / LICENCE_NAME, folder / LICENCE_NAME)
    known: dict[str, Listed] = {one.path: one.listed for one in chosen}
    write_manifest(folder, known)
    return folder


def _shrunk(splits: Mapping[str, SplitDocument], wanted: set[str]) -> dict[str, SplitDocument]:
    return {
        name: one.model_copy(
            update={
                "lists": {part: [i for i in ids if i in wanted] for part, ids in one.lists.items()}
            }
        )
        for name, one in splits.items()
    }


def _facets(
    rows: Sequence[Mapping[str, Any]], splits: Mapping[str, SplitDocument]
) -> dict[str, list[tuple[object, ...]]]:
    """Return what each episode shows, sorted."""
    edges = _edges(rows)
    shows: dict[str, set[tuple[object, ...]]] = {}
    for row in rows:
        facets: set[tuple[object, ...]] = {
            (column, row[column]) for column in _COLUMNS if row[column] is not None
        }
        facets |= {("quality", code) for code in row["quality"]}
        facets |= {
            ("stream", one["name"], one["kind"], str(one["encoding"])) for one in row["streams"]
        }
        for label in row["labels"]:
            if label["text"] is not None:
                facets |= {("label", label["property"], word) for word in label["text"].split("|")}
            elif label["number"] is not None:
                low, width = edges[label["property"]]
                place = min(int((label["number"] - low) / width), _BINS - 1) if width else 0
                facets.add(("label", label["property"], place))
        shows[str(row["id"])] = facets
    for name, document in splits.items():
        for part, ids in document.lists.items():
            for one in ids:
                if one in shows:
                    shows[one].add(("split", name, part))
    return {one: sorted(facets, key=repr) for one, facets in shows.items()}


def _edges(rows: Sequence[Mapping[str, Any]]) -> dict[str, tuple[float, float]]:
    """Return the smallest number of each property, and the width of one of five bins."""
    numbers: dict[str, list[float]] = {}
    for row in rows:
        for label in row["labels"]:
            if label["number"] is not None:
                numbers.setdefault(label["property"], []).append(label["number"])
    return {
        key: (min(values), (max(values) - min(values)) / _BINS) for key, values in numbers.items()
    }
