"""Invalid cases: the documents of an episode."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import EXUMI, Case, Finding, as_zip, case, packed
from corpus.draft import Draft

__all__ = ["document_cases"]

ROOT = "zarr.json"
DERIVED = "derived/zarr.json"


def _text(draft: Draft, old: bytes, new: bytes) -> dict[str, bytes]:
    """Return the files with one text of the root's document replaced."""
    files = draft.files()
    assert files[ROOT].count(old) == 1  # noqa: S101  # a case that changes nothing shows nothing
    files[ROOT] = files[ROOT].replace(old, new)
    return files


def _with(draft: Draft, **metadata: Any) -> Draft:
    draft.metadata.update(metadata)
    return draft


def _without(draft: Draft, key: str) -> Draft:
    del draft.metadata[key]
    return draft


def _at(*keys: str) -> str:
    return "/".join((EXUMI, *keys))


def _document_cases() -> Iterator[Case]:
    broken = _text(bases.poses(), b'"regime":"play"', b'"regime":"play')
    yield case("DOC-001__cut_string", "No JSON.", broken, Finding("DOC-001", ROOT))
    nan = _text(bases.poses(success=True), b'"success":true', b'"success":NaN')
    yield case("DOC-001__nan", "NaN is no JSON.", nan, Finding("DOC-001", ROOT))
    deep = _text(
        bases.poses(), b'"regime":', b'"acme:x":' + b"[" * 200 + b"]" * 200 + b',"regime":'
    )
    yield case("DOC-001__deep", "A list in a list, 200 times.", deep, Finding("DOC-001", ROOT))
    twice = _text(bases.poses(), b'"regime":"play"', b'"regime":"touch","regime":"play"')
    at = Finding("DOC-002", ROOT, _at("regime"))
    yield case("DOC-002__regime_twice", "A key that stands twice.", twice, at)
    other = bases.poses(format="exumi-recording")
    at = Finding("DOC-003", ROOT, _at("format"))
    yield case("DOC-003__another_format", "Another format.", other, at)
    at = Finding("DOC-004", ROOT, _at("version"))
    three = bases.poses(version="1.0.3")
    yield case("DOC-004__three_numbers", "A version of three numbers.", three, at)
    at = Finding("DOC-005", ROOT, _at("version"))
    yield case("DOC-005__newer_major", "Version 2.0.", bases.poses(version="2.0"), at)
    at = Finding("DOC-004", ROOT, _at("version"))
    yield case("DOC-004__leading_zero", "Version 01.0.", bases.poses(version="01.0"), at)
    newer = bases.derived()
    newer.nodes["derived"]["attributes"]["exumi"]["version"] = "2.0"
    at = Finding("DOC-005", DERIVED, _at("version"))
    yield case("DOC-005__newer_derived", "Derived arrays of version 2.0.", newer, at)
    archive = as_zip(bases.poses(version="3.1").files())
    at = Finding("DOC-005", ROOT, _at("version"))
    yield packed("DOC-005__newer_packed", "A packed episode of version 3.1.", archive, at)


def _root_cases() -> Iterator[Case]:
    files = bases.poses().files()
    del files[ROOT]
    yield case("ROOT-001__no_root", "Never finished.", files, Finding("ROOT-001", ROOT))
    draft = bases.poses()
    del draft.root["attributes"]["exumi"]
    at = Finding("ROOT-001", ROOT, EXUMI)
    yield case("ROOT-001__no_exumi", "A group of something else.", draft, at)
    draft = bases.poses()
    draft.root["attributes"]["zarr_conventions"] = []
    at = Finding("ROOT-002", ROOT, "/attributes/zarr_conventions")
    yield case("ROOT-002__not_declared", "The convention is not declared.", draft, at)
    draft = bases.poses(requires=["holograms"])
    at = Finding("ROOT-003", ROOT, _at("requires", "0"))
    yield case("ROOT-003__unknown_feature", "A feature that nobody knows.", draft, at)
    archive = as_zip(bases.poses(version="1.4", requires=["holograms"]).files())
    yield packed("ROOT-003__packed", "A packed episode with such a feature.", archive, at)
    draft = bases.derived()
    draft.nodes["derived"]["attributes"]["exumi"]["requires"] = ["holograms"]
    at = Finding("ROOT-003", DERIVED, _at("requires", "0"))
    yield case("ROOT-003__of_derived", "Derived arrays with such a feature.", draft, at)


