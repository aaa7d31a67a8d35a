#!/usr/bin/env python3
"""Judge many stores in one process: what ``run_validator.py --batch`` asks of a validator.

Prints one line of JSON for each path, in their order, as soon as it is judged.
"""

import argparse
import json
import sys
from pathlib import Path

from exumi_data.errors import ExumiError
from exumi_validators import validate


def answer(path: Path) -> str:
    """Return the report of a store with its exit code, as one line."""
    try:
        report = validate(path, workers=1)
    except (ExumiError, OSError) as error:
        sys.stderr.write(f"{path}: {error}\n")
        return json.dumps({"exit_code": 2})
    return json.dumps(report.to_dict() | {"exit_code": report.exit_code})


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    for path in parser.parse_args().paths:
        sys.stdout.write(answer(path) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
