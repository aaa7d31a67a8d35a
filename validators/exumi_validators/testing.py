"""The contract of another package's checks, for that package to run."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import Any

from exumi_validators.plugins import installed, mistakes_of_check
from exumi_validators.registry import Check, checks_of
from exumi_validators.validation import validate

__all__ = ["check_checks"]

Path = str | os.PathLike[str]


def check_checks(
    checks: ModuleType | Iterable[Check[Any]],
    *,
    good: Iterable[Path],
    bad: Mapping[Any, Mapping[str, int]],
) -> None:
    """Check that checks are registered, are silent on good data, and find what is wrong with bad.

    Parameters
    ----------
    checks : module or iterable of Check
        As the entry point names them.
    good : iterable of path-like
        Episodes or datasets in which they find nothing; at least one.
    bad : mapping of path-like to mapping
        Episodes or datasets, with the ids of the rules that are broken and how often. Every rule
        of the checks is broken in at least one of them.

    Raises
    ------
    AssertionError
        With all that is wrong.
    """
    members: tuple[Check[Any], ...]
    members = checks_of((checks,)) if isinstance(checks, ModuleType) else tuple(checks)
    own = {code for check in members for code in check.rules}
    found = [mistake for check in members for mistake in mistakes_of_check(check)]
    found += [f"{code} is not installed" for code in sorted(own - set(installed().rules))]
    stores = list(good)
    if not own or not stores:
        found.append("there is no check, or no good data")
    for path in stores:
        if broken := _broken(path, own, found):
            found.append(f"{path}: {broken} in what is said to be good")
    expected_somewhere = {code for expected in bad.values() for code in expected}
    for code in sorted(own - expected_somewhere):
        found.append(f"{code} is broken in none of the bad data: does it ever speak?")
    for path, expected in bad.items():
        broken = _broken(path, own, found)
        if broken != dict(expected):
            found.append(f"{path}: found {broken}, expected {dict(expected)}")
    if found:
        raise AssertionError("\n".join(found))


def _broken(path: Path, own: set[str], found: list[str]) -> dict[str, int]:
    """Return how often the package's rules are broken; note checks that failed."""
    report = validate(path)
    found += [f"{path}: {item.what} failed: {item.reason}" for item in report.coverage.unchecked]
    counts = Counter(problem.code for problem in report.problems if problem.code in own)
    return dict(counts)
