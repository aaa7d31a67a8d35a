"""Runs the Python blocks of a page in one process, each as a program of its own.

A process each would spend most of its time on importing the same libraries again. Reads a block as
a JSON string a line, runs it in a namespace of its own, and prints a line that says so; ends with a
traceback at the first that fails.
"""

import json
import sys
from types import ModuleType

DONE = "--- the block is done ---"


def main() -> None:
    sys.path[0] = ""  # as for `python -c`
    for line in sys.stdin:
        program = sys.modules["__main__"] = ModuleType("__main__")
        exec(compile(json.loads(line), "<block>", "exec"), vars(program))  # noqa: S102  # our pages
        print(DONE, flush=True)


if __name__ == "__main__":
    main()
