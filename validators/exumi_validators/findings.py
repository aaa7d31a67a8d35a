"""Making problems out of rules, and collecting them without end."""

import json
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from exumi_data.standard import Rule, rules
from exumi_validators.report import Location, Problem, Skipped

__all__ = ["Collector", "json_pointer", "merged", "problem", "show"]

_SHOWN = 200
_LISTED_PER_RULE = 100


def show(value: object) -> str:
    """Write a value for a message: as JSON where it is, and cut to a readable length.

    Parameters
    ----------
    value : object
        Anything, also from a hostile file: what is not printable is escaped.
    """
    if isinstance(value, str):
        text = value if value and value.isprintable() else ascii(value)
    else:
        try:
            text = json.dumps(value)
        except (TypeError, ValueError, RecursionError):
            text = ascii(value) if isinstance(value, int | float) else type(value).__name__
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def json_pointer(parts: tuple[int | str, ...]) -> str:
    """Write a place in a JSON document as RFC 6901 has it.

    Parameters
    ----------
    parts : tuple
        Keys and indices, from the root.
    """
    escaped = (str(part).replace("~", "~0").replace("/", "~1") for part in parts)
    return "".join(f"/{part}" for part in escaped)


def problem(
    code: str | Rule,
    path: str,
    *,
    pointer: tuple[int | str, ...] | None = None,
    index: int | None = None,
    expected: object = None,
    found: object = None,
    **words: Any,
) -> Problem:
    """Make the problem that a broken rule is.

    Parameters
    ----------
    code : str or Rule
        Id of a rule of the standard, or another package's rule: from it come severity, message
        and suggestion.
    path : str
        File, array or group, relative to the episode or dataset.
    pointer : tuple, optional
        Place in the document at `path`.
    index : int, optional
        Place in the array at `path`.
    expected, found : object
        Written with `show`.
    **words
        Further words of the rule's message.

    Returns
    -------
    Problem
    """
    rule = code if isinstance(code, Rule) else rules()[code]
    shown = {
        key: None if value is None else show(value)
        for key, value in {"expected": expected, "found": found, **words}.items()
    }
    return Problem(
        code=rule.id,
        severity=rule.severity,
        level=rule.level,
        location=Location(
            path=path, pointer=None if pointer is None else json_pointer(pointer), index=index
        ),
        message=rule.message.format(path=show(path), index=index, **_told(shown)),
        expected=shown["expected"],
        found=shown["found"],
        suggestion=rule.suggestion,
        rule=rule.anchor if "://" in rule.anchor else f"{rule.since}/{rule.anchor}",
    )


def _told(shown: dict[str, str | None]) -> dict[str, str]:
    return {key: "missing" if value is None else value for key, value in shown.items()}


class Collector:
    """Collects problems; beyond a hundred of one rule they are only counted.

    A file with a million mistakes must not make a report that fills the memory. Suppressed
    findings are counted apart, so that they cannot push others out of the list.

    Parameters
    ----------
    revise : callable, optional
        Given each problem, returns it as it is to be reported: see `Config.revised`.
    """

    def __init__(self, revise: Callable[[Problem], Problem] | None = None) -> None:
        self._revise = revise
        self._found: dict[tuple[str, Location], Problem] = {}
        self._per_rule: Counter[tuple[str, bool]] = Counter()
        self._skipped: list[Skipped] = []
        self.not_listed: Counter[str] = Counter()
        self.suppressed_not_listed: Counter[str] = Counter()

    def add(self, found: Problem | Skipped) -> None:
        """Add a finding, once for each place.

        Parameters
        ----------
        found : Problem or Skipped
        """
        if isinstance(found, Skipped):
            self._skipped.append(found)
            return
        key = (found.code, found.location)
        if key in self._found:
            return
        if self._revise is not None:
            found = self._revise(found)
        is_suppressed = found.suppressed is not None
        if self._per_rule[found.code, is_suppressed] >= _LISTED_PER_RULE:
            (self.suppressed_not_listed if is_suppressed else self.not_listed)[found.code] += 1
            return
        self._per_rule[found.code, is_suppressed] += 1
        self._found[key] = found

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """What could not be judged, counted by rule and reason."""
        return merged(self._skipped)

    @property
    def problems(self) -> tuple[Problem, ...]:
        """All listed problems, in order of place and code."""
        return tuple(sorted(self._found.values(), key=lambda p: (*p.location.sort_key(), p.code)))


def merged(skipped: Iterable[Skipped]) -> tuple[Skipped, ...]:
    """Count what could not be judged by rule and reason, in order of the rules' ids.

    Parameters
    ----------
    skipped : iterable of Skipped
    """
    found: dict[tuple[str, str], Skipped] = {}
    for item in skipped:
        key = (item.code, item.reason)
        before = found.get(key)
        found[key] = replace(before, count=before.count + item.count) if before else item
    return tuple(found[key] for key in sorted(found))
