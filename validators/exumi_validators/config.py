"""Rules judged in another way than the standard's, by a file of the user's.

``exumi.toml``, or the table ``[tool.exumi]`` of ``pyproject.toml``::

    [validate.rules]
    "TIME-006" = "info"
    "POSE-003" = {severity = "warning", limits = {speed_m_per_s = 8.0}, reason = "a fast arm"}

    [[validate.suppress]]
    rule = "TACT-008"
    path = "episodes/a1/*"
    reason = "the night session, known"

The file is never looked for beside the data: data must not say how it is judged.
"""

import difflib
import os
import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.errors import UsageError
from exumi_data.standard import Level
from exumi_data.store.plain_files import read_plain
from exumi_validators.findings import show
from exumi_validators.plugins import known_rules
from exumi_validators.report import Configuration, Problem, Reclassified, Suppression

__all__ = ["CONFIG_NAMES", "Config", "find_config", "read_config"]

_PROJECT = "pyproject.toml"
CONFIG_NAMES = ("exumi.toml", _PROJECT)

_Severity = Literal["error", "warning", "info", "off"]
_MAX_BYTES = 1 << 20
# What a value has to be, by the type of pydantic's error.
_WANTED = {
    "literal_error": "error, warning, info or off",
    "model_type": "a table",
    "dict_type": "a table",
    "list_type": "a list of tables, each under [[...]]",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "string_too_short": "a text that says something",
}


