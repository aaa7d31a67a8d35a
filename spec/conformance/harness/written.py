"""Judging what a program wrote: by a validator, by a reader, and against what it was given."""

import shlex
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.commands import answer, command_line, run

__all__ = [
    "JudgementError",
    "Judges",
    "NotSupportedError",
    "add_judges",
    "chosen_judges",
    "content",
    "lost",
    "written_by",
]

NOT_SUPPORTED = 3
"""Exit code of a program that has no way to do what it is asked for."""
Place = tuple[str, str, str | None, int | None]
OURS = Path(__file__).resolve().parents[2] / "readers" / "dump.py"


class NotSupportedError(Exception):
    """The program says that it has no way to do this."""


class JudgementError(Exception):
    """There is nothing to judge, or the validator or the reader that is to judge failed.

    Attributes
    ----------
    what : str
        As in `Difference`.
    """

    def __init__(self, what: str, detail: str) -> None:
        super().__init__(detail)
        self.what = what


@dataclass(frozen=True)
class Judges:
    """The commands that judge what was written."""

    validator: list[str]
    reader: list[str]
    timeout_s: float

    def problems(self, store: Path) -> Iterator[tuple[Place, str]]:
        """Yield what the validator finds: the rule and its place, and all of it as one line."""
        outcome = run(self.validator, [str(store)], self.timeout_s)
        try:
            found: list[dict[str, Any]] = answer(outcome.stdout)["problems"]
        except (ValueError, KeyError):
            msg = f"the validator gives no report: {outcome.last_line}"
            raise JudgementError("unreadable", msg) from None
        for problem in found:
            place = problem["location"]
            line = f"{problem['code']} @ {place['path']}: {problem.get('message', '')}"
            yield (problem["code"], place["path"], place.get("pointer"), place.get("index")), line

    def dump(self, store: Path) -> dict[str, Any]:
        """Return the canonical dump of what was written."""
        outcome = run(self.reader, [str(store)], self.timeout_s)
        if outcome.code != 0:
            msg = f"the reader refuses {store.name}: {outcome.last_line}"
            raise JudgementError("unreadable", msg)
        dump: dict[str, Any] = answer(outcome.stdout)
        return dump


def content(dump: dict[str, Any]) -> dict[str, Any]:
    """Return what of a dump is no choice of the writer, streams in order of their names."""
    # A newer minor version is welcome, and chunks, which the digest shows, are free.
    kept = {key: value for key, value in dump.items() if key not in ("version", "digest")}
    return kept | {"streams": sorted(dump["streams"], key=lambda stream: str(stream["name"]))}


def lost(given: Any, written: Any, at: str) -> Iterator[str]:
    """Yield what was given and is not in what was written. What was added is not looked at."""
    if isinstance(given, dict) and isinstance(written, dict):
        for key, value in given.items():
            if key in written:
                yield from lost(value, written[key], f"{at}.{key}")
            elif value is not None:
                yield f"{at}.{key} is missing"
    elif isinstance(given, list) and isinstance(written, list) and len(given) == len(written):
        for index, (one, other) in enumerate(zip(given, written, strict=True)):
            yield from lost(one, other, f"{at}[{index}]")
    elif isinstance(given, bool) != isinstance(written, bool) or given != written:
        yield f"{at}: given {given!r}, written {written!r}"


def written_by(command: list[str], arguments: list[str], target: Path, timeout_s: float) -> Path:
    """Run a program that is to write an episode; return what it wrote: a folder, or a zip of it.

    Parameters
    ----------
    command, arguments : list of str
        `target` is the last argument.
    target : pathlib.Path
        ``<...>/episode.zarr``.
    timeout_s : float

    Raises
    ------
    NotSupportedError
        It says that it cannot.
    JudgementError
        It failed, or wrote nothing of that name.
    """
    outcome = run(command, [*arguments, str(target)], timeout_s)
    if outcome.code == NOT_SUPPORTED:
        raise NotSupportedError
    if outcome.code != 0:
        ended = "did not end" if outcome.code is None else f"ended with {outcome.code}"
        raise JudgementError("answer", f"the program {ended}: {outcome.last_line}")
    for path in (target, target.with_suffix(".zarr.zip")):
        if path.exists():
            return path
    raise JudgementError("answer", "the program wrote nothing")


def add_judges(parser: ArgumentParser) -> None:
    """Add the options that name a validator and a reader."""
    default = "exumi validate --format json"
    parser.add_argument("--validator", type=command_line, default=default)
    parser.add_argument(
        "--reader", type=command_line, default=shlex.join([sys.executable, str(OURS)])
    )


def chosen_judges(parsed: Namespace) -> Judges:
    """Return the validator and the reader that were chosen."""
    return Judges(parsed.validator, parsed.reader, parsed.timeout)