def _field_cases() -> Iterator[Case]:
    at = Finding("META-001", ROOT, _at("licence"))
    yield case("META-001__no_licence", "No licence.", _without(bases.poses(), "licence"), at)
    draft = bases.derived()
    del draft.nodes["derived"]["attributes"]["exumi"]["items"]["tactile/salient"]["algorithm"]
    found = Finding("META-001", DERIVED, _at("items", "tactile~1salient", "algorithm"))
    yield case("META-001__no_algorithm", "A derived array without its algorithm.", draft, found)
    at = Finding("META-002", ROOT, _at("regime"))
    yield case("META-002__regime", "An unknown regime.", bases.poses(regime="demo"), at)
    draft = bases.encoded()
    draft.metadata["streams"]["rgb"]["images"]["height"] = 16.5
    at = Finding("META-002", ROOT, _at("streams", "rgb", "images", "height"))
    yield case("META-002__half_a_pixel", "A height of 16.5.", draft, at)
    at = Finding("META-003", ROOT, _at("liscence"))
    yield case("META-003__typo", "A misspelt key.", _with(bases.poses(), liscence="MIT"), at)
    draft = bases.poses(regime="demo")
    draft.metadata["streams"]["pose"]["clock"]["offset"] = 3
    two = (
        Finding("META-002", ROOT, _at("regime")),
        Finding("META-003", ROOT, _at("streams", "pose", "clock", "offset")),
    )
    yield case("META-003__beside_another", "An unknown key, and another mistake.", draft, *two)
    draft = bases.derived()
    draft.nodes["derived"]["attributes"]["exumi"]["acme:farm"] = {"node": 3}
    at = Finding("EXT-002", DERIVED, _at("acme:farm"))
    yield case("EXT-002__of_derived", "A vendor's object beside derived arrays.", draft, at)
    draft = bases.poses(version="1.9", weather="rain")
    at = Finding("META-004", ROOT, _at("weather"))
    yield case("META-004__newer_key", "A key of a newer minor version.", draft, at)
    draft = bases.poses(start="2026-02-30T10:00:00Z")
    at = Finding("META-005", ROOT, _at("start"))
    yield case("META-005__february_30", "A day that never was.", draft, at)


def _identity_cases() -> Iterator[Case]:
    draft = bases.poses(id="018F0000-0000-7000-8000-0000000000A1")
    at = Finding("ID-001", ROOT, _at("id"))
    yield case("ID-001__upper_case", "An id in upper case.", draft, at)
    source = {"type": "recorded", "tool": "corpus", "tool_version": "1"}
    draft = bases.poses(id="018f0000-0000-4000-8000-0000000000a1", source=source)
    at = Finding("ID-002", ROOT, _at("id"))
    yield case("ID-002__random_uuid", "A recorded episode with a random id.", draft, at)
    at = Finding("LIC-001", ROOT, _at("licence"))
    yield case("LIC-001__unknown", "Licence unknown.", bases.poses(licence="unknown"), at)
    at = Finding("LIC-002", ROOT, _at("licence"))
    prose = bases.poses(licence="Creative Commons, attribution")
    yield case("LIC-002__prose", "A licence in prose.", prose, at)
    source = {"type": "converted", "tool": "corpus", "tool_version": "1", "converter": "octopi/1"}
    draft = bases.poses(id="5c5a3a52-0f55-5b6a-9a6e-1f9f2b1c0d01", source=source)
    at = Finding("SRC-001", ROOT, _at("source"))
    yield case("SRC-001__no_inputs", "Converted from nothing.", draft, at)
    draft = bases.poses(quality=[{"code": "dark", "message": "too dark", "stream": "rgb"}])
    at = Finding("REF-001", ROOT, _at("quality", "0", "stream"))
    yield case("REF-001__quality_note", "A note about a stream that is not there.", draft, at)


