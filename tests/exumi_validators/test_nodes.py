"""An array is either in the standard's layout, or a rule says that it is not."""

import copy
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from zarr.core.metadata.v3 import ArrayV3Metadata

from exumi_data.errors import ExumiError
from exumi_data.store.zarr_document import (
    ArrayDocument,
    array_document,
    parse_array,
)
from exumi_validators.nodes import array_problems, node_mistake, parse_array_node

GOOD: dict[str, Any] = json.loads(
    array_document(ArrayDocument((100, 7), np.dtype("float64"), 10, 50, zstd=True))
)
SHARDING = ("codecs", 0, "configuration")
PLACES = [
    ("shape",),
    ("shape", 0),
    ("shape", 1),
    ("data_type",),
    ("chunk_grid",),
    ("chunk_grid", "name"),
    ("chunk_grid", "configuration", "chunk_shape"),
    ("chunk_grid", "configuration", "chunk_shape", 0),
    ("chunk_grid", "configuration", "chunk_shape", 1),
    ("chunk_key_encoding",),
    ("chunk_key_encoding", "name"),
    ("chunk_key_encoding", "configuration", "separator"),
    ("codecs",),
    ("codecs", 0),
    ("codecs", 0, "name"),
    SHARDING,
    (*SHARDING, "chunk_shape"),
    (*SHARDING, "chunk_shape", 0),
    (*SHARDING, "codecs"),
    (*SHARDING, "codecs", 0),
    (*SHARDING, "codecs", 0, "configuration"),
    (*SHARDING, "codecs", 1, "name"),
    (*SHARDING, "codecs", 1, "configuration"),
    (*SHARDING, "index_codecs"),
    (*SHARDING, "index_codecs", 0, "configuration", "endian"),
    (*SHARDING, "index_codecs", 1),
    (*SHARDING, "index_location"),
    ("storage_transformers",),
    ("fill_value",),
    ("dimension_names",),
    ("made_by",),
    ("chunk_grid", "configuration", "made_by"),
    ("chunk_key_encoding", "configuration", "made_by"),
    (*SHARDING, "made_by"),
    (*SHARDING, "codecs", 1, "configuration", "level"),
    (*SHARDING, "codecs", 1, "configuration", "checksum"),
    (*SHARDING, "codecs", 1, "configuration", "made_by"),
]
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-2, 200),
    st.sampled_from([1 << 40, 1 << 63, "", "big", "start", "gzip", "uint8", "float16", "."]),
    st.lists(st.integers(-1, 100), max_size=3),
    st.sampled_from([{}, {"name": "bytes"}, {"name": "regular"}, {"configuration": 3}]),
)


def problems(document: dict[str, Any]) -> list[str]:
    node = parse_array_node(document, "a")
    if node_mistake(document, "array"):
        return ["ZARR-001"]
    return ["ZARR-001"] if node is None else [found.code for found in array_problems(node)]


def test_the_good_one_has_none() -> None:
    assert problems(GOOD) == []


@pytest.mark.parametrize("shape", [None, 8, [-1], ["8"]])
def test_inner_chunks_without_a_size_are_told(shape: object) -> None:
    document = copy.deepcopy(GOOD)
    document["codecs"][0]["configuration"]["chunk_shape"] = shape
    assert problems(document) == ["ZARR-008"]


FILLS = [
    ("int8", -128, 128),
    ("int8", 127, -129),
    ("uint8", 255, -1),
    ("uint64", 2**64 - 1, 2**64),
    ("int64", 0, True),
    ("int64", 0, 0.5),
    ("bool", False, 0),
    ("float32", "NaN", "nan"),
    ("float64", 0, None),
    ("float64", 1.5, "abc"),
]


@pytest.mark.parametrize(("dtype", "good", "bad"), FILLS)
def test_fill_values_are_of_the_data_type(dtype: str, good: object, bad: object) -> None:
    document = {**GOOD, "data_type": dtype}
    assert node_mistake({**document, "fill_value": good}, "array") is None
    assert node_mistake({**document, "fill_value": bad}, "array") == f"`fill_value` is no {dtype}"


@pytest.mark.parametrize(("level", "found"), [(-131072, []), (22, []), (23, ["ZARR-003"])])
def test_levels_of_zstd_are_bounded(level: int, found: list[str]) -> None:
    document = copy.deepcopy(GOOD)
    document["codecs"][0]["configuration"]["codecs"][1]["configuration"]["level"] = level
    assert problems(document) == found


def changed(changes: list[tuple[Any, Any]]) -> dict[str, Any]:
    document = copy.deepcopy(GOOD)
    for place, value in changes:
        here: Any = document
        try:
            for key in place[:-1]:
                here = here[key]
            here[place[-1]] = copy.deepcopy(value)
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took the place away
    return document


CHANGES = st.lists(st.tuples(st.sampled_from(PLACES), VALUES), min_size=1, max_size=3)


@given(CHANGES)
def test_what_zarr_does_not_take_breaks_a_rule(changes: list[tuple[Any, Any]]) -> None:
    document = changed(changes)
    names = document.get("dimension_names")
    if problems(document) or names is not None:  # of names ZARR-005 speaks, which knows the array
        return
    taken = ArrayV3Metadata.from_dict(json.loads(json.dumps(document)))
    assert taken.shape == tuple(document["shape"])


@given(CHANGES)
def test_what_the_reader_does_not_take_breaks_a_rule(changes: list[tuple[Any, Any]]) -> None:
    document = changed(changes)
    found = problems(document)
    try:
        parse_array(json.dumps(document).encode(), "a")
    except ExumiError:
        assert found
