"""Documented parameters are the real ones, and what a user meets has all of them (numpydoc)."""

import dataclasses
import importlib
import inspect
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import pytest
from numpydoc.validate import validate
from pydantic import BaseModel

# Undocumented, unknown and misordered parameters; a missing docstring is ruff's to find.
CODES = {"PR01", "PR02", "PR03"}
FIVE = ("exumi_data", "exumi_converters", "exumi_validators", "exumi_loaders", "exumi_recorders")


def documented(thing: object) -> Iterator[str]:
    """Dotted names of a function, or of the constructor and the methods of a class."""
    if inspect.isfunction(thing):
        yield f"{thing.__module__}.{thing.__qualname__}"
    elif inspect.isclass(thing):
        path = f"{thing.__module__}.{thing.__qualname__}"
        # Models and dataclasses document their fields, as attributes.
        fields_are_documented = issubclass(thing, BaseModel) or dataclasses.is_dataclass(thing)
        # A protocol has a constructor of typing's.
        constructor = vars(thing).get("__init__")
        is_own = getattr(constructor, "__module__", None) == thing.__module__
        if is_own and not fields_are_documented:
            yield path
        for name, member in vars(thing).items():
            plain = member.__func__ if isinstance(member, classmethod | staticmethod) else member
            # Pydantic gives models with private attributes a method of its own.
            is_own = inspect.isfunction(plain) and plain.__module__ == thing.__module__
            if is_own and not name.startswith("_"):
                yield f"{path}.{name}"


def mistakes(path: str, *, brief_allowed: bool) -> list[str]:
    """What is wrong with the parameters of a docstring; it may be brief and have none."""
    result = validate(path)
    if brief_allowed and "Parameters\n---" not in inspect.cleandoc(result["docstring"]):
        return []
    return [f"{path}: {text}" for code, text in result["errors"] if code in CODES]


def test_what_a_user_meets_documents_every_parameter() -> None:
    paths = [
        path
        for package in map(importlib.import_module, FIVE)
        for name in package.__all__
        for path in documented(getattr(package, name))
    ]
    assert paths
    assert [m for path in paths for m in mistakes(path, brief_allowed=False)] == []


def test_documented_parameters_are_the_real_ones(modules: dict[str, Path]) -> None:
    public = [name for name in modules if not any(p.startswith("_") for p in name.split("."))]
    paths = [
        path
        for module in map(importlib.import_module, public)
        for name in getattr(module, "__all__", ())
        for path in documented(getattr(module, name))
    ]
    assert paths
    assert [m for path in sorted(set(paths)) for m in mistakes(path, brief_allowed=True)] == []


def example(*, here: int) -> int:
    """Return a number, and document one that is not there.

    Parameters
    ----------
    gone : int
        It was renamed.
    """
    return here


def brief(*, here: int) -> int:
    """Return a number."""
    return here


def test_mistakes_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = types.ModuleType("exumi_docstring_sample")
    vars(sample).update(example=example, brief=brief)
    monkeypatch.setitem(sys.modules, sample.__name__, sample)
    wrong, short = (f"{sample.__name__}.{name}" for name in ("example", "brief"))
    assert len(mistakes(wrong, brief_allowed=True)) == 2
    assert mistakes(short, brief_allowed=True) == []
    assert len(mistakes(short, brief_allowed=False)) == 1
