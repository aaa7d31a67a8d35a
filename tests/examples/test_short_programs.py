"""The short programs run as they stand, and do what they say."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import exumi_data

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str, *arguments: object) -> str:
    # What is made on the way lies in a temporary folder of the test's.
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / name), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "PYTHON_CPU_COUNT": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_clips_become_a_network_that_feels(tmp_path: Path) -> None:
    said = run("convert_and_train.py", tmp_path / "work", "--parts", 15, "--epochs", 8)
    assert "45 episodes, valid: True" in said
    assert "36 clips to train on, 9 of parts that were never touched" in said
    found = re.search(r"the network is ([\d.]+) off, and the same rating .* ([\d.]+)\n", said)
    assert found is not None
    assert float(found[1]) < float(found[2])


def test_episodes_are_recorded(tmp_path: Path) -> None:
    said = run("record_simulated.py", tmp_path / "recorded", "--seconds", 1.5)
    assert said.endswith("\nvalid\n")
    (episode,) = exumi_data.open(tmp_path / "recorded")
    assert isinstance(episode, exumi_data.Episode)
    for name in episode:
        assert re.search(rf"^  {name} .* samples", said, re.MULTILINE)
    assert json.loads(episode.metadata.model_dump_json())["task"]["name"] == "stack the cups"


def test_an_object_is_taught(tmp_path: Path) -> None:
    said = run("teach_object.py")
    assert "36 clips of 9 parts are known; part_09 is not." in said
    assert "One clip taught: Most similar objects (in order of decreasing similarity): our " in said
    assert "Of 3 other clips of it, 3 are called by its name." in said
    assert "our part_09" not in said[said.index("Forgotten") :]
