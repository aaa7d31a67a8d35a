"""Checks that other packages add.

An entry point of the group ``exumi.checks`` leads to a module that holds checks, or to a tuple of
them. Their rules are named ``vendor:NAME-001`` and come with the checks (see `registry.check`).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType, ModuleType
from typing import Any

from exumi_data.errors import UsageError
from exumi_data.extensions import stream_kind_plugins
from exumi_data.plugins import Plugin, load_plugins, refuse_twice
from exumi_data.standard import LEVELS, Rule, rules
from exumi_validators.registry import Check, checks_of
from exumi_validators.report import Extension

__all__ = ["CHECKS", "RULE_ID", "Installed", "installed", "known_rules", "mistakes_of_check"]

CHECKS = "exumi.checks"
"""The group of the entry points."""

RULE_ID = re.compile(r"[a-z][a-z0-9-]*:[A-Z][A-Z0-9]*-[0-9]{3}")
"""Ids of other packages' rules."""

_URL = re.compile(r"https?://\S+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Installed:
    """What installed packages add to a validation.

    Attributes
    ----------
    episode_checks, dataset_checks : tuple of Check
        The cheap levels first.
    rules : mapping of str to Rule
    extensions : tuple of Extension
        Also the kinds of streams that packages describe.
    """

    episode_checks: tuple[Check[Any], ...]
    dataset_checks: tuple[Check[Any], ...]
    rules: Mapping[str, Rule]
    extensions: tuple[Extension, ...]


def mistakes_of_check(check: Check[Any]) -> list[str]:
    """List what is wrong with another package's check.

    Parameters
    ----------
    check : Check
    """
    found = [
        f"{check.name} judges {code} of the standard" for code in check.rules if code in rules()
    ]
    for rule in check.defines:
        if not RULE_ID.fullmatch(rule.id):
            found.append(f"the rule id {rule.id!r} is not like vendor:NAME-001")
        if not _URL.fullmatch(rule.anchor):
            found.append(f"the anchor of {rule.id} is {rule.anchor!r}, not an address")
        if rule.level not in LEVELS or rule.severity not in ("error", "warning", "info"):
            found.append(f"the level or severity of {rule.id} is none")
    return found


@cache
def installed() -> Installed:
    """Load what installed packages add, once a process.

    Raises
    ------
    UsageError
        A package cannot be loaded, breaks the rules for extensions, or two add the same.
    """
    checks: list[Check[Any]] = []
    origin: dict[str, str] = {}
    plugins = load_plugins(CHECKS)
    for plugin in plugins:
        for check in _checks_of_plugin(plugin):
            for code in check.rules:
                if code in origin:
                    refuse_twice(f"the rule {code}", origin[code], plugin.origin)
                origin[code] = plugin.origin
            checks.append(check)
    checks.sort(key=lambda check: LEVELS.index(check.level))
    return Installed(
        episode_checks=tuple(check for check in checks if check.scope == "episode"),
        dataset_checks=tuple(check for check in checks if check.scope == "dataset"),
        rules=MappingProxyType({rule.id: rule for check in checks for rule in check.defines}),
        extensions=(
            *(_extension("checks", plugin) for plugin in plugins),
            *(_extension("stream kind", plugin) for plugin in stream_kind_plugins().values()),
        ),
    )


def _extension(provides: str, plugin: Plugin) -> Extension:
    return Extension(
        provides=provides,
        name=plugin.name,
        distribution=plugin.distribution,
        version=plugin.version,
    )


def _checks_of_plugin(plugin: Plugin) -> tuple[Check[Any], ...]:
    value = plugin.value
    found: tuple[Check[Any], ...] = ()
    mistakes = []
    if isinstance(value, ModuleType):
        try:
            found = checks_of((value,))
        except ValueError as error:
            mistakes.append(str(error))
    elif isinstance(value, tuple | list) and all(isinstance(item, Check) for item in value):
        found = tuple(value)
    else:
        mistakes.append(f"{type(value).__name__} is neither a module nor a tuple of checks")
    if not found and not mistakes:
        mistakes.append("there are none")
    mistakes += [mistake for check in found for mistake in mistakes_of_check(check)]
    if mistakes:
        raise UsageError(
            f"the checks {plugin.name!r} of {plugin.origin}: {'; '.join(mistakes)}",
            fix="Tell the authors of that package.",
        )
    return found


def known_rules() -> Mapping[str, Rule]:
    """Return the rules of the standard and of installed packages, by id."""
    return {**rules(), **installed().rules}
