"""The public names are the recorded ones: they come and go on purpose (``make public-api``)."""

import subprocess
import sys
from pathlib import Path


def test_the_public_names_are_those_on_record(root: Path) -> None:
    command = [sys.executable, str(root / "scripts" / "public_api.py")]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    recorded = root / "tests" / "house" / "public_api.txt"
    assert recorded.is_file(), "nothing is on record: make public-api"
    names = recorded.read_text("utf-8").splitlines()
    assert done.stdout.splitlines() == names, "if that is on purpose: make public-api"
