"""The schema of reports: ours follow it, and it names everything that ours have."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from exumi_validators import read_config, report, validate


@pytest.fixture(scope="module")
def schema(spec: Path) -> dict[str, Any]:
    text = (spec / "schema" / "1.0" / "report.schema.json").read_text("utf-8")
    found: dict[str, Any] = json.loads(text)
    jsonschema.Draft202012Validator.check_schema(found)
    return found


def stores(corpus: Path) -> list[Path]:
    folders = sorted((corpus / "invalid").iterdir())[::12]
    return [f / json.loads((f / "expected.json").read_text())["store"] for f in folders]


def test_our_reports_follow_it(schema: dict[str, Any], corpus: Path, tmp_path: Path) -> None:
    config = tmp_path / "exumi.toml"
    config.write_text(
        '[validate.rules]\n"TIME-001" = "info"\n"ID-002" = "off"\n'
        '[[validate.suppress]]\nrule = "META-003"\nreason = "known"\n'
    )
    judge = jsonschema.Draft202012Validator(schema)
    found = 0
    for store in stores(corpus):
        for chosen in (None, read_config(config)):
            document = json.loads(validate(store, config=chosen).to_json())
            judge.validate(document)
            assert set(document) <= set(schema["properties"])
            found += len(document["problems"])
    assert found > 10


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("Problem", report.Problem),
        ("Location", report.Location),
        ("Coverage", report.Coverage),
        ("Configuration", report.Configuration),
        ("Extension", report.Extension),
    ],
)
def test_it_names_what_ours_have(name: str, model: Any, schema: dict[str, Any]) -> None:
    assert set(schema["$defs"][name]["properties"]) == {field.name for field in fields(model)}


def test_the_version_is_ours(schema: dict[str, Any]) -> None:
    assert schema["properties"]["report_version"] == {
        "const": report.REPORT_VERSION,
        "description": "Version of this document, not of the standard.",
    }


@pytest.mark.parametrize(
    "document",
    [
        {"report_version": 2, "valid": True},
        {"report_version": 1, "valid": True, "problems": []},
        {
            "report_version": 2,
            "valid": True,
            "problems": [{"code": "time", "location": {"path": ""}}],
        },
        {"report_version": 2, "valid": True, "problems": [{"code": "TIME-001"}]},
    ],
)
def test_what_is_no_report(document: dict[str, Any], schema: dict[str, Any]) -> None:
    assert not jsonschema.Draft202012Validator(schema).is_valid(document)


def test_the_least_that_a_validator_says(schema: dict[str, Any]) -> None:
    problem = {"code": "TIME-001", "location": {"path": "streams/pose/time", "index": 2}}
    document = {"report_version": 2, "valid": False, "problems": [problem]}
    assert jsonschema.Draft202012Validator(schema).is_valid(document)
