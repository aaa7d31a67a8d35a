"""Names that are also words of the standard: whatever is taken out, a document stays one."""

import copy
import json
from typing import Any

import pytest

from exumi_data.model.documents import parse_dataset, parse_episode, parse_split
from exumi_data.release.privacy.documents import Removal, without_private_fields
from exumi_data.release.privacy.kinds import KINDS, Kind
from exumi_data.release.privacy.structure import role_of

EPISODE: dict[str, Any] = {
    "format": "exumi-episode",
    "version": "1.0",
    "id": "00000000-0000-4000-8000-000000000000",
    "task": {"name": "press", "instruction": "let Newton press it"},
    "regime": "touch",
    "operator": "touch",
    "streams": {
        "gps": {
            "kind": "acme:track",
            "extension_version": "1",
            "schema_url": "https://acme.example/track.json",
            "clock": {"source": "newton", "stamp_point": "device"},
            "arrays": ["data", "time"],
            "description": "of Newton",
        }
    },
    "calibration": {"lens of Newton": {"value": 1.0, "method": "by Newton"}},
    "annotations": {"object_id": "newton-mug", "object": "mug of Newton", "pad_type": "plain"},
    "licence": "MIT",
    "source": {"type": "recorded", "tool": "newton", "tool_version": "1", "settings": {}},
    "quality": [{"code": "newton", "message": "Newton was late", "stream": "gps"}],
}


def zarr(exumi: dict[str, Any]) -> dict[str, Any]:
    named = [{"name": "newton"}]
    attributes = {"zarr_conventions": named, "exumi": exumi, "other": "Newton"}
    return {"zarr_format": 3, "node_type": "group", "attributes": attributes}


def cleaned(document: Any, names: dict[str, Kind]) -> tuple[Any, list[str]]:
    stays: list[str] = []

    def take(kind: Kind, where: str, value: str, why: str, *, removable: bool = True) -> bool:
        assert kind in KINDS
        assert value
        assert why
        stays.extend([] if removable else [where])
        return removable

    removal = Removal(frozenset(KINDS), names=names)
    return without_private_fields(document, "zarr.json", take, removal), stays


def test_what_gives_a_document_its_form_stays() -> None:
    document = zarr(copy.deepcopy(EPISODE))
    made, stays = cleaned(document, {"newton": "operator", "MIT": "user", "gps": "user"})
    parse_episode(json.dumps(made).encode(), "zarr.json")
    exumi = made["attributes"]["exumi"]
    assert "operator" not in exumi
    assert exumi["regime"] == "touch"
    assert exumi["task"] == {"name": "press", "instruction": "let removed press it"}
    assert exumi["streams"]["gps"]["clock"] == EPISODE["streams"]["gps"]["clock"]
    assert exumi["streams"]["gps"]["description"] == "of removed"
    assert exumi["annotations"]["object"] == "mug of removed"
    assert exumi["calibration"]["lens of Newton"] == {
        "value": 1.0,
        "method": "by removed",
    }
    assert (exumi["licence"], exumi["source"]["tool"]) == ("MIT", "newton")
    assert exumi["quality"] == [{"code": "newton", "message": "removed was late", "stream": "gps"}]
    assert made["attributes"]["zarr_conventions"] == [{"name": "newton"}]
    assert made["attributes"]["other"] == "removed"
    # What people chose, and things are found by, is named and refused.
    below = "zarr.json#/attributes/exumi"
    assert stays == [
        f"{below}/streams/gps",
        f"{below}/calibration/lens of Newton",
        f"{below}/annotations/object_id",
    ]


@pytest.mark.parametrize("name", ["touch", "demonstration", "plain", "array", "video/mp4"])
def test_a_word_of_the_standard_is_nobodys_name_elsewhere(name: str) -> None:
    document = zarr({**copy.deepcopy(EPISODE), "operator": name, "site": f"a {name} b"})
    made, _ = cleaned(document, {})
    assert "operator" not in made["attributes"]["exumi"]
    assert made["attributes"]["exumi"]["task"] == EPISODE["task"]


def test_documents_of_arrays_are_left_alone() -> None:
    codecs = [{"name": "zstd", "configuration": {"level": 3}}]
    array = {"zarr_format": 3, "node_type": "array", "data_type": "uint8", "codecs": codecs,
             "dimension_names": ["time"], "attributes": {"note": "by zstd"}}  # fmt: skip
    made, _ = cleaned(array, {"zstd": "operator", "time": "user", "array": "user"})
    assert made == {**array, "attributes": {"note": "by removed"}}


def test_names_stay_names_and_keys_stay_apart() -> None:
    long = "x" * 240 + " of Ada, and Ada"
    exumi = {**copy.deepcopy(EPISODE), "task": {"name": long}}
    exumi["acme:notes"] = {"of Ada": 1, "of Eva": 2, "of removed": 3}
    made, _ = cleaned(zarr(exumi), {"Ada": "operator", "Eva": "operator"})
    parse_episode(json.dumps(made).encode(), "zarr.json")
    assert made["attributes"]["exumi"]["acme:notes"] == {
        "of removed-2": 1,
        "of removed-3": 2,
        "of removed": 3,
    }
    assert "Ada" not in made["attributes"]["exumi"]["task"]["name"]


def test_documents_of_a_dataset() -> None:
    split = {"format": "exumi-split", "version": "1.0", "name": "train", "level": "object",
             "method": "by train", "lists": {"train": []}}  # fmt: skip
    made, stays = cleaned(split, {"train": "operator", "object": "user"})
    parse_split(json.dumps(made).encode(), "splits/train.json")
    assert made == {**split, "method": "by removed"}
    assert stays == ["zarr.json#/lists/train"]
    document = {"format": "exumi-dataset", "version": "1.0", "name": "of train", "licence": "MIT",
                "splits": ["train"], "release": {"version": "1.0.0"}}  # fmt: skip
    made, _ = cleaned(document, {"train": "operator", "MIT": "user"})
    parse_dataset(json.dumps(made).encode(), "dataset.json")
    assert made == {**document, "name": "of removed"}


def test_roles() -> None:
    document = zarr(EPISODE)
    below = "/attributes/exumi"
    assert role_of(document, f"{below}/streams/gps/kind") == "fixed"
    assert role_of(document, f"{below}/task/name") == "name"
    assert role_of(document, f"{below}/source/settings/unit") == "text"
    assert role_of(document, f"{below}/source/settings/x", is_key=True) == "text"
    assert role_of(document, f"{below}/source", is_key=True) == "fixed"
