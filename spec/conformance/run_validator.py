#!/usr/bin/env python3
"""Judge a validator: run it on every case of the corpus, compare codes and places.

The protocol is in ``spec/conformance/README.md``. Needs nothing but Python.
Exit code 0: as expected everywhere. 1: differences. 2: could not run.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator
from functools import partial
from typing import Any

from harness.cases import Case, chosen_cases, rules
from harness.commands import Outcome, run
from harness.program import (
    COULD_NOT_RUN,
    Difference,
    Options,
    each,
    finish,
    options_parser,
    read_options,
)

LEVELS = ("document", "hierarchy", "arrays", "data")
PLACE = ("episode", "path", "pointer", "index")
Key = tuple[Any, ...]


class AnswerError(Exception):
    """The answer of a validator is not what the protocol asks for."""


def key_of(code: Any, place: dict[str, Any]) -> Key:
    """Return what of a finding is compared."""
    return (code, *(place.get(name) for name in PLACE))


def reported(answer: Any) -> list[Key]:
    """Return the findings of a validator's answer.

    Raises
    ------
    AnswerError
        It is not what the protocol asks for.
    """
    problems = answer.get("problems") if isinstance(answer, dict) else None
    if not isinstance(problems, list):
        raise AnswerError("the answer has no list `problems`")
    found = []
    for problem in problems:
        if not isinstance(problem, dict) or not isinstance(problem.get("code"), str):
            raise AnswerError("a problem has no `code`")
        place = problem.get("location")
        if not isinstance(place, dict) or not isinstance(place.get("path"), str):
            raise AnswerError(f"the location of {problem['code']} has no `path`")
        found.append(key_of(problem["code"], place))
    return found


def compared(
    expected: list[Key], found: list[Key], levels: tuple[str, ...], table: dict[str, Any]
) -> tuple[list[Key], list[Key]]:
    """Return the findings that are missing and those that are unexpected.

    Findings of other levels are not compared, and neither are those of a validator's own rules,
    which have a colon in their code.
    """

    def counts(keys: list[Key]) -> Counter[Key]:
        return Counter(k for k in keys if _is_compared(str(k[0]), levels, table))

    missing, unexpected = counts(expected), counts(found)
    return list((missing - unexpected).elements()), list((unexpected - missing).elements())


def _is_compared(code: str, levels: tuple[str, ...], table: dict[str, Any]) -> bool:
    if ":" in code:
        return False
    return code not in table or table[code]["level"] in levels


def judge(
    case: Case, *, options: Options, levels: tuple[str, ...], table: dict[str, Any]
) -> list[Difference]:
    """Run the validator on one case."""
    outcome = run(options.command, [str(case.store)], options.timeout_s)
    return list(_judged(case, outcome, levels, table))


def _judged(
    case: Case, outcome: Outcome, levels: tuple[str, ...], table: dict[str, Any]
) -> Iterator[Difference]:
    if outcome.code not in (0, 1):
        ended = "it did not end" if outcome.code is None else f"it ended with {outcome.code}"
        yield Difference(case.name, "answer", f"{ended}: {outcome.last_line}")
        return
    try:
        found = reported(json.loads(outcome.stdout))
    except (ValueError, AnswerError) as error:
        yield Difference(case.name, "answer", str(error))
        return
    expected = [key_of(finding["code"], finding) for finding in case.findings]
    missing, unexpected = compared(expected, found, levels, table)
    for what, keys in (("missing", missing), ("unexpected", unexpected)):
        for key in keys:
            yield Difference(case.name, what, _shown(key), _as_finding(key))
    yield from _exit_code(case, outcome, expected, levels, table)


def _exit_code(
    case: Case,
    outcome: Outcome,
    expected: list[Key],
    levels: tuple[str, ...],
    table: dict[str, Any],
) -> Iterator[Difference]:
    errors = [key for key in expected if table[key[0]]["severity"] == "error"]
    within = [key for key in errors if table[key[0]]["level"] in levels]
    # A validator that looks at more levels than are compared may find more.
    wanted = 1 if within else 0
    if outcome.code != wanted and (wanted or not errors):
        yield Difference(case.name, "exit code", f"expected {wanted}, found {outcome.code}")


def _as_finding(key: Key) -> dict[str, Any]:
    return dict(zip(("code", *PLACE), key, strict=True))


def _shown(key: Key) -> str:
    code, episode, path, pointer, index = key
    place = f"{episode}/{path}" if episode else str(path)
    place += "" if pointer is None else f"#{pointer}"
    return f"{code} @ {place}" + ("" if index is None else f"[{index}]")


def main() -> int:
    """Run the program."""
    parser = options_parser(__doc__ or "")
    parser.add_argument(
        "--levels",
        default=",".join(LEVELS),
        help="compare only findings of these levels, such as document,hierarchy",
    )
    parsed = parser.parse_args()
    levels = tuple(parsed.levels.split(","))
    if unknown := sorted(set(levels) - set(LEVELS)):
        parser.error(f"unknown level {unknown[0]!r}; there are {', '.join(LEVELS)}")
    options = read_options(parsed)
    cases = chosen_cases(options.corpus, only=options.only)
    try:
        table = rules()
        work = partial(judge, options=options, levels=levels, table=table)
        found = each(work, cases, options.jobs)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return COULD_NOT_RUN
    return finish(options, [case.name for case in cases], found)


if __name__ == "__main__":
    sys.exit(main())
