"""Build the sdist, build the wheel from it, install it alone, and look at what a user then has.

Nothing here touches the working tree. The fresh environment gets the core dependencies only:
PyTorch must not be needed to import any of the five packages.
"""

import os
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = {
    "exumi_data": ROOT / "exumi_data",
    "exumi_converters": ROOT / "converters" / "exumi_converters",
    "exumi_validators": ROOT / "validators" / "exumi_validators",
    "exumi_loaders": ROOT / "loaders" / "exumi_loaders",
    "exumi_recorders": ROOT / "recorders" / "exumi_recorders",
}
INSTALL_TRAIN = 'pip install "exumi-data[train]"'

# Each runs in the fresh environment, in an interpreter of its own.
CHECKS = {
    "torch is not installed": """
import importlib.util
assert importlib.util.find_spec("torch") is None, "torch came with the core dependencies"
""",
    "import exumi_data loads numpy and pydantic, nothing heavy": """
import sys
import exumi_data
heavy = {"scipy", "zarr", "pyarrow", "cv2", "av", "torch", "typer", "rich"} & set(sys.modules)
assert not heavy, f"import exumi_data loads {sorted(heavy)}"
""",
    "the five packages import, from the installed wheel": f"""
import importlib, sys
for name in {sorted(PACKAGES)!r}:
    module = importlib.import_module(name)
    assert module.__file__.startswith(sys.prefix), f"{{name}} comes from {{module.__file__}}"
""",
    "the metadata's version is the package's": """
import importlib.metadata, exumi_data
assert importlib.metadata.version("exumi-data") == exumi_data.__version__
""",
    "exumi_loaders.TPPWindows says in one line how to get torch": f"""
import exumi_loaders
try:
    exumi_loaders.TPPWindows("no such dataset")
except ImportError as error:
    message = str(error)
else:
    raise SystemExit("TPPWindows was made without torch")
assert {INSTALL_TRAIN!r} in message and "\\n" not in message, message
""",
}


class CheckFailedError(Exception):
    """The wheel is not what it should be."""


def run(command: list[str], *, where: Path) -> str:
    """Run a program and return what it printed.

    Parameters
    ----------
    command : list of str
        Program and arguments.
    where : pathlib.Path
        Folder to run it in.

    Returns
    -------
    str
        Its standard output.

    Raises
    ------
    CheckFailedError
        If it fails; with all that it printed.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL"))}
    done = subprocess.run(
        command, cwd=where, env=environment, check=False, capture_output=True, text=True
    )
    if done.returncode:
        raise CheckFailedError(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout


def build(target: Path) -> Path:
    """Build the sdist, and the wheel from the sdist.

    Parameters
    ----------
    target : pathlib.Path
        Folder for the two.

    Returns
    -------
    pathlib.Path
        The wheel.
    """
    # Without isolation: hatchling is pinned in this environment.
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(target), str(ROOT)]
    run(command, where=target)
    wheels = list(target.glob("*.whl"))
    if len(wheels) != 1:
        raise CheckFailedError(f"expected one wheel, found {[w.name for w in wheels]}")
    return wheels[0]


def check_content(wheel: Path) -> None:
    """Compare what is in the wheel with what should be.

    Parameters
    ----------
    wheel : pathlib.Path
        The wheel.

    Raises
    ------
    CheckFailedError
        If a top-level name is missing or too many, or a file of a package was not packed.
    """
    version = wheel.name.split("-")[1]
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
    expected = {*PACKAGES, f"exumi_data-{version}.dist-info"}
    found = {name.split("/")[0] for name in packed}
    if found != expected:
        raise CheckFailedError(f"top-level names are {sorted(found)}, expected {sorted(expected)}")
    present = {
        f"{name}/{path.relative_to(folder).as_posix()}"
        for name, folder in PACKAGES.items()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.name[0] != "."
    }
    markers = {f"{name}/{file}" for name in PACKAGES for file in ("__init__.py", "py.typed")}
    if missing := (present | markers) - packed:
        raise CheckFailedError(f"not in the wheel: {sorted(missing)}")


def install(wheel: Path, target: Path) -> Path:
    """Install the wheel, with its core dependencies only, into a new environment.

    Parameters
    ----------
    wheel : pathlib.Path
        The wheel.
    target : pathlib.Path
        Folder for the environment.

    Returns
    -------
    pathlib.Path
        The folder of the environment's programs.
    """
    venv.create(target, with_pip=True)
    programs = target / ("Scripts" if os.name == "nt" else "bin")
    options = ["--quiet", "--disable-pip-version-check", "-c", str(ROOT / "constraints.txt")]
    run([str(programs / "python"), "-m", "pip", "install", *options, str(wheel)], where=target)
    return programs


def check_installed(programs: Path, empty: Path) -> None:
    """Run the checks in the environment, from a folder that holds nothing to import.

    Parameters
    ----------
    programs : pathlib.Path
        The folder of the environment's programs.
    empty : pathlib.Path
        An empty folder.
    """
    for title, code in CHECKS.items():
        run([str(programs / "python"), "-I", "-c", code], where=empty)
        print(f"ok  {title}", flush=True)
    for arguments in (["--help"], ["--version"]):
        run([str(programs / "exumi"), *arguments], where=empty)
        print(f"ok  exumi {arguments[0]}", flush=True)


def main() -> int:
    """Check the wheel.

    Returns
    -------
    int
        0 if all is well, 1 with the reason on stderr if not.
    """
    with tempfile.TemporaryDirectory(prefix="exumi-wheel-") as folder:
        work = Path(folder).resolve()
        (work / "dist").mkdir()
        (work / "empty").mkdir()
        try:
            wheel = build(work / "dist")
            check_content(wheel)
            print(f"ok  {wheel.name}, built from the sdist, holds the five packages", flush=True)
            check_installed(install(wheel, work / "venv"), work / "empty")
        except CheckFailedError as failure:
            print(f"FAILED  {failure}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
