"""Splits of touch clips: nothing that is to be unseen is on both sides."""

import json
from pathlib import Path
from typing import Any

import pytest

import exumi_data
from exumi_data.errors import UsageError
from exumi_loaders.clip_splits import split_dataset


def with_split(dataset: Any, lists: dict[str, list[int]], level: str = "part") -> Any:
    """Store a split with a dataset, as if it came with it; lists of positions."""
    root = Path(dataset.path)
    document = json.loads((root / "dataset.json").read_text())
    (root / "dataset.json").write_text(json.dumps({**document, "splits": ["given"]}))
    (root / "splits").mkdir()
    split = {
        "format": "exumi-split",
        "version": "1.0",
        "name": "given",
        "level": level,
        "method": "by hand",
        "lists": {name: [dataset.ids[i] for i in at] for name, at in lists.items()},
    }
    (root / "splits" / "given.json").write_text(json.dumps(split))
    opened = exumi_data.open(root)
    assert isinstance(opened, exumi_data.Dataset)
    return opened.select(dataset.ids)


@pytest.fixture
def brushes(make_touches: Any, touch: Any) -> Any:
    """Two objects of two parts each, two clips a part."""
    return make_touches(
        *(touch(f"{name}_{part}", name) for name in "ab" for part in "xy" for _ in range(2))
    )


@pytest.mark.parametrize("by", ["part", "object"])
def test_what_is_unseen_is_on_one_side(brushes: Any, by: Any) -> None:
    column = f"{by}_id"
    sides = [
        set(split_dataset(brushes, name, by=by, ratio=(1, 1)).catalog.column(column).to_pylist())
        for name in ("train", "val")
    ]
    assert all(sides)
    assert not sides[0] & sides[1]


def test_a_stored_split_may_part_objects_but_not_when_objects_are_to_be_unseen(
    brushes: Any,
) -> None:
    stored = with_split(brushes, {"train": [0, 1, 4, 5], "test": [2, 3, 6, 7]})
    assert split_dataset(stored, "given/train").ids == [brushes.ids[i] for i in (0, 1, 4, 5)]
    with pytest.raises(UsageError, match=r"leaks: 2 object\(s\).*'a' in test, train"):
        split_dataset(stored, "given/train", by="object")


def test_a_stored_split_with_a_part_on_both_sides_is_refused(brushes: Any) -> None:
    stored = with_split(brushes, {"train": [0, 4, 5], "test": [1, 2]}, level="episode")
    with pytest.raises(UsageError, match=r"leaks: 1 part\(s\).*'a_x' in test, train"):
        split_dataset(stored, "given/train")
    assert len(split_dataset(stored, "given/train", by="episode")) == 3


def test_what_is_not_known_is_not_taken_for_unseen(make_touches: Any, touch: Any) -> None:
    dataset = make_touches(touch("lid", "box"), touch("cap"), touch("leg", "chair"))
    stored = with_split(dataset, {"train": [0, 1], "test": [2]})
    assert len(split_dataset(stored, "given/train")) == 2
    with pytest.raises(UsageError, match=r"1 episode\(s\) of split 'given' have no object_id"):
        split_dataset(stored, "given/train", by="object")


def test_a_list_that_holds_nothing_is_said(brushes: Any) -> None:
    stored = with_split(brushes, {"train": [0], "test": [7]})
    with pytest.raises(UsageError, match="no episode of the dataset"):
        split_dataset(stored.select([brushes.ids[0]]), "given/test")


def test_no_split_is_the_whole(brushes: Any) -> None:
    assert split_dataset(brushes, None) is brushes
