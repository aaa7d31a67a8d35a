"""Pictures and figures of the documentation are what their scripts make."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"


@pytest.mark.parametrize("script", ["draw_format.py", "performance_page.py"])
def test_what_is_there_is_what_the_script_makes(script: str) -> None:
    command = [sys.executable, str(ROOT / "scripts" / script), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_results_are_those_of_benchmarks() -> None:
    files = sorted(RESULTS.glob("*.json"))
    assert len(files) > 10
    text = (ROOT / "docs" / "performance.md").read_text()
    for path in files:
        result = json.loads(path.read_text())
        assert (ROOT / "benchmarks" / f"{result['benchmark']}.py").is_file(), path.name
        assert f"`{result['benchmark']}.py`" in text, f"{path.name} is not on the page"
