"""A report as SARIF 2.1.0 (OASIS), which code scanners show.

A finding is a `result` of its rule, at a file (relative to what was validated, below the base
``DATA``) and, inside it, at a logical location: the JSON pointer, or the index in an array.
Suppressed findings carry their reason in `suppressions`. What could not be checked at all is a
notification of level error.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from exumi_validators.plugins import known_rules

if TYPE_CHECKING:
    from exumi_validators.report import Location, Problem, Reclassified, Report

__all__ = ["SPEC_URL", "render_sarif"]

SPEC_URL = "https://exumi-data.org/spec"
"""Where the text of the standard lies."""

_SCHEMA = (
    "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
)
_LEVELS = {"error": "error", "warning": "warning", "info": "note"}


def render_sarif(report: "Report") -> str:
    """Write a report as SARIF 2.1.0.

    Parameters
    ----------
    report : Report

    Returns
    -------
    str
        One JSON document, ASCII.
    """
    first = {problem.code: problem for problem in reversed(report.problems)}
    changed = report.configuration.rules if report.configuration else ()
    codes = sorted({*first, *(rule.code for rule in changed)})
    index = {code: number for number, code in enumerate(codes)}
    run = {
        "tool": {
            "driver": {
                "name": "exumi validate",
                "version": report.library,
                "informationUri": f"{SPEC_URL}/{report.standard}/rules.md",
                "rules": [_rule(code, first.get(code)) for code in codes],
            }
        },
        "invocations": [_invocation(report)],
        "originalUriBaseIds": {"DATA": {"uri": f"{_base(report).as_uri()}/"}},
        "columnKind": "unicodeCodePoints",
        "results": [
            {"ruleIndex": index[problem.code], **_result(problem, report)}
            for problem in report.problems
        ],
        "properties": {
            "path": report.path,
            "kind": report.kind,
            "standard": report.standard,
            "valid": report.valid,
            "conformant": report.conformant,
            "coverage": report.to_dict()["coverage"],
            "notListed": report.not_listed,
        },
    }
    document = {"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}
    return json.dumps(document, indent=1, ensure_ascii=True) + "\n"


def _is_packed(report: "Report") -> bool:
    return report.kind == "episode" and report.path.endswith(".zip")


def _base(report: "Report") -> Path:
    path = Path(report.path).absolute()
    return path.parent if _is_packed(report) else path


def _rule(code: str, example: "Problem | None") -> dict[str, Any]:
    found: dict[str, Any] = {"id": code}
    rule = known_rules().get(code)
    if rule is not None:
        found["shortDescription"] = {"text": rule.title}
        found["defaultConfiguration"] = {"level": _LEVELS[rule.severity]}
        found["help"] = {"text": rule.suggestion}
        found["properties"] = {"level": rule.level, "since": rule.since}
        found["helpUri"] = _address(rule.anchor, rule.since)
    elif example is not None:  # of a package that was installed when the report was made
        found["help"] = {"text": example.suggestion}
        found["helpUri"] = _address(example.rule)
    return found


def _address(anchor: str, version: str | None = None) -> str:
    if "://" in anchor:
        return anchor
    return "/".join(part for part in (SPEC_URL, version, anchor) if part)


def _result(problem: "Problem", report: "Report") -> dict[str, Any]:
    found: dict[str, Any] = {
        "ruleId": problem.code,
        "level": _LEVELS[problem.severity],
        "kind": "fail",
        "message": {"text": f"{problem.message}. {problem.suggestion}"},
        "locations": [_location(problem.location, report)],
    }
    if problem.suppressed is not None:
        found["suppressions"] = [{"kind": "external", "justification": problem.suppressed}]
    return found


def _location(place: "Location", report: "Report") -> dict[str, Any]:
    # The members of a packed episode are no files of their own.
    file = place.file
    if _is_packed(report):
        file = Path(report.path).name
    elif place.episode and place.episode.endswith(".zip"):
        file = place.episode
    logical = {"fullyQualifiedName": place.path}
    if place.pointer is not None:
        logical = {"fullyQualifiedName": f"{place.path}#{place.pointer}", "kind": "property"}
    elif place.index is not None:
        logical = {"fullyQualifiedName": f"{place.path}[{place.index}]", "kind": "value"}
    return {
        "physicalLocation": {"artifactLocation": {"uri": quote(file), "uriBaseId": "DATA"}},
        "logicalLocations": [logical],
    }


def _invocation(report: "Report") -> dict[str, Any]:
    found: dict[str, Any] = {"executionSuccessful": not report.coverage.unchecked}
    if report.coverage.unchecked:
        found["toolExecutionNotifications"] = [
            {"level": "error", "message": {"text": f"{item.path}: {item.what}: {item.reason}"}}
            for item in report.coverage.unchecked
        ]
    if report.configuration is not None and report.configuration.rules:
        found["ruleConfigurationOverrides"] = [
            {"descriptor": {"id": rule.code}, "configuration": _configuration(rule)}
            for rule in report.configuration.rules
        ]
    return found


def _configuration(rule: "Reclassified") -> dict[str, Any]:
    found: dict[str, Any] = {"enabled": rule.severity != "off"}
    if rule.severity != "off":
        found["level"] = _LEVELS[rule.severity]
    if rule.limits:
        found["parameters"] = dict(rule.limits)
    return found
