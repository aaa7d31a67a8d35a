#!/usr/bin/env python3
"""Judge a reader: compare its canonical dumps with those of another reader.

It has to read every valid case alike, and to refuse the cases of newer major versions and of
unknown ``requires`` with a message that names them. The protocol is in
``spec/readers/README.md``. Exit code 0: as expected everywhere. 1: differences. 2: could not run.
"""

import json
import shlex
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from harness.cases import Case, chosen_cases, json_at
from harness.commands import Outcome, run
from harness.dumps import differences
from harness.program import (
    COULD_NOT_RUN,
    Difference,
    Options,
    each,
    finish,
    options_parser,
    read_options,
)

OURS = Path(__file__).resolve().parents[1] / "readers" / "dump.py"
REFUSED = ("DOC-005", "ROOT-003")
"""Rules of which a reader refuses the cases."""


def judge(case: Case, *, options: Options, reference: list[str]) -> list[Difference]:
    """Run the reader on one case; a valid one is compared with its stored dump or the reference."""
    found = run(options.command, [str(case.store)], options.timeout_s)
    if case.findings:
        return list(_refusal(case, found))
    stored = case.folder / "dump.json"
    if stored.is_file():
        expected = Outcome(0, stored.read_text("utf-8"), "")
    else:
        expected = run(reference, [str(case.store)], options.timeout_s)
    for name, outcome in (("the reference", expected), ("the reader", found)):
        if outcome.code != 0:
            ended = "did not end" if outcome.code is None else f"ended with {outcome.code}"
            return [Difference(case.name, "answer", f"{name} {ended}: {outcome.last_line}")]
    try:
        dumps = [json.loads(outcome.stdout) for outcome in (expected, found)]
    except ValueError as error:
        return [Difference(case.name, "answer", f"no JSON: {error}")]
    return [Difference(case.name, "dump", line) for line in differences(*dumps)]


def _refusal(case: Case, found: Outcome) -> Iterator[Difference]:
    if found.code != 1:
        yield Difference(case.name, "exit code", f"expected 1, found {found.code}")
    for name in _to_be_named(case):
        if name not in found.stderr:
            detail = f"does not name {name}: {found.last_line}"
            yield Difference(case.name, "message", detail)


def _to_be_named(case: Case) -> Iterator[str]:
    """Yield the version or the entry of ``requires`` for which a case is refused."""
    for finding in case.findings:
        if finding["code"] in REFUSED:
            store = case.store / finding["episode"] if finding["episode"] else case.store
            value: Any = json_at(store, finding["path"], finding["pointer"])
            yield str(value)


def main() -> int:
    """Run the program."""
    parser = options_parser(__doc__ or "")
    default = shlex.join([sys.executable, str(OURS)])
    parser.add_argument(
        "--reference", default=default, help="the reader to compare with: one that is trusted"
    )
    parsed = parser.parse_args()
    options = read_options(parsed)
    cases = chosen_cases(options.corpus, only=options.only, side="valid")
    refused = chosen_cases(options.corpus, only=options.only, side="invalid")
    cases += [case for case in refused if case.folder.name.startswith(REFUSED)]
    try:
        work = partial(judge, options=options, reference=shlex.split(parsed.reference))
        found = each(work, cases, options.jobs)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return COULD_NOT_RUN
    return finish(options, [case.name for case in cases], found)


if __name__ == "__main__":
    sys.exit(main())
