#!/usr/bin/env python3
"""Judge a writer: give it described episodes to write, and judge what it wrote.

What it wrote is judged by a validator, and compared with the corpus: the metadata it was given, the
arrays, the frames' files. The protocol is in ``spec/conformance/README.md``.
Exit code 0: as expected everywhere. 1: differences. 2: could not run.
"""

import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from harness.cases import chosen_descriptions, json_at
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
from harness.written import (
    JudgementError,
    Judges,
    NotSupportedError,
    add_judges,
    chosen_judges,
    content,
    lost,
    written_by,
)


def described(document: dict[str, Any]) -> dict[str, Any]:
    """Return what has to be found in the root's document."""
    streams = {
        stream["name"]: {"kind": stream["kind"], **stream["fields"]}
        for stream in document["streams"]
    }
    return {**document["episode"], "streams": streams}


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
        try:
            written = written_by(self.options.command, [str(case)], target, self.options.timeout_s)
            return list(self._judged(case, written))
        except NotSupportedError:
            self.not_supported.append(case.name)
            return []
        except JudgementError as error:
            return [Difference(case.name, error.what, str(error))]

    def _judged(self, case: Path, written: Path) -> Iterator[Difference]:
        for _, line in self.judges.problems(written):
            yield Difference(case.name, "invalid", line)
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
    add_judges(parser)
    parsed = parser.parse_args()
    options, judges = read_options(parsed), chosen_judges(parsed)
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
