#!/usr/bin/env python3
"""Write the conformance corpus, or check that it is what this program writes.

Without ``--check`` it writes; with it, it compares, and returns 1 if anything differs.
"""

import argparse
import json
import shutil
import sys
from pathlib import Path

from corpus.all_cases import invalid, valid
from corpus.case import Case
from corpus.descriptions import describable, description
from corpus.edits import edits

HERE = Path(__file__).resolve().parent
VERSION = "1.0"


def expected(case: Case) -> bytes:
    """Return a case's ``expected.json``."""
    document = {
        "about": case.about,
        "store": case.store,
        "findings": [finding.to_dict() for finding in case.findings],
    }
    return (json.dumps(document, indent=1, ensure_ascii=True) + "\n").encode()


def corpus() -> dict[str, bytes]:
    """Return every file of the corpus, by its path below the folder of the version."""
    found: dict[str, bytes] = {}
    for side, cases in (("valid", valid()), ("invalid", invalid())):
        for case in cases:
            files = {"expected.json": expected(case), **case.output()}
            found |= {f"{side}/{case.name}/{path}": data for path, data in files.items()}
    for case in valid():
        if describable(case):
            files = description(case)
            found |= {f"writing/{case.name}/{path}": data for path, data in files.items()}
    for edit in edits():
        found |= {f"editing/{edit.name}/{path}": data for path, data in edit.output().items()}
    return found


def write(target: Path) -> None:
    """Write the corpus in place of what is there."""
    wanted = corpus()
    dumps = {path: (target / path).read_bytes() for path in _dumps(target, wanted)}
    if target.exists():
        shutil.rmtree(target)
    for path, data in (wanted | dumps).items():
        file = target / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)


def _dumps(target: Path, wanted: dict[str, bytes]) -> set[str]:
    """Return the dumps of valid cases, which ``make_dumps.py`` writes and checks."""
    there = {path.relative_to(target) for path in target.glob("valid/*/dump.json")}
    return {
        path.as_posix() for path in there if f"{path.parent.as_posix()}/expected.json" in wanted
    }


def differences(target: Path) -> list[str]:
    """Return the paths that are missing, too many or different."""
    wanted = corpus()
    there = {p.relative_to(target).as_posix() for p in target.rglob("*") if p.is_file()}
    there -= _dumps(target, wanted)
    changed = {path for path in there & set(wanted) if (target / path).read_bytes() != wanted[path]}
    return sorted((set(wanted) ^ there) | changed)


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    parser.add_argument("--target", type=Path, default=HERE / VERSION, help="folder to write to")
    arguments = parser.parse_args()
    if not arguments.check:
        write(arguments.target)
        return 0
    wrong = differences(arguments.target)
    for path in wrong[:20]:
        sys.stderr.write(f"differs: {path}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
