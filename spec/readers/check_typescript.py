#!/usr/bin/env python3
"""Install and build the second reader, and run it on the corpus and the frozen files.

Where Node.js is not installed, it says so and does nothing; with ``--require`` that is a failure.
Exit code 0: alike, or nothing done. 1: differences, or it could not be built or run.
"""

import argparse
import re
import shutil
import subprocess
import sys
from pathlib import Path

SPEC = Path(__file__).resolve().parents[1]
READER = SPEC / "readers" / "typescript"
OLDEST_NODE = 20


def node_version() -> int:
    """Return the major version of Node.js, 0 where there is none."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return 0
    done = subprocess.run(["node", "--version"], check=True, capture_output=True, text=True)  # noqa: S607  # the user's own
    found = re.match(r"v(\d+)", done.stdout)
    return int(found[1]) if found else 0


def build() -> None:
    """Install what `package-lock.json` pins, and compile."""
    for command in (["npm", "ci", "--no-audit", "--no-fund"], ["npm", "run", "build", "--silent"]):
        subprocess.run(command, cwd=READER, check=True)  # noqa: S603  # the user's own npm


def compare(*options: str) -> int:
    """Run the harness for readers."""
    harness = SPEC / "conformance" / "run_reader.py"
    reader = ["node", str(READER / "dist" / "main.js")]
    command = [sys.executable, str(harness), *options, "--", *reader]
    return subprocess.run(command, check=False).returncode  # noqa: S603  # our own program


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--require", action="store_true", help="fail where Node.js is missing")
    required = parser.parse_args().require
    if node_version() < OLDEST_NODE:
        sys.stderr.write(
            f"{'FAILED' if required else 'SKIPPED'}: the second reader needs Node.js "
            f"{OLDEST_NODE} or newer, with npm; it was not run\n"
        )
        return 1 if required else 0
    try:
        build()
    except subprocess.CalledProcessError as error:
        sys.stderr.write(f"the second reader cannot be built: {error}\n")
        return 1
    codes = [compare(), compare("--corpus", str(SPEC / "frozen" / "1.0"))]
    return max(codes)


if __name__ == "__main__":
    sys.exit(main())
