"""A report as JUnit XML, which CI servers show as tests.

One test suite holds the run itself: a test for each level that was judged, for what was wrong with
the dataset's own files, for what could not be checked (an error) and for what had nothing to be
judged by (skipped). Each episode in which something was found is a test suite of its own, with a
test for each rule that is broken, named by what the rule asks for. Errors are failures; JUnit knows
no warnings, so a rule of lower severity is a test that passes, with its findings as output;
suppressed findings are skipped tests. Episodes without findings have no suite: their number is in
the properties.
"""

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from exumi_validators.findings import show
from exumi_validators.plugins import known_rules

if TYPE_CHECKING:
    from exumi_validators.report import Problem, Report

__all__ = ["render_junit"]

_PROGRAM = "exumi validate"
# What XML 1.0 cannot hold, not even escaped.
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def render_junit(report: "Report") -> str:
    """Write a report as JUnit XML.

    Parameters
    ----------
    report : Report

    Returns
    -------
    str
        One document, of the elements that Jenkins' and GitLab's readers know.
    """
    root = ET.Element("testsuites", name=_PROGRAM)
    of_suite: dict[str, list[Problem]] = {}
    for problem in report.problems:
        of_suite.setdefault(problem.location.episode or "", []).append(problem)
    root.append(_run_suite(report, of_suite.pop("", [])))
    for episode, problems in sorted(of_suite.items()):
        suite = ET.Element("testsuite", name=_clean(f"{report.path}/{episode}"))
        suite.extend(_tests_of_rules(problems, suite.attrib["name"]))
        root.append(suite)
    for suite in root:
        _count(suite)
    for name in ("tests", "failures", "errors"):
        root.set(name, str(sum(int(suite.attrib[name]) for suite in root)))
    ET.indent(root, " ")
    # ASCII, so that it is the same document in whatever encoding it is printed.
    text = ET.tostring(root, encoding="us-ascii", xml_declaration=False).decode("ascii")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _clean(text: str) -> str:
    return _FORBIDDEN.sub(lambda found: ascii(found[0])[1:-1], text)


def _run_suite(report: "Report", problems: "list[Problem]") -> ET.Element:
    suite = ET.Element("testsuite", name=_clean(report.path))
    properties = ET.SubElement(suite, "properties")
    done = report.coverage
    facts: dict[str, object] = {
        "valid": report.valid,
        "conformant": report.conformant,
        "standard": report.standard,
        "exumi-data": report.library,
        "levels": " ".join(done.levels),
        "rules": done.rules,
        "episodes": done.episodes,
        "samples": done.samples,
        "frames": done.frames,
    }
    if report.configuration is not None:
        facts["configuration"] = report.configuration.file
    for code, count in sorted(report.not_listed.items()):
        facts[f"not listed {code}"] = count
    for name, value in facts.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        ET.SubElement(properties, "property", name=name, value=_clean(text))
    where = suite.attrib["name"]
    for level in done.levels:
        suite.append(_test(f"{_PROGRAM}: level {level}", where))
    suite.extend(_tests_of_rules(problems, where))
    for item in done.unchecked:
        test = _test(f"{item.what} @ {item.path}", where)
        ET.SubElement(test, "error", type="not checked", message=_clean(show(item.reason)))
        suite.append(test)
    for missing in done.skipped:
        test = _test(f"{_named(missing.code)} (not judged: {missing.reason})", where)
        text = f"nothing to judge by @ {missing.path} ({missing.count} times)"
        ET.SubElement(test, "skipped", message=_clean(show(text)))
        suite.append(test)
    return suite


def _named(code: str) -> str:
    """Name the test of a rule: its id, and what holds when it is kept."""
    rule = known_rules().get(code)
    return f"{code} {rule.title}" if rule else code


def _test(name: str, where: str) -> ET.Element:
    return ET.Element("testcase", name=_clean(name), classname=where)


def _tests_of_rules(problems: "Iterable[Problem]", where: str) -> list[ET.Element]:
    """Return one test for each rule that is broken, and one for each that is suppressed."""
    groups: dict[tuple[str, str, bool], list[Problem]] = {}
    for problem in problems:
        key = (problem.code, problem.severity, problem.suppressed is not None)
        groups.setdefault(key, []).append(problem)
    found = []
    for (code, severity, is_suppressed), members in sorted(groups.items()):
        first = members[0]
        more = f" (and {len(members) - 1} more)" if len(members) > 1 else ""
        text = "\n".join(_clean(_line(problem)) for problem in members)
        if is_suppressed:
            test = _test(f"{_named(code)} (suppressed)", where)
            ET.SubElement(test, "skipped", message=_clean(str(first.suppressed)))
            ET.SubElement(test, "system-out").text = text
        elif severity == "error":
            test = _test(_named(code), where)
            failure = ET.SubElement(test, "failure", type=code)
            failure.set("message", _clean(first.message + more))
            failure.text = f"{text}\n{_clean(first.suggestion)}"
        else:
            test = _test(f"{_named(code)} ({severity})", where)
            ET.SubElement(test, "system-out").text = f"{text}\n{_clean(first.suggestion)}"
        found.append(test)
    return found


def _line(problem: "Problem") -> str:
    place = problem.location
    pointer = place.pointer or ""
    index = "" if place.index is None else f"[{place.index}]"
    where = " ".join(part for part in (place.path, pointer, index) if part)
    return f"{problem.severity} {problem.code}: {problem.message} @ {show(where)}"


def _count(suite: ET.Element) -> None:
    tests = suite.findall("testcase")
    suite.set("tests", str(len(tests)))
    for name, element in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(name, str(sum(test.find(element) is not None for test in tests)))
