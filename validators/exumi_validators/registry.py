"""Checks: functions that judge rules."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Generic, Literal, TypeVar

from exumi_data.standard import Level, Rule, rules
from exumi_validators.report import Problem, Skipped

__all__ = [
    "MAX_FINDINGS",
    "Check",
    "Finding",
    "TooManyFindingsError",
    "check",
    "checks_of",
    "reason_of",
]

Finding = Problem | Skipped
"""What a check yields: a broken rule, or a rule that it could not judge, with the reason."""

Context = TypeVar("Context")

MAX_FINDINGS = 10_000
"""Findings of one check in one episode."""


class TooManyFindingsError(Exception):
    """A check was stopped: what is left was not judged."""


@dataclass(frozen=True, slots=True)
class Check(Generic[Context]):
    """A function that judges one rule, or a few that belong together.

    Attributes
    ----------
    rules : tuple of str
        Ids of the rules it judges, all of one level.
    level : {"document", "hierarchy", "arrays", "data"}
    function : callable
        Takes the context (an episode, an archive or a dataset), yields findings.
    defines : tuple of Rule
        Those of its rules that are not in the standard.
    scope : {"episode", "dataset"}
        What another package's check judges.
    """

    rules: tuple[str, ...]
    level: Level
    function: Callable[[Context], Iterator[Finding]]
    defines: tuple[Rule, ...] = ()
    scope: Literal["episode", "dataset"] = "episode"

    @property
    def name(self) -> str:
        """The function's name, for messages."""
        return self.function.__name__

    def __call__(self, context: Context) -> Iterator[Finding]:
        """Judge; yields only findings of the check's own rules.

        Raises
        ------
        TooManyFindingsError
            After ten thousand: a file of a kilobyte can have a thousand million mistakes.
        """
        for number, found in enumerate(self.function(context)):
            if number >= MAX_FINDINGS:
                msg = f"judging was stopped after {MAX_FINDINGS:,} findings"
                raise TooManyFindingsError(msg)
            if found.code not in self.rules:
                msg = f"the check {self.name} reports {found.code}, which it does not judge"
                raise RuntimeError(msg)
            yield found


def reason_of(error: BaseException) -> str:
    """Say why something was not judged: in few words, also where that was not foreseen.

    Parameters
    ----------
    error : BaseException
        What a check raised.
    """
    foreseen = isinstance(error, TooManyFindingsError)
    return (str(error) if foreseen else f"{type(error).__name__}: {error}")[:500]


def check(
    *judged: str | Rule,
    scope: Literal["episode", "dataset"] = "episode",
) -> Callable[[Callable[[Context], Iterator[Finding]]], Check[Context]]:
    """Make a function a check of some rules.

    Parameters
    ----------
    *judged : str or Rule
        Ids of rules of the standard, or another package's rules themselves; all of one level.
    scope : {"episode", "dataset"}
        What another package's check judges: each episode, or the dataset once. It then takes an
        `EpisodeContext` or a `DatasetContext`.

    Raises
    ------
    ValueError
        An id is unknown, or the rules are of different levels.

    Examples
    --------
    >>> @check("TIME-001")
    ... def time_increases(episode: EpisodeContext) -> Iterator[Problem]:  # doctest: +SKIP
    ...     ...
    """
    defines = tuple(rule for rule in judged if isinstance(rule, Rule))
    codes = tuple(rule.id if isinstance(rule, Rule) else rule for rule in judged)
    known = {**rules(), **{rule.id: rule for rule in defines}}
    unknown = [code for code in codes if code not in known]
    if unknown or not codes:
        msg = f"unknown rules: {unknown}" if unknown else "a check judges at least one rule"
        raise ValueError(msg)
    levels = {known[code].level for code in codes}
    if len(levels) > 1:
        msg = f"rules of different levels in one check: {codes}"
        raise ValueError(msg)
    level = levels.pop()

    def decorate(function: Callable[[Context], Iterator[Finding]]) -> Check[Context]:
        return Check(codes, level, function, defines, scope)

    return decorate


def checks_of(modules: Iterable[ModuleType]) -> tuple[Check[Context], ...]:
    """Collect the checks of some modules, in the order of their definition.

    Parameters
    ----------
    modules : iterable of module

    Returns
    -------
    tuple of Check

    Raises
    ------
    ValueError
        Two checks judge the same rule.
    """
    found: list[Check[Context]] = []
    judged: dict[str, str] = {}
    for module in modules:
        for value in vars(module).values():
            if not isinstance(value, Check) or value.function.__module__ != module.__name__:
                continue
            for code in value.rules:
                if code in judged:
                    msg = f"rule {code} is judged by {judged[code]} and by {value.name}"
                    raise ValueError(msg)
                judged[code] = value.name
            found.append(value)
    return tuple(found)
