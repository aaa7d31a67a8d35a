"""The example of an extension is built, installed, and keeps its own tests."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.examples.installing import installed, run_its_tests

EXAMPLE = Path(__file__).parents[2] / "examples" / "extension_thermal"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the built package is installed, in a folder of its own."""
    return installed(EXAMPLE, tmp_path_factory.mktemp("thermal"))


def run(environment: dict[str, str], *command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, command)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


def test_its_tests_pass(environment: dict[str, str], tmp_path: Path) -> None:
    assert "6 passed" in run_its_tests(EXAMPLE, environment, tmp_path)


def test_what_it_writes_is_validated_with_it_and_without(
    environment: dict[str, str], tmp_path: Path
) -> None:
    episode = tmp_path / "warm.zarr"
    assert run(environment, "-m", "acme_thermal.recording", episode).returncode == 0
    command = ("-m", "exumi_data.cli", "validate", episode, "--format", "json", "--no-config")
    done = run(environment, *command)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert [item["distribution"] for item in report["extensions"]] == ["acme-thermal"] * 2
    assert report["coverage"]["skipped"] == []
    without = json.loads(run(dict(os.environ), *command).stdout)
    assert without["valid"]
    assert without["extensions"] == []
    assert without["coverage"]["rules"] == report["coverage"]["rules"] - 2
    (skipped,) = without["coverage"]["skipped"]
    assert skipped["reason"] == "no installed package describes acme:thermal 1"


def test_a_second_run_says_what_to_do(environment: dict[str, str], tmp_path: Path) -> None:
    command = ("-m", "acme_thermal.recording", tmp_path / "warm.zarr")
    assert run(environment, *command).returncode == 0
    again = run(environment, *command)
    assert again.returncode == 2
    assert again.stderr.startswith("error: ")
    assert "already exists" in again.stderr
    assert "Traceback" not in again.stderr
