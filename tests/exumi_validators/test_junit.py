"""JUnit XML: the structure that CI servers read, whatever is in the data."""

from dataclasses import replace
from xml.etree import ElementTree as ET

import pytest

from exumi_data.standard import rules
from exumi_validators import Coverage, Location, Problem, Report, Skipped, Unchecked
from exumi_validators.findings import problem

ERROR = problem("TIME-001", "streams/pose/time", index=2, expected=5, found=5)
WARNING = problem("LIC-002", "zarr.json", pointer=("attributes", "exumi", "licence"), found="x")


def placed(found: Problem, episode: str) -> Problem:
    return replace(found, location=replace(found.location, episode=episode))


def report(*problems: Problem, path: str = "data", **coverage: object) -> Report:
    done = Coverage(levels=("document", "hierarchy"), rules=30, episodes=2)
    return Report(
        path=path,
        kind="dataset",
        standard="1.0",
        library="0",
        problems=problems,
        coverage=replace(done, **coverage),  # type: ignore[arg-type]  # its own fields
    )


def suites(made: Report) -> dict[str, ET.Element]:
    """The suites by name, having checked what Jenkins' schema asks for."""
    root = ET.fromstring(made.to_junit())  # noqa: S314  # our own
    assert root.tag == "testsuites"
    found = root.findall("testsuite")
    assert len(found) == len(root)
    for suite in found:
        order = [child.tag for child in suite]
        assert order == sorted(order, key=["properties", "testcase"].index)
        tests = suite.findall("testcase")
        assert int(suite.attrib["tests"]) == len(tests)
        names = [test.attrib["name"] for test in tests]
        assert len(set(names)) == len(names)
        for test in tests:
            assert test.attrib["classname"] == suite.attrib["name"]
            kinds = [child.tag for child in test]
            assert set(kinds) <= {"skipped", "error", "failure", "system-out"}
            assert sum(kind != "system-out" for kind in kinds) <= 1
        for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            assert int(suite.attrib[name]) == len(suite.findall(f"testcase/{tag}"))
    for name in ("tests", "failures", "errors"):
        assert int(root.attrib[name]) == sum(int(suite.attrib[name]) for suite in found)
    return {suite.attrib["name"]: suite for suite in found}


def test_a_run_without_findings_is_not_empty() -> None:
    (suite,) = suites(report()).values()
    names = [test.attrib["name"] for test in suite.findall("testcase")]
    assert names == ["exumi validate: level document", "exumi validate: level hierarchy"]
    assert suite.attrib["failures"] == "0"
    properties = {p.attrib["name"]: p.attrib["value"] for p in suite.iter("property")}
    assert properties["valid"] == "true"
    assert properties["episodes"] == "2"


def test_errors_fail_and_warnings_do_not() -> None:
    again = replace(ERROR, location=replace(ERROR.location, index=9))
    found = [placed(p, "episodes/a1/x.zarr") for p in (ERROR, again, WARNING)]
    made = suites(report(*found))
    suite = made["data/episodes/a1/x.zarr"]
    assert (suite.attrib["tests"], suite.attrib["failures"]) == ("2", "1")
    (failure,) = suite.iter("failure")
    assert failure.attrib["message"] == f"{ERROR.message} (and 1 more)"
    assert failure.text is not None
    assert "streams/pose/time [9]" in failure.text
    names = [test.attrib["name"] for test in suite.iter("testcase")]
    assert names == [
        f"LIC-002 {rules()['LIC-002'].title} (warning)",
        f"TIME-001 {rules()['TIME-001'].title}",
    ]
    (output,) = suite.iter("system-out")
    assert output.text is not None
    assert output.text.startswith("warning LIC-002")


def test_suppressed_unchecked_and_skipped() -> None:
    known = replace(ERROR, suppressed="known")
    unchecked = (Unchecked(".", "IMG-006", "MemoryError"),)
    skipped = (
        Skipped("TIME-009", "too few samples", "streams/a", count=3),
        Skipped("TIME-009", "no events", "streams/b"),
    )
    (suite,) = suites(report(known, unchecked=unchecked, skipped=skipped)).values()
    assert (suite.attrib["failures"], suite.attrib["errors"]) == ("0", "1")
    messages = [element.attrib["message"] for element in suite.iter("skipped")]
    assert "known" in messages
    assert "nothing to judge by @ streams/a (3 times)" in messages
    names = [test.attrib["name"] for test in suite.iter("testcase")]
    assert f"TIME-009 {rules()['TIME-009'].title} (not judged: no events)" in names


@pytest.mark.parametrize("text", ["\x00\x1b[2J", "a\ud800b", "]]>", "<x>&\"'", "\ufffe", "\n"])
def test_hostile_text_is_text(text: str) -> None:
    place = Location(f"streams/{text}", episode=f"episodes/{text}.zarr", pointer=f"/{text}")
    hostile = replace(ERROR, message=f"it says {text}", location=place)
    made = suites(report(hostile, path=f"data{text}", unchecked=(Unchecked(text, text, text),)))
    assert len(made) == 2
