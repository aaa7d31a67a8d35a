#!/usr/bin/env python3
"""Write the canonical dump of every valid case of the corpus, or check those that are there.

Without ``--check`` it writes; with it, it compares, and returns 1 if anything differs. Decoders of
JPEG differ by a little: a dump that agrees as dumps have to agree is left as it is.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from harness.cases import CORPUS, Case, chosen_cases
from harness.dumps import differences

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "readers"))

from dump import dump_store  # the reader beside this folder


def outdated(case: Case, dump: dict[str, Any]) -> list[str]:
    """Return where the stored dump of a case differs from what is read."""
    stored = case.dump
    return ["no dump.json"] if stored is None else list(differences(stored, dump))


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    parser.add_argument("--target", type=Path, default=CORPUS, help="folder of the corpus")
    arguments = parser.parse_args()
    wrong = 0
    for case in chosen_cases(arguments.target, only=[], side="valid"):
        dump = dump_store(case.store)
        lines = outdated(case, dump)
        if not lines:
            continue
        if arguments.check:
            wrong += 1
            sys.stderr.write(f"differs: {case.name}/dump.json: {lines[0]}\n")
        else:
            text = json.dumps(dump, indent=1, ensure_ascii=True) + "\n"
            (case.folder / "dump.json").write_text(text, "utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
