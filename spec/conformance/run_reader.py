#!/usr/bin/env python3
"""Judge a reader: compare its canonical dumps with those of the corpus.

It has to read every valid case as its ``dump.json`` says, and to refuse damage, unsafe names, newer
major versions and unknown ``requires``; the last two with a message that names them. The protocol
is in ``spec/readers/README.md``. Needs nothing but Python.
Exit code 0: as expected everywhere. 1: differences. 2: could not run.
"""

import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

from harness.cases import Case, chosen_cases, json_at
from harness.commands import Outcome, answer, run
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

NAMED = ("DOC-005", "ROOT-003")
"""Rules of which a reader refuses the cases with a message that says for what."""
DAMAGE = ("SHARD-001", "SHARD-002", "SHARD-003", "SHARD-005", "IMG-005", "SAFE-001", "SAFE-002")
"""Rules of which it refuses the cases: what it would give is not what was written."""


def judge(case: Case, *, options: Options) -> list[Difference]:
    """Run the reader on one case."""
    found = run(options.command, [str(case.store)], options.timeout_s)
    if case.findings:
        return list(_refusal(case, found))
    if case.dump is None:
        return [Difference(case.name, "answer", "the case has no dump.json")]
    if found.code != 0:
        ended = "did not end" if found.code is None else f"ended with {found.code}"
        return [Difference(case.name, "answer", f"the reader {ended}: {found.last_line}")]
    try:
        dump = answer(found.stdout)
    except ValueError as error:
        return [Difference(case.name, "answer", f"no JSON: {error}")]
    return [Difference(case.name, "dump", line) for line in differences(case.dump, dump)]


def _refusal(case: Case, found: Outcome) -> Iterator[Difference]:
    if found.code != 1:
        yield Difference(case.name, "exit code", f"expected 1, found {found.code}")
    elif not found.last_line:
        yield Difference(case.name, "message", "stderr does not say why")
    for name in _to_be_named(case):
        if name not in found.stderr:
            detail = f"does not name {name}: {found.last_line}"
            yield Difference(case.name, "message", detail)


def _to_be_named(case: Case) -> Iterator[str]:
    """Yield the version or the entry of ``requires`` for which a case is refused."""
    for finding in case.findings:
        if finding["code"] in NAMED:
            store = case.store / finding["episode"] if finding["episode"] else case.store
            value: Any = json_at(store, finding["path"], finding["pointer"])
            yield str(value)


def main() -> int:
    """Run the program."""
    options = read_options(options_parser(__doc__ or "").parse_args())
    cases = chosen_cases(options.corpus, only=options.only, side="valid")
    refused = chosen_cases(options.corpus, only=options.only, side="invalid")
    cases += [case for case in refused if case.folder.name.startswith(NAMED + DAMAGE)]
    try:
        found = each(partial(judge, options=options), cases, options.jobs)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return COULD_NOT_RUN
    return finish(options, [case.name for case in cases], found)


if __name__ == "__main__":
    sys.exit(main())
