"""The example of a lab's own checks is built, installed, and keeps its own tests."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "house_rules"


def test_its_tests_pass_where_it_is_installed(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLE, tmp_path / "source")  # building writes into the source
    build = ("-m", "build", "--wheel", "--no-isolation", "--skip-dependency-check")
    subprocess.run(
        [sys.executable, *build, str(tmp_path / "source")],
        check=True,
        capture_output=True,
        timeout=200,
    )
    (wheel,) = (tmp_path / "source" / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    path = os.pathsep.join(
        filter(None, (str(tmp_path / "installed"), os.environ.get("PYTHONPATH")))
    )
    folders = ("--rootdir", str(tmp_path), "--basetemp", str(tmp_path / "made"))
    options = ("-q", "-p", "no:cacheprovider", "-W", "error", *folders)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(EXAMPLE / "tests")],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 passed" in done.stdout
