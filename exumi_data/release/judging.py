"""What is asked of a validator before data are released: the command line hands one over."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Judge", "Judgement"]


@dataclass(frozen=True, slots=True)
class Judgement:
    """What a validator found.

    Attributes
    ----------
    errors : tuple of str
        What makes the dataset invalid, or could not be checked; one line each.
    warnings : tuple of str
    report : Any
        The validator's own report.
    """

    errors: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    report: Any = None


Judge = Callable[[Path, bool], Judgement]
"""Judges the dataset in a folder; all of its data, or (False) its documents and what is there."""
