"""Splits keep together what they say, whatever the order."""

from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.catalog import rows_to_table
from exumi_data.dataset import Dataset
from exumi_data.errors import UsageError
from exumi_data.model import DatasetMetadata
from exumi_data.splits import make_split, split_ids


def dataset_of(parts: list[str | None]) -> Dataset:
    rows: list[dict[str, Any]] = [
        {
            "id": f"{number:08x}-0000-4000-8000-000000000000",
            "path": f"episodes/00/{number:08x}.zarr",
            "revision": 1,
            "root_sha256": "",
            "digest": "",
            "bytes": 0,
            "duration_s": 1.0,
            "regime": "touch",
            "task": "t",
            "licence": "CC0-1.0",
            "part_id": part,
            "object_id": None if part is None else part.partition("_")[0],
            "labels": [],
            "quality": [],
            "streams": [],
        }
        for number, part in enumerate(parts)
    ]
    table: pa.Table = rows_to_table(rows)
    return Dataset("set", DatasetMetadata(name="set", licence="CC0-1.0"), table)


def test_fifteen_to_one_by_default() -> None:
    split = make_split(dataset_of(["x"] * 264))
    assert len(split.lists["val"]) == round(264 / 16)
    assert len(split.lists["train"]) + len(split.lists["val"]) == 264


@given(
    st.lists(st.sampled_from(["a_1", "a_2", "b_1", "b_2", "c_1"]), min_size=1, max_size=40),
    st.integers(0, 5),
    st.sampled_from(["object", "part"]),
)
def test_groups_never_straddle(parts: list[str], seed: int, level: Any) -> None:
    dataset = dataset_of(list(parts))
    split = make_split(dataset, level=level, ratio=(2, 1), seed=seed)
    column = dataset.catalog.column(f"{level}_id").to_pylist()
    of = dict(zip(dataset.ids, column, strict=True))
    train = {of[i] for i in split.lists["train"]}
    val = {of[i] for i in split.lists["val"]}
    assert not train & val
    assert sorted(split.lists["train"] + split.lists["val"]) == sorted(dataset.ids)
    if len(set(column)) > 1:
        assert train
        assert val


def test_order_of_episodes_does_not_matter() -> None:
    dataset = dataset_of([f"p_{i % 7}" for i in range(40)])
    turned = dataset[::-1]
    one, other = make_split(dataset, seed=3), make_split(turned, seed=3)
    assert set(one.lists["val"]) == set(other.lists["val"])
    assert make_split(dataset, seed=4).lists != one.lists


def test_errors_say_what_to_do() -> None:
    with pytest.raises(UsageError, match="have no part_id"):
        make_split(dataset_of(["a", None]), level="part")
    with pytest.raises(UsageError, match="makes no sense"):
        make_split(dataset_of(["a"]), ratio=(0, 0))
    with pytest.raises(UsageError, match="no list 'test'"):
        split_ids(dataset_of(["a"]), "test")
    with pytest.raises(UsageError, match="no split 'paper'"):
        split_ids(dataset_of(["a"]), "paper/train")
