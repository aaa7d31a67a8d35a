"""``exumi stats --html``: validates, measures, and writes the page."""

from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset
    from exumi_data.episode import Episode
    from exumi_data.stats import Statistics
    from exumi_data.stats.html import Finding, Judgement
    from exumi_validators import Report
    from exumi_validators.report import Problem

__all__ = ["PageLevel", "judgement_of", "make_page"]

_SEVERITIES = ("error", "warning", "info")


class PageLevel(StrEnum):
    """How far a dataset is validated for its page."""

    NONE = "none"
    DOCUMENT = "document"
    HIERARCHY = "hierarchy"
    ARRAYS = "arrays"
    DATA = "data"


def make_page(
    source: "Dataset | Episode",
    statistics: "Statistics",
    file: Path,
    *,
    level: PageLevel,
    workers: int | None,
    quiet: bool,
) -> int:
    """Validate, look at the frames, and write the page.

    Parameters
    ----------
    source : Dataset or Episode
    statistics : Statistics
    file : pathlib.Path
    level : PageLevel
    workers : int or None
    quiet : bool
        Show no progress.

    Returns
    -------
    int
        Bytes of the page.
    """
    from exumi_data.cli.output import progress_of
    from exumi_data.stats.html import page_of, write_page

    judgement = None
    if level is not PageLevel.NONE:
        with progress_of("Validating", quiet=quiet) as update:
            judgement = _judgement(source.path, level, workers, lambda d, t: update(d, t, ""))
    with progress_of("Looking", quiet=quiet) as update:
        page = page_of(
            source,
            statistics,
            judgement=judgement,
            workers=workers,
            on_progress=lambda what, done, total: update(done, total, what.lower()),
        )
    return write_page(file, page)


def _judgement(
    path: str, level: PageLevel, workers: int | None, on_progress: Callable[[int, int], None]
) -> "Judgement":
    from exumi_data.standard import LEVELS
    from exumi_validators import validate

    levels = LEVELS[: LEVELS.index(level.value) + 1]
    # By the standard alone: a page for strangers hides nothing that a lab suppresses.
    report = validate(path, levels=levels, workers=workers, on_progress=on_progress)
    return judgement_of(report)


def judgement_of(report: "Report") -> "Judgement":
    """Hand over what a validation found.

    Parameters
    ----------
    report : Report

    Returns
    -------
    Judgement
        One finding a rule, with its first place.
    """
    from exumi_data.stats.html import Judgement, NotJudged

    by_rule: dict[str, list[Problem]] = {}
    for problem in report.counted:
        by_rule.setdefault(problem.code, []).append(problem)
    found = [
        _finding(problems, report.not_listed.get(code, 0)) for code, problems in by_rule.items()
    ]
    found.sort(key=lambda item: (_SEVERITIES.index(item.severity), -item.count, item.code))
    coverage = report.coverage
    return Judgement(
        standard=report.standard,
        levels=coverage.levels,
        rules=coverage.rules,
        episodes=coverage.episodes,
        samples=coverage.samples,
        frames=coverage.frames,
        findings=tuple(found),
        unchecked=tuple(NotJudged(item.what, item.reason, 1) for item in coverage.unchecked),
        skipped=tuple(NotJudged(item.code, item.reason, item.count) for item in coverage.skipped),
    )


def _finding(problems: "Sequence[Problem]", not_listed: int) -> "Finding":
    from exumi_data.stats.html import Finding

    first = problems[0]
    place = first.location.file
    if first.location.pointer:
        place += f" {first.location.pointer}"
    if first.location.index is not None:
        place += f" [{first.location.index}]"
    return Finding(
        code=first.code,
        severity=first.severity,
        count=len(problems) + not_listed,
        message=first.message,
        place=place,
        suggestion=first.suggestion,
    )
