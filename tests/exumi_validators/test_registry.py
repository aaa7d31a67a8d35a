"""Checks and rules belong together."""

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

from exumi_data.standard import rules
from exumi_validators.episode_run import archive_checks, episode_checks, root_checks
from exumi_validators.findings import problem
from exumi_validators.registry import Check, check, checks_of
from exumi_validators.report import Problem
from exumi_validators.validation import dataset_checks


def judged(*groups: tuple[Check[Any], ...]) -> list[str]:
    return [code for checks in groups for item in checks for code in item.rules]


def test_every_rule_is_judged() -> None:
    codes = judged(root_checks(), episode_checks(), archive_checks(), dataset_checks())
    assert set(codes) == set(rules())


def test_no_rule_is_judged_twice_in_an_episode() -> None:
    codes = judged(root_checks(), episode_checks())
    assert len(codes) == len(set(codes)) > 80


def test_checks_come_in_order_of_their_cost() -> None:
    levels = [item.level for item in episode_checks()]
    order = ["document", "hierarchy", "arrays", "data"]
    assert levels == sorted(levels, key=order.index)


def module(**members: object) -> ModuleType:
    found = ModuleType(__name__)
    vars(found).update(members)
    return found


def test_two_checks_of_one_rule_are_refused() -> None:
    @check("TIME-001")
    def first(_: object) -> Iterator[Problem]:
        yield from ()

    @check("TIME-002", "TIME-001")
    def second(_: object) -> Iterator[Problem]:
        yield from ()

    assert len(checks_of([module(first=first)])) == 1
    with pytest.raises(ValueError, match="rule TIME-001 is judged by first and by second"):
        checks_of([module(first=first, second=second)])


def test_unknown_rules_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown rules"):
        check("TIME-999")


def test_a_check_of_no_rule_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        check()


def test_rules_of_two_levels_are_refused() -> None:
    with pytest.raises(ValueError, match="different levels"):
        check("TIME-001", "IMG-006")


def test_a_check_speaks_of_its_own_rules_only() -> None:
    @check("TIME-001")
    def stray(_: object) -> Iterator[Problem]:
        yield problem("ARR-001", "streams/pose/data")

    with pytest.raises(RuntimeError, match="stray reports ARR-001"):
        list(stray(None))
