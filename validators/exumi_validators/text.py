"""A report as text for people.

A few findings are listed by file. Beyond that they are summed up by rule, with the first places of
each: thousands of equal findings must stay readable.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Literal

from exumi_data.standard import LEVELS, Level
from exumi_validators.findings import show
from exumi_validators.plugins import known_rules

if TYPE_CHECKING:
    from exumi_validators.report import Location, Problem, Reclassified, Report

__all__ = ["Line", "Style", "render_text", "text_lines"]

Style = Literal["plain", "error", "warning", "info", "good", "place", "dim"]
Line = tuple[tuple[str, Style], ...]
"""Pieces of a line, with what they are: the command line gives them colours."""

_LISTED = 50
_PLACES = 3
_SEVERITIES = ("error", "warning", "info")


def render_text(report: "Report", *, verbose: bool = False) -> str:
    """Write a report for people: what is wrong, where, and what to do.

    Parameters
    ----------
    report : Report
    verbose : bool
        List every finding, however many there are.

    Returns
    -------
    str
        Lines without colours; what is not printable is escaped.
    """
    lines = text_lines(report, verbose=verbose)
    return "".join("".join(text for text, _ in line) + "\n" for line in lines)


def text_lines(report: "Report", *, verbose: bool = False) -> Iterator[Line]:
    """Yield the lines of a report, for a program that colours them.

    Parameters
    ----------
    report : Report
    verbose : bool
        List every finding, however many there are.
    """
    yield (f"{show(report.path)}: ", "plain"), _verdict(report)
    yield ((f"  {_coverage(report)}", "dim"),)
    yield from _judged_by(report)
    if verbose or len(report.counted) <= _LISTED:
        yield from _by_file(report)
    else:
        yield from _by_rule(report)
    yield from _suppressed(report, verbose=verbose)
    for item in report.coverage.unchecked:
        yield ()
        yield ((show(item.path), "place"),)
        yield ((f"  not checked: {item.what}: {show(item.reason)}", "error"),)
    yield from _skipped(report)


# -------------------------------------------------------------------------------------------- head


def _verdict(report: "Report") -> tuple[str, Style]:
    severity_of = {problem.code: problem.severity for problem in report.counted}
    totals: Counter[str] = Counter()
    for code, count in report.codes().items():
        totals[severity_of[code]] += count
    words = [_count(totals[word], word) for word in ("error", "warning") if totals[word]]
    suppressed = len(report.suppressed) + sum(report.suppressed_not_listed.values())
    if suppressed:
        words.append(f"{suppressed:,} suppressed")
    told = f" ({', '.join(words)})" if words else ""
    if report.valid:
        looked = _how_far(report.coverage.levels)
        if report.configuration is not None and not report.conformant:
            return f"valid as configured{looked}{told}", "warning"
        return f"valid{looked}{told}", "good"
    verdict = "invalid" if report.count("error") else "not fully checked"
    return f"{verdict}{told}", "error"


def _how_far(levels: "tuple[Level, ...]") -> str:
    """Say that a pass is one of some levels only."""
    if levels == LEVELS:
        return ""
    if levels == LEVELS[: len(levels)]:
        return f" up to level {levels[-1]}"
    return f" at level{'s' if len(levels) != 1 else ''} {', '.join(levels)}"


def _count(count: int, word: str) -> str:
    return f"{count:,} {word}{'s' if count != 1 else ''}"


def _coverage(report: "Report") -> str:
    done = report.coverage
    counts = (
        (done.episodes, "episode"),
        (done.streams, "stream"),
        (done.arrays, "array"),
        (done.samples, "sample"),
        (done.frames, "frame"),
    )
    parts = [_count(count, word) for count, word in counts if count or word == "episode"]
    parts.append(f"{done.rules} rules of exUMI {report.standard}")
    return f"checked {', '.join(done.levels)}: {', '.join(parts)}"


def _judged_by(report: "Report") -> Iterator[Line]:
    """Say what was not judged as the standard has it, and what that means."""
    for item in report.extensions:
        origin = f"{item.distribution} {item.version}".strip()
        yield ((f"  with the {item.provides} {show(item.name)} of {show(origin)}", "dim"),)
    if report.configuration is None:
        return
    yield ((f"  judged by {show(report.configuration.file)}", "warning"),)
    for rule in report.configuration.rules:
        yield ((f"    {_reclassified(rule)}", "plain"),)
    for ask in report.configuration.suppress:
        where = f" at {show(ask.path)}" if ask.path else ""
        done = "has nothing to suppress" if ask.unused else "suppressed"
        yield ((f"    {ask.rule}{where} {done}: {show(ask.reason)}", "plain"),)
    if report.conformant != report.valid:
        yield ((f"  {_conformance(report)}", "warning"),)


def _reclassified(rule: "Reclassified") -> str:
    parts = []
    if rule.severity != rule.standard:
        parts.append(f"{rule.severity} (standard: {rule.standard})")
    for name, value in rule.limits.items():
        parts.append(f"{name} {value:g} (standard: {rule.standard_limits[name]:g})")
    text = f"{rule.code}: {', '.join(parts) or 'unchanged'}"
    return text if rule.reason is None else f"{text}: {show(rule.reason)}"


def _conformance(report: "Report") -> str:
    if report.conformant is None:
        return f"whether it conforms to exUMI {report.standard} was not judged"
    if report.conformant:
        return f"by the standard's own rules it conforms to exUMI {report.standard}"
    return f"it does NOT conform to exUMI {report.standard}: judged by the standard's own rules"


# ---------------------------------------------------------------------------------------- findings


def _by_file(report: "Report") -> Iterator[Line]:
    for file, found in groupby(report.counted, key=lambda problem: problem.location.file):
        yield ()
        yield ((show(file), "place"),)
        for problem in found:
            yield from _problem(problem)
    if report.not_listed:
        yield ()
        for code, count in sorted(report.not_listed.items()):
            yield ((f"  ... and {count:,} more of {code}", "plain"),)


def _problem(problem: "Problem") -> Iterator[Line]:
    place = _place(problem.location)
    yield (
        ("  ", "plain"),
        (f"{problem.severity} {problem.code}", problem.severity),
        (f": {problem.message}" + (f" @ {place}" if place else ""), "plain"),
    )
    yield ((f"      {problem.suggestion}", "dim"),)


def _by_rule(report: "Report") -> Iterator[Line]:
    yield ()
    total = sum(report.codes().values())
    yield ((f"{total:,} findings, by rule (--verbose lists them by file):", "plain"),)
    of_rule: dict[str, list[Problem]] = {}
    for problem in report.counted:
        of_rule.setdefault(problem.code, []).append(problem)
    counts = report.codes()

    def order(code: str) -> tuple[int, int, str]:
        return _SEVERITIES.index(of_rule[code][0].severity), -counts[code], code

    for code in sorted(of_rule, key=order):
        found = of_rule[code]
        severity = found[0].severity
        yield ()
        yield (
            (f"{severity} {code}", severity),
            (f": {_extent(found, counts[code])}; {_title(found[0])}", "plain"),
        )
        for problem in found[:_PLACES]:
            place = f"{show(problem.location.file)} {_place(problem.location)}".rstrip()
            yield (f"  {place}", "place"), (f": {problem.message}", "plain")
        if counts[code] > _PLACES:
            yield ((f"  ... and {counts[code] - _PLACES:,} more", "plain"),)
        yield ((f"      {found[0].suggestion}", "dim"),)


def _extent(found: "list[Problem]", count: int) -> str:
    episodes = {p.location.episode for p in found if p.location.episode is not None}
    return f"{count:,}" + (f" in {_count(len(episodes), 'episode')}" if episodes else "")


def _title(problem: "Problem") -> str:
    rule = known_rules().get(problem.code)
    return f"the rule is: {rule.title}" if rule else problem.message


def _place(location: "Location") -> str:
    parts = []
    if location.pointer:
        parts.append(show(location.pointer))
    if location.index is not None:
        parts.append(f"[{location.index}]")
    return " ".join(parts)


# ------------------------------------------------------------------------- what does not count


def _suppressed(report: "Report", *, verbose: bool) -> Iterator[Line]:
    if not report.suppressed:
        return
    yield ()
    yield (("suppressed, listed but not counted:", "plain"),)
    if verbose:
        for problem in report.suppressed:
            place = f"{show(problem.location.file)} {_place(problem.location)}".rstrip()
            text = f"{problem.code}: {problem.message} @ {place}: {show(problem.suppressed)}"
            yield ((f"  {text}", "dim"),)
    else:
        groups = Counter((problem.code, problem.suppressed) for problem in report.suppressed)
        for (code, reason), count in sorted(groups.items(), key=str):
            first = next(p for p in report.suppressed if (p.code, p.suppressed) == (code, reason))
            more = f" and {count - 1:,} more" if count > 1 else ""
            text = f"{code}: {show(reason)} @ {show(first.location.file)}{more}"
            yield ((f"  {text}", "dim"),)
    for code, count in sorted(report.suppressed_not_listed.items()):
        yield ((f"  ... and {count:,} more of {code}", "dim"),)


def _skipped(report: "Report") -> Iterator[Line]:
    """List what had nothing to be judged by: rules with the same reason in one line."""
    if not report.coverage.skipped:
        return
    yield ()
    yield (("not checked, for want of something to judge by:", "plain"),)
    codes: dict[tuple[str, str, int], list[str]] = {}
    for item in report.coverage.skipped:
        codes.setdefault((item.reason, item.path, item.count), []).append(item.code)
    for (reason, path, count), rules in codes.items():
        more = f" and {count - 1:,} more" if count > 1 else ""
        yield ((f"  {', '.join(rules)}: {show(reason)} @ {show(path)}{more}", "dim"),)
