#!/usr/bin/env python3
"""Judge a writer: give it described episodes to write, and judge what it wrote.

What it wrote is judged by a validator, and compared with the corpus: the metadata it was given, the
arrays, the frames' files. The protocol is in ``spec/conformance/README.md``.
Exit code 0: as expected everywhere. 1: differences. 2: could not run.
"""

import json
import shlex
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.cases import chosen_descriptions, json_at
from harness.commands import answer, command_line, run
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

NOT_SUPPORTED = 3
OURS = Path(__file__).resolve().parents[1] / "readers" / "dump.py"


class JudgementError(Exception):
    """The validator or the reader that is to judge failed."""


@dataclass(frozen=True)
class Judges:
    """The commands that judge what was written."""

    validator: list[str]
    reader: list[str]
    timeout_s: float

    def problems(self, store: Path) -> Iterator[str]:
        """Yield what the validator finds."""
        outcome = run(self.validator, [str(store)], self.timeout_s)
        try:
            found: list[dict[str, Any]] = answer(outcome.stdout)["problems"]
        except (ValueError, KeyError):
            msg = f"the validator gives no report: {outcome.last_line}"
            raise JudgementError(msg) from None
        for problem in found:
            place = problem["location"]
            yield f"{problem['code']} @ {place['path']}: {problem.get('message', '')}"

    def dump(self, store: Path) -> dict[str, Any]:
        """Return the canonical dump of what was written."""
        outcome = run(self.reader, [str(store)], self.timeout_s)
        if outcome.code != 0:
            raise JudgementError(f"the reader refuses {store.name}: {outcome.last_line}")
        dump: dict[str, Any] = answer(outcome.stdout)
        return dump


def content(dump: dict[str, Any]) -> dict[str, Any]:
    """Return what of a dump is no choice of the writer, streams in order of their names."""
    # A newer minor version is welcome, and chunks, which the digest shows, are free.
    kept = {key: value for key, value in dump.items() if key not in ("version", "digest")}
    return kept | {"streams": sorted(dump["streams"], key=lambda stream: str(stream["name"]))}


def described(document: dict[str, Any]) -> dict[str, Any]:
    """Return what has to be found in the root's document."""
    streams = {
        stream["name"]: {"kind": stream["kind"], **stream["fields"]}
        for stream in document["streams"]
    }
    return {**document["episode"], "streams": streams}


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


class WriterJudge:
    """Runs a writer on descriptions, and judges what it wrote."""

    def __init__(self, options: Options, judges: Judges, folder: Path) -> None:
        self.options = options
        self.judges = judges
        self.folder = folder
        self.not_supported: list[str] = []

    def __call__(self, case: Path) -> list[Difference]:
        """Judge one description."""
        target = self.folder / case.name / "episode.zarr"
        target.parent.mkdir()
        outcome = run(self.options.command, [str(case), str(target)], self.options.timeout_s)
        if outcome.code == NOT_SUPPORTED:
            self.not_supported.append(case.name)
            return []
        if outcome.code != 0:
            ended = "did not end" if outcome.code is None else f"ended with {outcome.code}"
            return [Difference(case.name, "answer", f"the writer {ended}: {outcome.last_line}")]
        written = next((p for p in (target, target.with_suffix(".zarr.zip")) if p.exists()), None)
        if written is None:
            return [Difference(case.name, "answer", "the writer wrote nothing")]
        try:
            return list(self._judged(case, written))
        except JudgementError as error:
            return [Difference(case.name, "unreadable", str(error))]

    def _judged(self, case: Path, written: Path) -> Iterator[Difference]:
        for problem in self.judges.problems(written):
            yield Difference(case.name, "invalid", problem)
        document = json.loads((case / "description.json").read_bytes())
        root = json_at(written, "zarr.json", "/attributes/exumi")
        for line in lost(described(document), root, "$"):
            yield Difference(case.name, "metadata", line)
        model = json.loads((case.parents[1] / "valid" / case.name / "dump.json").read_bytes())
        for line in differences(content(model), content(self.judges.dump(written))):
            yield Difference(case.name, "content", line)


def main() -> int:
    """Run the program."""
    parser = options_parser(__doc__ or "")
    default = "exumi validate --format json"
    parser.add_argument("--validator", type=command_line, default=default)
    parser.add_argument(
        "--reader", type=command_line, default=shlex.join([sys.executable, str(OURS)])
    )
    parsed = parser.parse_args()
    options = read_options(parsed)
    judges = Judges(parsed.validator, parsed.reader, options.timeout_s)
    cases = chosen_descriptions(options.corpus, only=options.only)
    try:
        with tempfile.TemporaryDirectory(prefix="exumi-writer-") as folder:
            judge = WriterJudge(options, judges, Path(folder))
            found = each(judge, cases, options.jobs)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return COULD_NOT_RUN
    names = [case.name for case in cases]
    return finish(options, names, found, not_supported=sorted(judge.not_supported))


if __name__ == "__main__":
    sys.exit(main())