class _Table(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


_Reason = Annotated[str, Field(min_length=1)]


class _Rule(_Table):
    severity: _Severity | None = None
    limits: dict[str, float] = {}
    reason: _Reason | None = None


def _in_full(value: object) -> object:
    """Write `"info"` in full, as `{severity = "info"}`."""
    return {"severity": value} if isinstance(value, str) else value


class _Suppression(_Table):
    rule: str
    path: str | None = None
    reason: _Reason


class _Validate(_Table):
    rules: dict[str, Annotated[_Rule, BeforeValidator(_in_full)]] = {}
    suppress: list[_Suppression] = []


class _File(_Table):
    validate_: Annotated[_Validate, Field(alias="validate")] = _Validate()


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """How rules are judged, where it is not as the standard has it.

    Attributes
    ----------
    configuration : Configuration
        What the report says of it.
    limits : mapping
        Numbers to judge by, by the rule's id and the limit's name.
    """

    configuration: Configuration
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def revised(self, problem: Problem, episode: str | None = None) -> Problem:
        """Return a problem as it is to be reported.

        Parameters
        ----------
        problem : Problem
        episode : str, optional
            Path of the episode that the problem's place is relative to.
        """
        for rule in self.configuration.rules:
            if rule.code != problem.code:
                continue
            if rule.severity == "off":
                reason = rule.reason or f"switched off in {self.configuration.file}"
                problem = replace(problem, suppressed=reason)
            else:
                problem = replace(problem, severity=rule.severity)
        item = self._suppression_of(problem, episode)
        return problem if item is None else replace(problem, suppressed=item.reason)

    def _suppression_of(self, problem: Problem, episode: str | None) -> Suppression | None:
        """Return the first suppression that covers a finding."""
        for item in self.configuration.suppress:
            if item.rule == problem.code and _covers(item.path, problem, episode):
                return item
        return None

    def told(
        self, problems: Iterable[Problem], not_listed: Collection[str], levels: Collection[Level]
    ) -> Configuration:
        """Return the configuration as the report has it: with what was suppressed in vain.

        Parameters
        ----------
        problems : iterable of Problem
            All that are listed, with the episode in their location.
        not_listed : collection of str
            Rules of which there were more suppressed findings than are listed. By which
            suppression those were is not known.
        levels : collection of str
            Levels that were judged.
        """
        used = {self._suppression_of(problem, problem.location.episode) for problem in problems}
        known = known_rules()
        suppress = tuple(
            replace(
                item,
                unused=item not in used
                and item.rule not in not_listed
                and known[item.rule].level in levels,
            )
            for item in self.configuration.suppress
        )
        return replace(self.configuration, suppress=suppress)


def _covers(pattern: str | None, problem: Problem, episode: str | None) -> bool:
    if pattern is None:
        return True
    path = problem.location.path
    names = (path,) if episode is None else (f"{episode}/{path}", episode, path)
    return any(fnmatchcase(name, pattern) for name in names)


def find_config(
    folder: str | os.PathLike[str], *, data: str | os.PathLike[str] | None = None
) -> Path | None:
    """Look for a configuration in a folder and those above it; the nearest one counts.

    Parameters
    ----------
    folder : path-like
        Where the user works, not where the data is.
    data : path-like, optional
        What is to be validated: a file inside of it is passed over.

    Returns
    -------
    pathlib.Path
        An ``exumi.toml``, or a ``pyproject.toml`` that has the table ``[tool.exumi]``; None where
        there is neither.
    """
    start = _real(folder)
    judged = None if data is None else _whole(_real(data))
    for place in (start, *start.parents):
        if judged is not None and place.is_relative_to(judged):
            continue
        for name in CONFIG_NAMES:
            file = place / name
            # Unlike those of `Path` these say no where the folder may not be looked into.
            is_link, is_file = os.path.islink(file), os.path.isfile(file)  # noqa: PTH113, PTH114
            if name == _PROJECT and not (is_file and _own_table(file)):
                continue
            if is_file or is_link:  # reading a link says so where it leads nowhere
                return file
    return None


def _real(path: str | os.PathLike[str]) -> Path:
    """Follow links; unlike `Path.resolve` also those that lead in a circle."""
    return Path(os.path.realpath(path))


def _whole(data: Path) -> Path:
    """Return the dataset that an episode lies in, or what was given."""
    for place in data.parents:
        if (place / DATASET_DOCUMENT).is_file():
            return place
    return data


def _own_table(file: Path) -> dict[str, Any]:
    """Return what of a file is ours."""
    try:
        document = tomllib.loads(read_plain(_real(file), _MAX_BYTES).decode("utf-8"))
    except FileNotFoundError:
        raise UsageError("no such file", where=file) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(
            f"is no TOML: {error}",
            where=file,
            fix="It is read for how to judge. Mend it, or leave it out with --no-config.",
        ) from None
    if file.name != _PROJECT:
        return document
    tool = document.get("tool")
    table = tool.get("exumi") if isinstance(tool, dict) else None
    return table if isinstance(table, dict) else {}


def read_config(file: str | os.PathLike[str]) -> Config:
    """Read a configuration.

    Parameters
    ----------
    file : path-like
        TOML; of a file named ``pyproject.toml`` the table ``[tool.exumi]``.

    Returns
    -------
    Config

    Raises
    ------
    UsageError
        It is not there or no TOML, or something in it is wrong, such as an unknown rule or a
        missing reason.
    DamagedDataError, LimitError
        It is no file, cannot be read, or is larger than a configuration is.
    """
    path = Path(file)
    try:
        table = _File.model_validate(_own_table(path)).validate_
    except ValidationError as error:
        raise _refusal(path, [_mistake(item, path) for item in error.errors()]) from None
    known = known_rules()
    mistakes = [_unknown(code, known) for code in table.rules if code not in known]
    mistakes += [_unknown(item.rule, known) for item in table.suppress if item.rule not in known]
    rules = {code: rule for code, rule in table.rules.items() if code in known}
    for code, rule in rules.items():
        mistakes += [
            f"{code} has no limit {name}; it has {', '.join(known[code].limits) or 'none'}"
            for name in rule.limits
            if name not in known[code].limits
        ]
    if mistakes:
        raise _refusal(path, mistakes)
    changed = tuple(
        Reclassified(
            code=code,
            severity=rule.severity or known[code].severity,
            standard=known[code].severity,
            limits=rule.limits,
            standard_limits={name: known[code].limits[name] for name in rule.limits},
            reason=rule.reason,
        )
        for code, rule in sorted(rules.items())
    )
    suppress = tuple(
        Suppression(rule=item.rule, path=item.path, reason=item.reason) for item in table.suppress
    )
    return Config(
        configuration=Configuration(file=os.fspath(file), rules=changed, suppress=suppress),
        limits={code: rule.limits for code, rule in rules.items() if rule.limits},
    )


def _refusal(path: Path, mistakes: list[str]) -> UsageError:
    ours = f"{_prefix(path)}validate"
    return UsageError(
        "; ".join(dict.fromkeys(mistakes)),
        where=path,
        fix=f'Known are [{ours}.rules], such as "ID-002" = "info", and [[{ours}.suppress]] with '
        "rule, path and reason (docs/validating.md).",
    )


def _prefix(path: Path) -> str:
    """Return what stands before the names of our tables in a file."""
    return "tool.exumi." if path.name == _PROJECT else ""


def _unknown(code: str, known: Mapping[str, object]) -> str:
    near = difflib.get_close_matches(code, known, n=1)
    return f"there is no rule {code}" + (f", but {near[0]}" if near else "")


def _mistake(item: Any, path: Path) -> str:
    """Say in our words what pydantic found wrong."""
    place = tuple(str(part) for part in item["loc"])
    name = show(_prefix(path) + ".".join(place))
    if place == ("tool",):
        return f"[tool.exumi] is for a {_PROJECT}; here the tables have no such prefix"
    if item["type"] == "extra_forbidden":
        return f"{name}: no such key; known here: {', '.join(_known_keys(place))}"
    if item["type"] == "missing":
        return f"{name}: is missing"
    wanted = _WANTED.get(item["type"]) or str(item["msg"])
    return f"{name}: {show(item['input'])} is not {wanted}"


def _known_keys(place: tuple[str, ...]) -> Iterable[str]:
    """Return the keys that a table knows, given the place of one that it does not."""
    match place:
        case (_,):
            return ("validate",)
        case (_, _):
            return _Validate.model_fields
        case (_, "rules", *_):
            return _Rule.model_fields
        case _:
            return _Suppression.model_fields
