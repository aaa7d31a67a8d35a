"""SARIF 2.1.0: what its schema and the code scanners ask for."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import pytest

from exumi_validators import Problem, Report, read_config, validate
from exumi_validators.findings import problem
from exumi_validators.report import Coverage, Unchecked
from tests.exumi_data.builders import edit_metadata


def run_of(report: Report) -> dict[str, Any]:
    """The one run, having checked what the schema asks of the parts that we write."""
    document = json.loads(report.to_sarif())
    assert set(document) == {"$schema", "version", "runs"}
    assert document["version"] == "2.1.0"
    (run,) = document["runs"]
    driver = run["tool"]["driver"]
    assert driver["name"] == "exumi validate"
    ids = [rule["id"] for rule in driver["rules"]]
    assert len(set(ids)) == len(ids)
    for rule in driver["rules"]:
        assert urlparse(rule["helpUri"]).scheme == "https"
        assert rule["help"]["text"]
        assert rule["defaultConfiguration"]["level"] in ("error", "warning", "note")
    for result in run["results"]:
        assert ids[result["ruleIndex"]] == result["ruleId"]
        assert result["level"] in ("error", "warning", "note")
        assert result["message"]["text"]
        (location,) = result["locations"]
        artifact = location["physicalLocation"]["artifactLocation"]
        assert artifact["uriBaseId"] in run["originalUriBaseIds"]
        assert artifact["uri"]
        assert not urlparse(artifact["uri"]).scheme
        assert location["logicalLocations"][0]["fullyQualifiedName"]
        assert all(item["kind"] == "external" for item in result.get("suppressions", []))
    for base in run["originalUriBaseIds"].values():
        assert base["uri"].startswith("file:///")
        assert base["uri"].endswith("/")
    found: dict[str, Any] = run
    return found


@pytest.fixture
def spoiled(episode: Path) -> Path:
    edit_metadata(
        episode, lambda exumi: exumi.update({"co lour": "red", "licence": "free for all"})
    )
    return episode


def test_findings_have_places(spoiled: Path) -> None:
    results = {r["ruleId"]: r for r in run_of(validate(spoiled))["results"]}
    assert results["META-003"]["level"] == "error"
    assert results["LIC-002"]["level"] == "warning"
    (location,) = results["META-003"]["locations"]
    assert location["logicalLocations"] == [
        {"fullyQualifiedName": "zarr.json#/attributes/exumi/co lour", "kind": "property"}
    ]
    assert (Path(spoiled) / location["physicalLocation"]["artifactLocation"]["uri"]).is_file()


def test_suppressions_and_overrides(spoiled: Path, tmp_path: Path) -> None:
    file = tmp_path / "exumi.toml"
    file.write_text(
        '[validate.rules]\n"LIC-002" = "info"\n"ID-002" = "off"\n'
        '[[validate.suppress]]\nrule = "META-003"\nreason = "known"\n'
    )
    run = run_of(validate(spoiled, config=read_config(file)))
    results = {r["ruleId"]: r for r in run["results"]}
    assert results["META-003"]["suppressions"] == [{"kind": "external", "justification": "known"}]
    assert results["LIC-002"]["level"] == "note"
    overrides = {
        item["descriptor"]["id"]: item["configuration"]
        for item in run["invocations"][0]["ruleConfigurationOverrides"]
    }
    assert overrides == {
        "ID-002": {"enabled": False},
        "LIC-002": {"enabled": True, "level": "note"},
    }


def made(*problems: Problem, path: str, kind: str, **coverage: Any) -> Report:
    return Report(
        path=path,
        kind=kind,
        standard="1.0",
        library="0",
        problems=problems,
        coverage=Coverage(**coverage),
    )


def test_members_of_a_zip_are_no_files() -> None:
    error = problem("TIME-001", "streams/a b/time", index=2)
    packed = replace(error, location=replace(error.location, episode="episodes/a1/x.zarr.zip"))
    for report, uri in (
        (made(error, path="grasps/x 1.zarr.zip", kind="episode"), "x%201.zarr.zip"),
        (made(packed, path="grasps", kind="dataset"), "episodes/a1/x.zarr.zip"),
        (made(error, path="x.zarr", kind="episode"), "streams/a%20b/time"),
    ):
        (result,) = run_of(report)["results"]
        assert result["locations"][0]["physicalLocation"]["artifactLocation"]["uri"] == uri
        assert result["locations"][0]["logicalLocations"] == [
            {"fullyQualifiedName": "streams/a b/time[2]", "kind": "value"}
        ]


def test_a_run_that_was_cut_short_says_so() -> None:
    report = made(path="x", kind="dataset", unchecked=(Unchecked("e", "IMG-006", "MemoryError"),))
    (invocation,) = run_of(report)["invocations"]
    assert invocation["executionSuccessful"] is False
    (note,) = invocation["toolExecutionNotifications"]
    assert note["message"]["text"] == "e: IMG-006: MemoryError"
    assert run_of(made(path="x", kind="dataset"))["invocations"] == [{"executionSuccessful": True}]
