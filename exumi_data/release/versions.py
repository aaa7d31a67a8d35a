"""Versions of released datasets: ``major.minor.patch``, and which of them a change calls for."""

import re
from typing import Literal

from exumi_data.errors import UsageError

__all__ = ["AUTO", "FIRST", "STEPS", "Step", "decide_version", "next_version", "step_between"]

Step = Literal["patch", "minor", "major"]

STEPS: tuple[Step, ...] = ("patch", "minor", "major")
"""From the smallest to the largest."""
AUTO = "auto"
FIRST = "1.0.0"

_NUMBER = "(0|[1-9][0-9]{0,8})"
_VERSION = re.compile(rf"{_NUMBER}\.{_NUMBER}\.{_NUMBER}")


def next_version(previous: str, step: Step) -> str:
    """Return the version after another one.

    Parameters
    ----------
    previous : str
    step : {"patch", "minor", "major"}
    """
    major, minor, patch = _numbers(previous)
    if step == "major":
        return f"{major + 1}.0.0"
    return f"{major}.{minor + 1}.0" if step == "minor" else f"{major}.{minor}.{patch + 1}"


def step_between(previous: str, version: str) -> Step | None:
    """Return which of the numbers is the first that differs; None where `version` is not later.

    Parameters
    ----------
    previous, version : str

    Raises
    ------
    UsageError
        One of them is no version.
    """
    before, after = _numbers(previous), _numbers(version)
    if after <= before:
        return None
    changed = next(index for index in range(3) if before[index] != after[index])
    return ("major", "minor", "patch")[changed]


def decide_version(wanted: str, previous: str | None, needed: Step | None) -> str:
    """Return the version of a release.

    Parameters
    ----------
    wanted : str
        As stated by the user, or ``auto``.
    previous : str or None
        Of the release before it.
    needed : {"patch", "minor", "major"} or None
        What the changes since then call for; None where nothing changed.

    Raises
    ------
    UsageError
        What is stated is no version, not later than the one before, or too small a step.
    """
    if wanted == AUTO:
        return FIRST if previous is None else next_version(previous, needed or "patch")
    _numbers(wanted)
    if previous is None:
        return wanted
    step = step_between(previous, wanted)
    right = next_version(previous, needed or "patch")
    if step is None:
        raise UsageError(
            f"version {wanted} is not later than {previous}", fix=f"Say --version {right}."
        )
    if needed is not None and STEPS.index(step) < STEPS.index(needed):
        raise UsageError(
            f"version {wanted} is a {step} step after {previous}, and the changes call for a "
            f"{needed} one",
            fix=f"Say --version {right}, or auto. See what changed with: exumi release diff",
        )
    return wanted


def _numbers(version: str) -> tuple[int, int, int]:
    found = _VERSION.fullmatch(version)
    if found is None:
        raise UsageError(
            f"{version!r} is no version", fix=f"Write it such as {FIRST}, or say {AUTO}."
        )
    major, minor, patch = (int(number) for number in found.groups())
    return major, minor, patch
