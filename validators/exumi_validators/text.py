"""A report as plain text, grouped by file."""

from itertools import groupby
from typing import TYPE_CHECKING

from exumi_validators.findings import show

if TYPE_CHECKING:
    from exumi_validators.report import Location, Problem, Report

__all__ = ["render_text"]


def render_text(report: "Report") -> str:
    """Write a report for people: what is wrong, where, and what to do.

    Parameters
    ----------
    report : Report

    Returns
    -------
    str
        Lines without colours; what is not printable is escaped.
    """
    lines = [f"{show(report.path)}: {_verdict(report)}", f"  {_coverage(report)}"]
    for file, found in groupby(report.problems, key=lambda problem: problem.location.file):
        lines += ["", show(file)]
        for problem in found:
            lines += _problem(problem)
    if report.not_listed:
        lines.append("")
        for code, count in sorted(report.not_listed.items()):
            lines.append(f"  ... and {count} more of {code}")
    for item in report.coverage.unchecked:
        lines += ["", f"{show(item.path)}", f"  not checked: {item.what}: {show(item.reason)}"]
    lines += _skipped(report)
    return "\n".join(lines) + "\n"


def _skipped(report: "Report") -> list[str]:
    if not report.coverage.skipped:
        return []
    lines = ["", "not checked, for want of something to judge by:"]
    for item in report.coverage.skipped:
        more = f" and {item.count - 1} more" if item.count > 1 else ""
        lines.append(f"  {item.code}: {show(item.reason)} @ {show(item.path)}{more}")
    return lines


def _verdict(report: "Report") -> str:
    counts = [
        f"{report.count(severity)} {severity}{'s' if report.count(severity) != 1 else ''}"
        for severity in ("error", "warning")
        if report.count(severity)
    ]
    told = f" ({', '.join(counts)})" if counts else ""
    if report.valid:
        return f"valid{told}"
    if not report.count("error"):
        return f"not fully checked{told}"
    return f"invalid{told}"


def _coverage(report: "Report") -> str:
    done = report.coverage
    counts = (
        (done.episodes, "episode"),
        (done.streams, "stream"),
        (done.arrays, "array"),
        (done.samples, "sample"),
        (done.frames, "frame"),
    )
    parts = [f"{count:,} {word}{'s' if count != 1 else ''}" for count, word in counts if count]
    parts.append(f"{done.rules} rules of exUMI {report.standard}")
    return f"checked {', '.join(done.levels)}: {', '.join(parts)}"


def _place(location: "Location") -> str:
    parts = []
    if location.pointer:
        parts.append(show(location.pointer))
    if location.index is not None:
        parts.append(f"[{location.index}]")
    return " ".join(parts)


def _problem(problem: "Problem") -> list[str]:
    place = _place(problem.location)
    head = f"  {problem.severity} {problem.code}: {problem.message}"
    return [head + (f" @ {place}" if place else ""), f"      {problem.suggestion}"]