def _description_cases() -> Iterator[Case]:
    draft = bases.taxels()
    draft.metadata["streams"]["taxels"]["unit"] = "furlong"
    at = Finding("UNIT-001", ROOT, _at("streams", "taxels", "unit"))
    yield case("UNIT-001__furlong", "A unit that is not registered.", draft, at)
    item = {"rectification": {"value": None, "array": "calibration/map", "residual": 0.2}}
    at = Finding("CAL-001", ROOT, _at("calibration", "rectification", "array"))
    yield case("CAL-001__no_array", "A map that is not there.", bases.poses(calibration=item), at)
    item = {"rectification": {"value": None, "array": "calibration/Map-1", "residual": 0.2}}
    named = bases.poses(calibration=item)
    yield case("CAL-001__name", "A map whose name has a capital and a hyphen.", named, at)
    label = {"property": "hardness", "value": 7.0, "raters": 3, "provenance": "human"}
    draft = bases.poses(annotations={"part_id": "egg", "labels": [label]})
    at = Finding("ANN-001", ROOT, _at("annotations", "labels", "0"))
    yield case("ANN-001__no_scale", "Seven, of how many?", draft, at)
    draft = bases.poses(annotations={"part_id": "egg", "labels": [{**label, "scale": [0.0, 5.0]}]})
    at = Finding("ANN-002", ROOT, _at("annotations", "labels", "0"))
    yield case("ANN-002__seven_of_five", "Seven, of five.", draft, at)
    segment = {"name": "contact", "start_ns": 10, "end_ns": 5}
    draft = bases.poses(annotations={"segments": [segment]})
    at = Finding("ANN-003", ROOT, _at("annotations", "segments", "0"))
    yield case("ANN-003__backwards", "A segment that ends before it starts.", draft, at)


def _derived_cases() -> Iterator[Case]:
    draft = bases.derived()
    draft.drop("derived")
    complete = bases.derived()
    draft.nodes["derived/tactile"] = complete.nodes["derived/tactile"]
    at = Finding("DRV-001", DERIVED)
    yield case("DRV-001__no_description", "A group without its document.", draft, at)
    draft = bases.derived()
    items = draft.nodes["derived"]["attributes"]["exumi"]["items"]
    items["ghost/salient"] = items.pop("tactile/salient")
    draft.drop("derived/tactile/salient")
    draft.group("derived/ghost")
    draft.put("derived/ghost/salient", np.array([1, 2], dtype=np.int64), names=("index",))
    at = Finding("DRV-003", DERIVED, _at("items", "ghost~1salient"))
    yield case("DRV-003__ghost", "Salient frames of no stream.", draft, at)
    yield from _derived_name_cases()
    draft = bases.derived()
    items = draft.nodes["derived"]["attributes"]["exumi"]["items"]
    del items["tactile/activity"]["parameters"]["threshold"]
    at = Finding("DRV-006", DERIVED, _at("items", "tactile~1activity", "parameters"))
    yield case("DRV-006__no_threshold", "Activity above what?", draft, at)


def _derived_name_cases() -> Iterator[Case]:
    for name, key, about in (
        ("typo", "activty", "A misspelt name."),
        ("one_line", "acme_slip", "A vendor's name with one line for two."),
    ):
        draft = bases.derived()
        draft.derive(f"tactile/{key}", np.zeros(4), names=("time",), algorithm="x/1")
        at = Finding("DRV-007", DERIVED, _at("items", f"tactile~1{key}"))
        yield case(f"DRV-007__{name}", about, draft, at)
    draft = bases.poses()
    parameters = {"threshold": 5, "size": 224, "active_above": 0.001}
    values = np.zeros(4, dtype=np.float32)
    given = {"algorithm": "exumi-activity/1", "parameters": parameters}
    draft.derive("pose/activity", values, names=("time",), **given)
    at = Finding("DRV-007", DERIVED, _at("items", "pose~1activity"))
    yield case("DRV-007__of_a_pose", "The activity of a pose.", draft, at)


def document_cases() -> Iterator[Case]:
    """Yield the cases of the level of documents, streams apart."""
    yield from _document_cases()
    yield from _root_cases()
    yield from _field_cases()
    yield from _identity_cases()
    yield from _description_cases()
    yield from _derived_cases()
