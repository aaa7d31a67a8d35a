"""What a validation found: data, from which every rendering is made."""

import json
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from exumi_data.standard import Level, Severity

__all__ = ["Coverage", "Location", "Problem", "Report", "Skipped", "Unchecked"]

REPORT_VERSION = 1


@dataclass(frozen=True, slots=True)
class Location:
    """Where something was found.

    Attributes
    ----------
    path : str
        File, array or group, relative to what was validated.
    episode : str or None
        In a dataset, the episode's path (of which `path` then is a continuation).
    pointer : str or None
        JSON pointer (RFC 6901) into the document at `path`.
    index : int or None
        Sample, frame, chunk or entry of the array at `path`.
    """

    path: str
    episode: str | None = None
    pointer: str | None = None
    index: int | None = None

    @property
    def file(self) -> str:
        """The path from the root of what was validated."""
        return f"{self.episode}/{self.path}" if self.episode else self.path

    def sort_key(self) -> tuple[str, str, str, int]:
        """Order of a report: by episode, path, pointer, index."""
        index = -1 if self.index is None else self.index
        return (self.episode or "", self.path, self.pointer or "", index)


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One broken rule at one place.

    Attributes
    ----------
    code : str
        Id of the rule.
    severity : {"error", "warning", "info"}
    level : {"document", "hierarchy", "arrays", "data"}
    location : Location
    message : str
    expected, found : str or None
    suggestion : str
    rule : str
        Where the rule stands: a path below ``spec/`` with an anchor.
    """

    code: str
    severity: Severity
    level: Level
    location: Location
    message: str
    expected: str | None = None
    found: str | None = None
    suggestion: str
    rule: str


@dataclass(frozen=True, slots=True)
class Unchecked:
    """Something that could not be checked, for a reason that is no broken rule."""

    path: str
    what: str
    reason: str


@dataclass(frozen=True, slots=True)
class Skipped:
    """A rule that could not be judged somewhere, because the data has nothing to judge it by.

    Such as a latency without events, or a swap of fingers without the rig's references. Not a
    fault, and not a pass.

    Attributes
    ----------
    code : str
        Id of the rule.
    reason : str
        A few words, the same for the same reason: reports count them.
    path : str
        Where; in the report of a dataset, the first of them.
    count : int
        How often.
    """

    code: str
    reason: str
    path: str
    count: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """How much was looked at: a pass says no more than this.

    Attributes
    ----------
    levels : tuple of str
    rules : int
        Rules of these levels that were judged.
    episodes, streams, arrays, samples, frames : int
        Frames are those that were read and decoded, samples those of `time` arrays.
    unchecked : tuple of Unchecked
        If there are any, the report is not a pass.
    skipped : tuple of Skipped
        Rules that had nothing to be judged by, counted by rule and reason.
    """

    levels: tuple[Level, ...] = ()
    rules: int = 0
    episodes: int = 0
    streams: int = 0
    arrays: int = 0
    samples: int = 0
    frames: int = 0
    unchecked: tuple[Unchecked, ...] = ()
    skipped: tuple[Skipped, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a validation found, and how much it looked at.

    Attributes
    ----------
    path : str
        What was validated.
    kind : {"episode", "dataset"}
    standard : str
        Version of the standard whose rules were applied.
    library : str
        Version of exumi-data.
    problems : tuple of Problem
        In order of place.
    coverage : Coverage
    not_listed : dict
        Code of a rule to the number of its problems beyond the limit for one episode.
    """

    path: str
    kind: str
    standard: str
    library: str
    problems: tuple[Problem, ...]
    coverage: Coverage
    not_listed: dict[str, int] = field(default_factory=dict)

    @property
    def valid(self) -> bool:
        """Whether no rule of severity error is broken, and all checks could be carried out."""
        return not self.count("error") and not self.coverage.unchecked

    @property
    def exit_code(self) -> int:
        """0 valid, 1 invalid; 2, could not run, is an exception of `validate`."""
        return 0 if self.valid else 1

    def count(self, severity: Severity) -> int:
        """Return the number of listed problems of a severity.

        Parameters
        ----------
        severity : {"error", "warning", "info"}
        """
        return sum(problem.severity == severity for problem in self.problems)

    def codes(self) -> dict[str, int]:
        """Return how often each rule is broken, the unlisted included."""
        return dict(Counter(problem.code for problem in self.problems) + Counter(self.not_listed))

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data: what `to_json` writes."""
        return {
            "report_version": REPORT_VERSION,
            "path": self.path,
            "kind": self.kind,
            "standard": self.standard,
            "library": self.library,
            "valid": self.valid,
            "counts": {
                "error": self.count("error"),
                "warning": self.count("warning"),
                "info": self.count("info"),
            },
            "coverage": asdict(self.coverage),
            "problems": [asdict(problem) for problem in self.problems],
            "not_listed": dict(sorted(self.not_listed.items())),
        }

    def to_json(self) -> str:
        """Return the report as JSON: the canonical form, ASCII, one trailing newline."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=True) + "\n"

    def to_text(self) -> str:
        """Return the report as plain text for people, grouped by file."""
        from exumi_validators.text import render_text

        return render_text(self)
