"""The validator as the release asks for it."""

from collections.abc import Callable
from pathlib import Path

from exumi_data.release.judging import Judge, Judgement

__all__ = ["judge_with"]


def judge_with(
    workers: int | None, on_progress: Callable[[int, int], None] = lambda _done, _total: None
) -> Judge:
    """Return a function that judges a dataset by the standard alone, whatever a lab's own rules.

    Parameters
    ----------
    workers : int or None
        Processes; None: all cores.
    on_progress : callable
        Told how many episodes are judged, and of how many.
    """

    def judge(path: Path, thorough: bool) -> Judgement:
        from exumi_data.standard import LEVELS
        from exumi_validators import validate

        report = validate(
            path,
            levels=LEVELS if thorough else LEVELS[: LEVELS.index("hierarchy") + 1],
            workers=workers,
            on_progress=on_progress if thorough else None,
        )
        lines: dict[str, list[str]] = {"error": [], "warning": [], "info": []}
        of_rule: dict[str, list[str]] = {}
        for one in report.counted:
            of_rule[one.code] = lines[one.severity]
            lines[one.severity].append(f"{one.code}: {one.message} @ {one.location.file}")
        for code, count in report.not_listed.items():
            of_rule[code].append(f"{code}: {count:,} more, not listed")
        errors = [
            *lines["error"],
            *(
                f"not checked: {one.what} ({one.reason}) @ {one.path}"
                for one in report.coverage.unchecked
            ),
        ]
        return Judgement(tuple(errors), tuple(lines["warning"]), report)

    return judge
