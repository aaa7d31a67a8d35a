"""What a validation found: data, from which every rendering is made."""

import json
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from exumi_data.standard import Level, Severity, rules

__all__ = [
    "REPORT_VERSION",
    "Configuration",
    "Coverage",
    "Extension",
    "Location",
    "Problem",
    "Reclassified",
    "Report",
    "Skipped",
    "Suppression",
    "Unchecked",
]

REPORT_VERSION = 2


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
        Where the rule stands: a path below ``spec/`` with an anchor; an address where the rule is
        another package's.
    suppressed : str or None
        Why the finding does not count, where a configuration says so.
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
    suppressed: str | None = None


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
class Reclassified:
    """A rule that a configuration judges in another way than the standard.

    Attributes
    ----------
    code : str
        Id of the rule.
    severity : {"error", "warning", "info", "off"}
        What it is now.
    standard : {"error", "warning", "info"}
        What it is in the standard, or in the package that it comes from.
    limits : dict of str to float
        Numbers that it now judges by.
    standard_limits : dict of str to float
        Those that they replace.
    reason : str or None
    """

    code: str
    severity: Literal["error", "warning", "info", "off"]
    standard: Severity
    limits: dict[str, float] = field(default_factory=dict)
    standard_limits: dict[str, float] = field(default_factory=dict)
    reason: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Suppression:
    """Findings that a configuration wants listed, but not counted.

    Attributes
    ----------
    rule : str
        Id of the rule.
    path : str or None
        Pattern for the file or episode; None for all.
    reason : str
    unused : bool
        Whether the rule was judged, and there was no finding to suppress.
    """

    rule: str
    path: str | None
    reason: str
    unused: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """What a configuration changed.

    Attributes
    ----------
    file : str
    rules : tuple of Reclassified
    suppress : tuple of Suppression
    """

    file: str
    rules: tuple[Reclassified, ...] = ()
    suppress: tuple[Suppression, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Extension:
    """Another package's checks, or its description of a kind of stream.

    Attributes
    ----------
    provides : {"checks", "stream kind"}
    name : str
    distribution : str
        The package.
    version : str
        Of the package.
    """

    provides: str
    name: str
    distribution: str
    version: str


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
        In order of place, the suppressed ones included.
    coverage : Coverage
    not_listed : dict
        Code of a rule to the number of its problems beyond the limit for one episode.
    suppressed_not_listed : dict
        The same for suppressed ones.
    configuration : Configuration or None
        None where every rule was judged as the standard has it.
    extensions : tuple of Extension
        What other packages took part with.
    """

    path: str
    kind: str
    standard: str
    library: str
    problems: tuple[Problem, ...]
    coverage: Coverage
    not_listed: dict[str, int] = field(default_factory=dict)
    suppressed_not_listed: dict[str, int] = field(default_factory=dict)
    configuration: Configuration | None = None
    extensions: tuple[Extension, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether no rule of severity error is broken, and all checks could be carried out.

        Judged by the severities and limits that were asked for: see `conformant`.
        """
        return not self.count("error") and not self.coverage.unchecked

    @property
    def conformant(self) -> bool | None:
        """Whether the standard's own rules hold, as far as `coverage` says that it was looked.

        By the standard's severities, suppressed findings included; other packages' rules have no
        part in it. None where that is not known: something could not be checked, or a rule that
        is an error in the standard was judged by other limits.
        """
        changed = self.configuration.rules if self.configuration else ()
        by_other_limits = {rule.code for rule in changed if rule.limits}
        musts = {code for code, rule in rules().items() if rule.severity == "error"}
        if any(problem.code in musts - by_other_limits for problem in self.problems):
            return False
        return None if self.coverage.unchecked or by_other_limits & musts else True

    @property
    def suppressed(self) -> tuple[Problem, ...]:
        """The findings that are listed, but do not count."""
        return tuple(problem for problem in self.problems if problem.suppressed is not None)

    @property
    def counted(self) -> tuple[Problem, ...]:
        """The findings that count."""
        return tuple(problem for problem in self.problems if problem.suppressed is None)

    @property
    def exit_code(self) -> int:
        """0 valid, 1 invalid or not fully checked; 2, could not run, is an exception."""
        return 0 if self.valid else 1

    def count(self, severity: Severity) -> int:
        """Return the number of listed problems of a severity; suppressed ones do not count.

        Parameters
        ----------
        severity : {"error", "warning", "info"}
        """
        return sum(problem.severity == severity for problem in self.counted)

    def codes(self) -> dict[str, int]:
        """Return how often each rule is broken, the unlisted included, the suppressed not."""
        return dict(Counter(problem.code for problem in self.counted) + Counter(self.not_listed))

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data: what `to_json` writes."""
        return {
            "report_version": REPORT_VERSION,
            "path": self.path,
            "kind": self.kind,
            "standard": self.standard,
            "library": self.library,
            "valid": self.valid,
            "conformant": self.conformant,
            "counts": {
                "error": self.count("error"),
                "warning": self.count("warning"),
                "info": self.count("info"),
                "suppressed": len(self.suppressed) + sum(self.suppressed_not_listed.values()),
            },
            "configuration": asdict(self.configuration) if self.configuration else None,
            "extensions": [asdict(item) for item in self.extensions],
            "coverage": asdict(self.coverage),
            "problems": [asdict(problem) for problem in self.problems],
            "not_listed": dict(sorted(self.not_listed.items())),
            "suppressed_not_listed": dict(sorted(self.suppressed_not_listed.items())),
        }

    def to_json(self) -> str:
        """Return the report as JSON: the canonical form, ASCII, one trailing newline."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=True) + "\n"

    def to_text(self, *, verbose: bool = False) -> str:
        """Return the report as plain text for people.

        Parameters
        ----------
        verbose : bool
            List every finding, however many there are.
        """
        from exumi_validators.text import render_text

        return render_text(self, verbose=verbose)

    def to_junit(self) -> str:
        """Return the report as JUnit XML, which CI servers show."""
        from exumi_validators.junit import render_junit

        return render_junit(self)

    def to_sarif(self) -> str:
        """Return the report as SARIF 2.1.0, which code scanners show."""
        from exumi_validators.sarif import render_sarif

        return render_sarif(self)
