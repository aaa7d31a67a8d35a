#!/usr/bin/env python3
"""Judge an editor: give it finished episodes and small changes to make, and look what survived.

Everything that was not to be changed has to be there again: keys of newer versions and of third
parties, arrays, frames, derived arrays. The protocol is in ``spec/conformance/README.md``.
Exit code 0: as expected everywhere. 1: differences. 2: could not run.
"""

import copy
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from harness.cases import chosen_edits, json_at
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

ROOT = ("zarr.json", "/attributes/exumi")
DERIVED = ("derived/zarr.json", "/attributes/exumi")


class Edit:
    """One change of one episode.

    Parameters
    ----------
    folder : pathlib.Path
        That of ``edit.json``.
    corpus : pathlib.Path
    """

    def __init__(self, folder: Path, corpus: Path) -> None:
        self.name = folder.name
        self.file = folder / "edit.json"
        self.document: dict[str, Any] = json.loads(self.file.read_bytes())
        self.source = corpus / str(self.document["source"])

    @cached_property
    def expected(self) -> dict[str, Any]:
        """What has to be found in the root's document: changed as asked, one revision later."""
        document: dict[str, Any] = copy.deepcopy(json_at(self.source, *ROOT))
        for change in self.document["set"]:
            put(document, change["pointer"], change["value"])
        document["revision"] = document.get("revision", 1) + 1
        return document


def put(document: Any, pointer: str, value: Any) -> None:
    """Put a value at a JSON pointer: into an object, or with ``-`` at the end of a list."""
    *parents, last = (part.replace("~1", "/").replace("~0", "~") for part in pointer.split("/")[1:])
    for part in parents:
        document = document[int(part)] if isinstance(document, list) else document[part]
    if isinstance(document, list):
        document.append(value)
    else:
        document[last] = value


def derived_of(store: Path) -> dict[str, Any] | None:
    """Return what is said of an episode's derived arrays, None where it has none."""
    try:
        found: dict[str, Any] = json_at(store, *DERIVED)
    except (FileNotFoundError, KeyError):  # of a folder, of a zip
        return None
    return found


class EditorJudge:
    """Runs an editor on copies of episodes, and judges what it made of them."""

    def __init__(self, options: Options, judges: Judges, folder: Path) -> None:
        self.options = options
        self.judges = judges
        self.folder = folder
        self.not_supported: list[str] = []

    def __call__(self, edit: Edit) -> list[Difference]:
        """Judge one edit."""
        source = self.folder / edit.name / "source" / edit.source.name
        target = self.folder / edit.name / "target" / "episode.zarr"
        for parent in (source.parent, target.parent):
            parent.mkdir(parents=True)
        copied = shutil.copytree if edit.source.is_dir() else shutil.copyfile
        copied(edit.source, source)
        arguments = [str(source), str(edit.file)]
        found: list[Difference] = []
        try:
            written = written_by(self.options.command, arguments, target, self.options.timeout_s)
            for difference in self._judged(edit, source, written):
                found.append(difference)  # noqa: PERF402  # what was found before a judge failed stays
        except NotSupportedError:
            self.not_supported.append(edit.name)
        except JudgementError as error:
            found.append(Difference(edit.name, error.what, str(error)))
        return found

    def _judged(self, edit: Edit, source: Path, written: Path) -> Iterator[Difference]:
        if files(source) != files(edit.source):
            yield Difference(edit.name, "source", "the episode that was given is another one now")
        for line in lost(edit.expected, json_at(written, *ROOT), "$"):
            yield Difference(edit.name, "metadata", line)
        for line in lost(derived_of(edit.source), derived_of(written), "derived: $"):
            yield Difference(edit.name, "metadata", line)
        problems = list(self.judges.problems(written))
        known = {place for place, _ in self.judges.problems(edit.source)} if problems else set()
        for place, line in problems:
            if place not in known:
                yield Difference(edit.name, "invalid", line)
        before, after = (self.judges.dump(store) for store in (edit.source, written))
        for line in differences(content(before), content(after)):
            yield Difference(edit.name, "content", line)


def files(store: Path) -> dict[str, bytes]:
    """Return all files of an episode; a packed one is one file."""
    if store.is_file():
        return {"": store.read_bytes()}
    paths = (path for path in store.rglob("*") if path.is_file())
    return {path.relative_to(store).as_posix(): path.read_bytes() for path in paths}


def main() -> int:
    """Run the program."""
    parser = options_parser(__doc__ or "")
    add_judges(parser)
    parsed = parser.parse_args()
    options, judges = read_options(parsed), chosen_judges(parsed)
    edits = [Edit(path, options.corpus) for path in chosen_edits(options.corpus, only=options.only)]
    try:
        with tempfile.TemporaryDirectory(prefix="exumi-editor-") as folder:
            judge = EditorJudge(options, judges, Path(folder))
            found = each(judge, edits, options.jobs)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return COULD_NOT_RUN
    names = [edit.name for edit in edits]
    return finish(options, names, found, not_supported=sorted(judge.not_supported))


if __name__ == "__main__":
    sys.exit(main())
