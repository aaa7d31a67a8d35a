"""Every case of the corpus gives exactly what it says."""

import json
from pathlib import Path
from typing import Any

import pytest

from exumi_data.standard import rules
from exumi_validators import Problem, validate

CORPUS = Path(__file__).resolve().parents[2] / "spec" / "conformance" / "1.0"
CASES = sorted(path.parent for path in CORPUS.glob("*/*/expected.json"))


def found(problem: Problem) -> dict[str, Any]:
    place = problem.location
    return {
        "code": problem.code,
        "episode": place.episode,
        "path": place.path,
        "pointer": place.pointer,
        "index": place.index,
    }


def in_order(findings: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(findings, key=lambda finding: json.dumps(finding, sort_keys=True))


def test_there_are_cases() -> None:
    assert len(CASES) > len(rules())


@pytest.mark.parametrize("case", CASES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_exactly_what_is_expected(case: Path) -> None:
    expected = json.loads((case / "expected.json").read_text("utf-8"))
    report = validate(case / expected["store"])
    assert in_order([found(problem) for problem in report.problems]) == in_order(
        expected["findings"]
    )
    assert report.coverage.unchecked == ()
    errors = {f["code"] for f in expected["findings"] if rules()[f["code"]].severity == "error"}
    assert report.exit_code == (1 if errors else 0)
    for problem in report.problems:
        rule = rules()[problem.code]
        assert (problem.severity, problem.level) == (rule.severity, rule.level)
        assert problem.message
        assert "{" not in problem.message.replace("{}", "").replace('{"', "").replace("{'", "")
        assert "None" not in problem.message
        assert problem.rule == f"1.0/{rule.anchor}"


@pytest.mark.parametrize("case", CASES, ids=lambda path: path.name)
def test_documents_alone_are_judged_without_the_rest(case: Path) -> None:
    expected = json.loads((case / "expected.json").read_text("utf-8"))
    report = validate(case / expected["store"], levels=["document"])
    wanted = [f for f in expected["findings"] if rules()[f["code"]].level == "document"]
    assert in_order([found(problem) for problem in report.problems]) == in_order(wanted)
    assert report.coverage.frames == 0
