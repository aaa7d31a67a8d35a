"""The example of an extension is built, installed, and keeps its own tests."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "extension_thermal"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the built package is installed, in a folder of its own."""
    folder = tmp_path_factory.mktemp("thermal")
    shutil.copytree(EXAMPLE, folder / "source")  # building writes into the source
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--skip-dependency-check",
    ]
    subprocess.run([*command, str(folder / "source")], check=True, capture_output=True, timeout=200)
    (wheel,) = (folder / "source" / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "installed")
    known = os.environ.get("PYTHONPATH", "")
    path = os.pathsep.join(filter(None, (str(folder / "installed"), known)))
    return {**os.environ, "PYTHONPATH": path}


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
    # Folders of its own: pytest otherwise tidies up what other runs left.
    folders = ("--rootdir", tmp_path, "--basetemp", tmp_path / "made")
    options = ("-q", "-p", "no:cacheprovider", "-W", "error", *folders)
    done = run(environment, "-m", "pytest", *options, EXAMPLE / "tests")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 passed" in done.stdout


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
