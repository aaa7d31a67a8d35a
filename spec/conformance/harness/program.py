"""What the command lines of the harnesses have in common."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from harness.cases import CORPUS

__all__ = ["Difference", "Options", "each", "finish", "options_parser", "read_options"]

Item = TypeVar("Item")
NOTHING_WRONG, DIFFERENT, COULD_NOT_RUN = 0, 1, 2


@dataclass(frozen=True)
class Difference:
    """One way in which a program did not do what the case asks for.

    Attributes
    ----------
    case : str
    what : str
        ``missing``, ``unexpected``, ``exit code``, ``answer`` ...
    detail : str
        One line.
    finding : dict or None
        The finding that is missing or unexpected.
    """

    case: str
    what: str
    detail: str
    finding: dict[str, Any] | None = None


@dataclass(frozen=True)
class Options:
    """The options of all harnesses."""

    corpus: Path
    only: list[str]
    jobs: int
    timeout_s: float
    json: Path | None
    command: list[str]


def options_parser(about: str) -> argparse.ArgumentParser:
    """Make a parser with the options of all harnesses."""
    parser = argparse.ArgumentParser(
        description=about.partition("\n")[0], usage="%(prog)s [options] -- COMMAND ..."
    )
    parser.add_argument("--corpus", type=Path, default=CORPUS, help="default: %(default)s")
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="PATTERN",
        help="such as TIME-*; repeatable",
    )
    parser.add_argument(
        "--jobs",
        type=_positive_count,
        default=os.cpu_count() or 1,
        help="programs that run at a time; default: one a core",
    )
    parser.add_argument("--timeout", type=_seconds, default=60.0, help="seconds for one case")
    parser.add_argument("--json", type=_file, help="write what was found to this file")
    parser.add_argument("command", nargs="+", metavar="COMMAND", help="the program, after --")
    return parser


def _positive_count(text: str) -> int:
    count = int(text)
    if count < 1:
        raise ValueError
    return count


def _seconds(text: str) -> float:
    seconds = float(text)
    if not seconds > 0:
        raise ValueError
    return seconds


def _file(text: str) -> Path:
    """Return a path that can be written: known before the work, not after it."""
    path = Path(text)
    if not path.parent.is_dir():
        msg = f"there is no folder {path.parent}"
        raise argparse.ArgumentTypeError(msg)
    return path


def read_options(parsed: argparse.Namespace) -> Options:
    """Return the options of all harnesses."""
    return Options(
        corpus=parsed.corpus,
        only=parsed.only,
        jobs=parsed.jobs,
        timeout_s=parsed.timeout,
        json=parsed.json,
        command=parsed.command,
    )


def each(
    judge: Callable[[Item], list[Difference]], items: Sequence[Item], jobs: int
) -> list[Difference]:
    """Judge all items, some at a time; the order of the result is that of the items."""
    with ThreadPoolExecutor(max_workers=jobs) as pool:
        return [found for several in pool.map(judge, items) for found in several]


def finish(
    options: Options,
    cases: Sequence[str],
    differences: list[Difference],
    *,
    not_supported: Sequence[str] = (),
) -> int:
    """Print and write what was found; return the exit code."""
    if options.json is not None:
        document = {
            "command": options.command,
            "cases": list(cases),
            "not_supported": list(not_supported),
            "differences": [vars(difference) for difference in differences],
        }
        options.json.write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    if not cases:
        sys.stderr.write("no case of that name\n")
        return COULD_NOT_RUN
    sys.stdout.write(_table(differences))
    for case in not_supported:
        sys.stdout.write(f"not supported: {case}\n")
    wrong = len({difference.case for difference in differences})
    sys.stdout.write(f"{len(cases)} cases: {len(cases) - wrong} as expected, {wrong} not\n")
    return DIFFERENT if differences else NOTHING_WRONG


def _table(differences: list[Difference]) -> str:
    if not differences:
        return ""
    rows = [("case", "what", "detail"), *((d.case, d.what, d.detail) for d in differences)]
    widths = [max(len(row[column]) for row in rows) for column in range(2)]
    return "".join(
        f"{case:<{widths[0]}}  {what:<{widths[1]}}  {detail}\n" for case, what, detail in rows
    )
