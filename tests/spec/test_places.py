"""The places of findings: every rule names them, and the corpus keeps to them."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from exumi_data.standard import Place, places, rules

INVALID = Path(__file__).resolve().parents[2] / "spec" / "conformance" / "1.0" / "invalid"
_DOCUMENT = r"(derived/)?zarr\.json|dataset\.json|manifest\.json|splits/[a-z0-9_-]+\.json"
_ARRAY = r"(episodes/../[^/]+/)?(streams|derived|calibration)(/[a-z][a-z0-9_]*)*"
PATHS = {
    "document": _DOCUMENT,
    "field": _DOCUMENT,
    "gap": r"zarr\.json",
    "node": rf"zarr\.json|{_ARRAY}/zarr\.json",
    "member": rf"zarr\.json|{_ARRAY}/zarr\.json",
    "array": _ARRAY,
    "row": _ARRAY,
    "frame": r"streams/[a-z0-9_]+/data",
    "video_file": r"streams/[a-z0-9_]+/data",
    "shard": rf"{_ARRAY}/c/\d+(/0)*",
    "chunk": rf"{_ARRAY}/c/\d+(/0)*",
    "file": r".+",
    "zip": r"\.",
    "zip_member": r"\.",
    "catalog": r"catalog\.parquet",
    "catalog_row": r"catalog\.parquet",
}


def fits(finding: dict[str, Any], place: Place) -> bool:
    """Whether a finding has the form of a place."""
    return (
        (finding["pointer"] is not None) == place.pointer
        and (finding["index"] is not None) == (place.index is not None)
        and re.fullmatch(PATHS[place.name], finding["path"]) is not None
    )


def findings() -> list[dict[str, Any]]:
    cases = sorted(INVALID.glob("*/expected.json"))
    return [finding for case in cases for finding in json.loads(case.read_bytes())["findings"]]


@pytest.mark.parametrize("rule", rules().values(), ids=lambda rule: rule.id)
def test_every_rule_names_its_places(rule: Any) -> None:
    assert rule.places
    assert set(rule.places) <= set(places())
    assert len(set(rule.places)) == len(rule.places)


def test_findings_of_the_corpus_are_at_their_places() -> None:
    table = rules()
    misplaced = [
        finding
        for finding in findings()
        if not any(fits(finding, places()[name]) for name in table[finding["code"]].places)
    ]
    assert misplaced == []


def test_no_place_is_named_in_vain() -> None:
    """Each is that of a rule, and this test knows what its paths look like."""
    named = {name for rule in rules().values() for name in rule.places}
    assert named == set(places()) == set(PATHS)


@pytest.mark.parametrize(
    ("finding", "name"),
    [
        ({"path": "zarr.json", "pointer": None, "index": None}, "field"),
        ({"path": "zarr.json", "pointer": "/a", "index": 0}, "field"),
        ({"path": "streams/pose/time", "pointer": None, "index": None}, "row"),
        ({"path": "streams/pose/zarr.json", "pointer": None, "index": 3}, "row"),
        ({"path": "streams/pose/time/c/0", "pointer": None, "index": None}, "array"),
    ],
)
def test_a_misplaced_finding_is_seen(finding: dict[str, Any], name: str) -> None:
    assert not fits(finding, places()[name])


def test_the_table_for_programs_has_them(spec: Path) -> None:
    table = json.loads((spec / "1.0" / "rules.json").read_text("utf-8"))
    assert set(table["places"]) == set(places())
    assert table["rules"]["GAP-001"]["places"] == ["gap"]
    assert table["places"]["gap"]["pointer"] is True
    assert table["places"]["gap"]["index"] == "gap"
