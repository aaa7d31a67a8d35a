"""Cases of the conformance corpus as examples of broken rules, judged by our validator."""

import json
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from links import ROOT

from exumi_validators import Problem, validate

__all__ = ["Example", "examples"]

_CORPUS = ROOT / "spec" / "conformance" / "1.0" / "invalid"
_LONGEST = 1200
_LINE = 88
_ROWS = 3
"""Rows of an array that are shown before and after the one that is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A case in which a rule is broken.

    Attributes
    ----------
    name : str
        Of the case's folder.
    about : str
        One sentence.
    problem : Problem
        What the validator says.
    shown : str or None
        What stands at the place: JSON, or rows of an array.
    language : str
        Of `shown`.
    """

    name: str
    about: str
    problem: Problem
    shown: str | None
    language: str


def examples() -> dict[str, list[Example]]:
    """Return the cases by the rule that they were made for, judged anew."""
    found: dict[str, list[Example]] = defaultdict(list)
    for folder in sorted(_CORPUS.iterdir()):
        expected = json.loads((folder / "expected.json").read_text("utf-8"))
        rule = folder.name.partition("__")[0]
        store = folder / expected["store"]
        report = validate(store, workers=1)
        problem = next(problem for problem in report.problems if problem.code == rule)
        shown, language = _shown(store, problem)
        found[rule].append(
            Example(
                name=folder.name,
                about=expected["about"],
                problem=problem,
                shown=shown,
                language=language,
            )
        )
    return dict(found)


def _shown(store: Path, problem: Problem) -> tuple[str | None, str]:
    """Return what stands at the place of a problem, where that can be shown."""
    place = problem.location
    if not store.is_dir():
        return None, "text"
    path = store / (place.episode or "") / place.path
    if place.pointer is not None:
        return _json_at(path, place.pointer), "json"
    if place.index is not None and (path / "zarr.json").is_file():
        return _rows_at(path, place.index), "text"
    return None, "text"


def _json_at(path: Path, pointer: str) -> str | None:
    """Return a value of a document with its key, or the object that lacks it."""
    keys = [key.replace("~1", "/").replace("~0", "~") for key in pointer.split("/")[1:]]
    try:
        value: Any = json.loads(path.read_text("utf-8"))
        for key in keys[:-1]:
            value = value[int(key)] if isinstance(value, list) else value[key]
    except (ValueError, KeyError, IndexError, OSError):
        return None
    last = keys[-1]
    if isinstance(value, dict) and last in value:
        value = {last: value[last]}
    elif isinstance(value, list) and last.isdigit() and int(last) < len(value):
        value = value[int(last)]
    text = json.dumps(value, ensure_ascii=False)
    if len(text) > _LINE:
        wide = json.dumps(value, indent=2, ensure_ascii=False)
        text = wide if len(wide) <= _LONGEST else text
    return text if len(text) <= _LONGEST else None


def _rows_at(path: Path, index: int) -> str | None:
    """Return the rows of an array about one of them, where there are few numbers in each."""
    try:
        array = zarr.open_array(path, mode="r")
        if array.ndim == 1 and array.dtype == np.uint8:
            return None  # the bytes of encoded frames: the index is a frame's, and not a byte's
        values = np.asarray(array[max(index - _ROWS, 0) : index + _ROWS + 1])
    except (ValueError, KeyError, OSError, RuntimeError):
        return None  # damaged, as many cases are
    rows = [np.array2string(np.asarray(row), separator=", ", max_line_width=200) for row in values]
    if not rows or len(rows[0]) > _LINE:
        return None
    first = max(index - _ROWS, 0)
    lines = [f"{first + i:>5}  {row}" for i, row in enumerate(rows)]
    if 0 <= index - first < len(lines):
        lines[index - first] += "   <--"
    return "\n".join(lines)
