"""What a validation found, as the page needs it: handed over by whoever can validate."""

from dataclasses import dataclass
from typing import Literal

__all__ = ["Finding", "Judgement", "NotJudged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """All findings of one rule.

    Attributes
    ----------
    code : str
        Id of the rule.
    severity : {"error", "warning", "info"}
    count : int
    message : str
        Of the first.
    place : str
        Of the first, relative to what was validated.
    suggestion : str
    """

    code: str
    severity: Literal["error", "warning", "info"]
    count: int
    message: str
    place: str
    suggestion: str


@dataclass(frozen=True, slots=True)
class NotJudged:
    """A rule that had nothing to be judged by, or something that could not be checked."""

    what: str
    reason: str
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The result of a validation.

    Attributes
    ----------
    standard : str
        Version of the standard.
    levels : tuple of str
        How far was looked: ``document``, ``hierarchy``, ``arrays``, ``data``.
    rules, episodes, samples, frames : int
        How much was looked at.
    findings : tuple of Finding
        The grave ones first.
    unchecked : tuple of NotJudged
        What could not be checked: if there is anything, this is not a pass.
    skipped : tuple of NotJudged
        Rules that had nothing to be judged by.
    """

    standard: str
    levels: tuple[str, ...]
    rules: int
    episodes: int
    samples: int
    frames: int
    findings: tuple[Finding, ...]
    unchecked: tuple[NotJudged, ...] = ()
    skipped: tuple[NotJudged, ...] = ()

    def count(self, severity: str) -> int:
        """Return how many findings of a severity there are.

        Parameters
        ----------
        severity : str
        """
        return sum(found.count for found in self.findings if found.severity == severity)
