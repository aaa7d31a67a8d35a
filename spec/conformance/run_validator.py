#!/usr/bin/env python3
"""Judge a validator: run it on every case of the corpus, compare codes and places.

Of a rule that is broken in several samples, frames or rows of an array, the number of findings and
their indices are free; with ``--exact`` they are compared, too. With ``--batch`` the validator gets
many paths and prints one line of JSON for each. The protocol is in ``spec/conformance/README.md``.
Needs nothing but Python.
Exit code 0: as expected everywhere. 1: differences. 2: could not run.
"""

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from harness.cases import Case, chosen_cases, rules
from harness.commands import Outcome, answer, run
from harness.program import (
    COULD_NOT_RUN,
    Difference,
    Options,
    each,
    finish,
    options_parser,
    read_options,
)

BATCH = 24
"""Cases that a validator gets at a time with ``--batch``."""
LEVELS = ("document", "hierarchy", "arrays", "data")
PLACE = ("episode", "path", "pointer", "index")
Key = tuple[Any, ...]


@dataclass(frozen=True)
class Comparison:
    """What of the findings is compared: the levels, the rule table, whether every index."""

    levels: tuple[str, ...]
    table: dict[str, Any]
    exact: bool


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


def compared(expected: list[Key], found: list[Key], how: Comparison) -> tuple[list[Key], list[Key]]:
    """Return the findings that are missing and those that are unexpected.

    Findings of other levels are not compared, and neither are those of a validator's own rules,
    which have a colon in their code.
    """

    def counts(keys: list[Key]) -> Counter[Key]:
        own = [key for key in keys if _is_compared(str(key[0]), how)]
        return Counter(own if how.exact else _by_place(own))

    missing, unexpected = counts(expected), counts(found)
    return list((missing - unexpected).elements()), list((unexpected - missing).elements())


def _by_place(keys: list[Key]) -> list[Key]:
    """Make one finding of all that differ in nothing but their index; keep the others."""
    indexed = {key[:-1] for key in keys if key[-1] is not None}
    places = [(*place, None) for place in sorted(indexed, key=repr)]
    return places + [key for key in keys if key[:-1] not in indexed]


def _is_compared(code: str, how: Comparison) -> bool:
    if ":" in code:
        return False
    return code not in how.table or how.table[code]["level"] in how.levels


def judge(case: Case, *, options: Options, how: Comparison) -> list[Difference]:
    """Run the validator on one case."""
    outcome = run(options.command, [str(case.store)], options.timeout_s)
    return list(_judged(case, outcome, how))


def judge_batch(cases: list[Case], *, options: Options, how: Comparison) -> list[Difference]:
    """Run the validator once on several cases."""
    paths = [str(case.store) for case in cases]
    outcome = run(options.command, paths, options.timeout_s * len(cases))
    lines = outcome.stdout.splitlines()
    answers = [_answer(line, outcome) for line in lines]
    # It may have stopped half-way, or not have begun.
    answers += [replace(outcome, code=None)] * (len(cases) - len(answers))
    found = [d for case, one in zip(cases, answers, strict=False) for d in _judged(case, one, how)]
    if len(lines) > len(cases):
        found.append(Difference(cases[0].name, "answer", "more lines than paths"))
    return found


def _answer(line: str, outcome: Outcome) -> Outcome:
    """Return one line of a batch as if it were the answer of one run."""
    try:
        code = answer(line)["exit_code"]
    except (ValueError, TypeError, KeyError):
        code = 0  # what is wrong with the answer is said where it is read
    return Outcome(code, line, outcome.stderr)


def _judged(case: Case, outcome: Outcome, how: Comparison) -> Iterator[Difference]:
    if outcome.code not in (0, 1):
        ended = "it did not end" if outcome.code is None else f"it ended with {outcome.code}"
        yield Difference(case.name, "answer", f"{ended}: {outcome.last_line}")
        return
    try:
        found = reported(answer(outcome.stdout))
    except (ValueError, AnswerError) as error:
        yield Difference(case.name, "answer", str(error))
        return
    expected = [key_of(finding["code"], finding) for finding in case.findings]
    missing, unexpected = compared(expected, found, how)
    for what, keys in (("missing", missing), ("unexpected", unexpected)):
        for key in keys:
            yield Difference(case.name, what, _shown(key), _as_finding(key))
    yield from _exit_code(case, outcome, expected, how)


def _exit_code(
    case: Case, outcome: Outcome, expected: list[Key], how: Comparison
) -> Iterator[Difference]:
    errors = [key for key in expected if how.table[key[0]]["severity"] == "error"]
    within = [key for key in errors if how.table[key[0]]["level"] in how.levels]
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
    parser.add_argument(
        "--exact", action="store_true", help="compare the index of every finding, too"
    )
    parser.add_argument(
        "--batch", action="store_true", help="give the validator many paths at a time"
    )
    parsed = parser.parse_args()
    levels = tuple(parsed.levels.split(","))
    if unknown := sorted(set(levels) - set(LEVELS)):
        parser.error(f"unknown level {unknown[0]!r}; there are {', '.join(LEVELS)}")
    options = read_options(parsed)
    cases = chosen_cases(options.corpus, only=options.only)
    try:
        how = Comparison(levels, rules(), exact=parsed.exact)
        if parsed.batch:
            batches = [cases[at : at + BATCH] for at in range(0, len(cases), BATCH)]
            found = each(partial(judge_batch, options=options, how=how), batches, options.jobs)
        else:
            found = each(partial(judge, options=options, how=how), cases, options.jobs)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return COULD_NOT_RUN
    return finish(options, [case.name for case in cases], found)


if __name__ == "__main__":
    sys.exit(main())
