"""Builds an example's package, installs it in a folder of its own, and runs its tests there."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

__all__ = ["installed", "run_its_tests"]


def installed(example: Path, folder: Path) -> dict[str, str]:
    """Build and install an example; return an environment in which it is found."""
    shutil.copytree(example, folder / "source")  # building writes into the source
    build = ("-m", "build", "--wheel", "--no-isolation", "--skip-dependency-check")
    subprocess.run(
        [sys.executable, *build, str(folder / "source")],
        check=True,
        capture_output=True,
        timeout=200,
    )
    (wheel,) = (folder / "source" / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "installed")
    known = os.environ.get("PYTHONPATH", "")
    path = os.pathsep.join(filter(None, (str(folder / "installed"), known)))
    return {**os.environ, "PYTHONPATH": path}


def run_its_tests(example: Path, environment: dict[str, str], folder: Path) -> str:
    """Run the tests of an example, which must pass; return what pytest says."""
    # Folders of its own: pytest otherwise tidies up what other runs left.
    folders = ("--rootdir", str(folder), "--basetemp", str(folder / "made"))
    options = ("-q", "-p", "no:cacheprovider", "-W", "error", *folders)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(example / "tests")],
        env=environment,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
