"""The program as a whole: help, version, exit codes, streams, colours, signals."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import av
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from exumi_data import __version__
from exumi_data.cli.app import app
from exumi_data.cli.failures import ReportingGroup
from exumi_data.dataset import create_dataset
from exumi_data.errors import ExumiError
from exumi_data.model import DatasetMetadata

Program = Callable[..., subprocess.CompletedProcess[str]]

VERBS = ("demo", "convert", "prepare", "calibrate", "index", "pack", "validate", "stats", "info")
COLOR = re.compile(r"\x1b\[[0-9;]*3[0-9]m")


def test_help_names_every_verb(exumi: Program) -> None:
    done = exumi("--help")
    assert done.returncode == 0
    assert done.stderr == ""
    for verb in VERBS:
        assert re.search(rf"^  {verb} ", done.stdout, re.MULTILINE)


@pytest.mark.parametrize("verb", VERBS)
def test_every_help_has_examples(verb: str) -> None:
    shown = CliRunner().invoke(app, [verb, "--help"])
    assert shown.exit_code == 0
    examples = shown.stdout.partition("Examples:\n")[2]
    assert f"exumi {verb}" in examples


def test_help_and_version_load_nothing_heavy(plain_environment: dict[str, str]) -> None:
    code = (
        "import sys\nfrom exumi_data.cli.app import app\n"
        "try:\n    app(['--help'])\nexcept SystemExit:\n    pass\n"
        "print(*{name.partition('.')[0] for name in sys.modules}, file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
        env=plain_environment,
    )
    heavy = {"numpy", "pydantic", "rich", "cv2", "zarr", "pyarrow", "torch", "av", "scipy"}
    assert heavy & set(done.stderr.split()) == set()


def test_version(exumi: Program) -> None:
    done = exumi("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"exumi-data {__version__} (format 1.0)\n"


@pytest.mark.parametrize(
    "arguments",
    [["statistics"], ["stats"], ["stats", "x", "--no-such-option"], ["stats", "x", "-f", "xml"]],
)
def test_wrong_arguments_exit_with_2(exumi: Program, arguments: list[str]) -> None:
    done = exumi(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "Traceback" not in done.stderr


def test_results_go_to_stdout_and_nothing_else_does(exumi: Program, dataset: Path) -> None:
    (dataset / "catalog.parquet").unlink()
    done = exumi("stats", dataset, "--format", "json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["episodes"] == 2
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("warning: ")
    assert f"exumi index {dataset}" in lines[0]


def test_no_colours_and_no_bars_in_files(exumi: Program, dataset: Path) -> None:
    for verb in ("stats", "info"):
        done = exumi(verb, dataset)
        assert "\x1b" not in done.stdout + done.stderr
        assert all(line == line.rstrip() for line in done.stdout.splitlines())
    failed = exumi("stats", dataset / "nothing")
    assert "\x1b" not in failed.stderr


def on_a_terminal(arguments: list[str], environment: dict[str, str]) -> tuple[int, str]:
    """Run the program on a terminal of its own; return exit code and all that it showed."""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "exumi_data.cli", *arguments],
        stdout=slave,
        stderr=slave,
        stdin=subprocess.DEVNULL,
        env={**environment, "TERM": "xterm-256color", "COLUMNS": "120"},
    )
    os.close(slave)
    shown = b""
    while True:
        try:
            piece = os.read(master, 4096)
        except OSError:  # what Linux says at the end
            break
        if not piece:
            break
        shown += piece
    os.close(master)
    return process.wait(60), shown.decode()


def test_colours_on_a_terminal(plain_environment: dict[str, str], dataset: Path) -> None:
    code, shown = on_a_terminal(["stats", str(dataset / "nothing")], plain_environment)
    assert code == 2
    assert COLOR.search(shown)


def test_no_color_is_respected(plain_environment: dict[str, str], dataset: Path) -> None:
    for arguments in (["stats", str(dataset)], ["stats", str(dataset / "nothing")]):
        _, shown = on_a_terminal(arguments, {**plain_environment, "NO_COLOR": "1"})
        assert not COLOR.search(shown)


def test_quiet_shows_no_bar_on_a_terminal(plain_environment: dict[str, str], dataset: Path) -> None:
    _, loud = on_a_terminal(["stats", str(dataset)], plain_environment)
    _, quiet = on_a_terminal(["stats", str(dataset), "--quiet"], plain_environment)
    assert "Measuring" in loud
    assert "Measuring" not in quiet


def test_a_closed_pipe_ends_the_program_quietly(
    plain_environment: dict[str, str], dataset: Path
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "exumi_data.cli", "stats", str(dataset), "--format", "json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=plain_environment,
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    complaints = process.stderr.read()
    process.stderr.close()
    assert process.wait(60) == 141
    assert complaints == ""


def failing_app(error: BaseException) -> typer.Typer:
    """A program of the same kind with one verb, which fails."""
    program = typer.Typer(cls=ReportingGroup, rich_markup_mode=None)

    @program.command()
    def fail() -> None:
        raise error

    @program.callback()
    def options() -> None:
        pass

    return program


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ExumiError("is odd", where="a.zarr", fix="Mend it."), 2, "error: a.zarr: is odd\n"),
        (PermissionError(13, "Permission denied", "b.zarr"), 2, "error: b.zarr: Permission denied"),
        (OSError(28, "No space left on device"), 2, "error: No space left on device\n"),
        (KeyboardInterrupt(), 130, "error: interrupted\n"),
        (ZeroDivisionError("[red]"), 70, "error: unexpected ZeroDivisionError: [red]\n"),
    ],
)
def test_what_every_error_becomes(error: BaseException, code: int, message: str) -> None:
    done = CliRunner().invoke(failing_app(error), ["fail"])
    assert done.exit_code == code
    assert done.stdout == ""
    assert done.stderr.startswith(message)
    assert "Traceback" not in done.stderr


def test_debugging_shows_the_traceback_too() -> None:
    done = CliRunner().invoke(
        failing_app(ZeroDivisionError("x")), ["fail"], env={"EXUMI_DEBUG": "1"}
    )
    assert done.exit_code == 70
    assert done.stderr.startswith("Traceback")
    assert "error: unexpected ZeroDivisionError: x\n" in done.stderr


def write_clip(path: Path, frames: int) -> None:
    random = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        for _ in range(frames):
            pixels = random.integers(0, 255, (240, 320, 3)).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())


CLIPS = 400


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Work for some ten seconds."""
    folder = tmp_path / "clips"
    folder.mkdir()
    write_clip(folder / "thing_0.mov", 150)
    original = (folder / "thing_0.mov").read_bytes()
    for number in range(1, CLIPS):
        (folder / f"thing_{number}.mov").write_bytes(original)
    return folder


def group_members(group: int) -> list[str]:
    """Names of the processes of a process group that are not dead."""
    listed = subprocess.run(
        ["ps", "-eo", "pgid=,stat=,args="], check=True, capture_output=True, text=True
    )
    rows = [line.split(maxsplit=2) for line in listed.stdout.splitlines()]
    return [row[2] for row in rows if int(row[0]) == group and not row[1].startswith("Z")]


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 128 + signal.SIGTERM)]
)
def test_a_signal_ends_it_cleanly(
    plain_environment: dict[str, str], clips: Path, tmp_path: Path, number: int, code: int
) -> None:
    target = tmp_path / "out"
    arguments = ["convert", str(clips), str(target), "--from", "clips", "--workers", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "exumi_data.cli", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=plain_environment,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while not list(target.glob("episodes/*/*.zarr")):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does: to all processes
    else:
        process.send_signal(number)
    _, complaints = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in complaints
    assert ("error: interrupted" in complaints) == (number == signal.SIGINT)
    while group_members(process.pid):
        assert time.monotonic() < deadline, group_members(process.pid)
        time.sleep(0.05)
    assert list(target.rglob(".partial-*")) == []
    assert 0 < len(list(target.glob("episodes/*/*.zarr"))) < CLIPS


def test_an_interrupt_before_anything_is_loaded(plain_environment: dict[str, str]) -> None:
    script = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'exumi_data.cli.app': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from exumi_data.cli import main\n"
        "main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], env=plain_environment, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (-signal.SIGINT, b"")


def test_it_runs_without_standard_streams(clips: Path) -> None:
    command = f"exec {sys.executable} -m exumi_data.cli validate {clips} >&- 2>&-"
    assert subprocess.run(["bash", "-c", command], check=False).returncode == 2


def test_letters_that_an_encoding_lacks_are_escaped(exumi: Program, tmp_path: Path) -> None:
    root = create_dataset(
        tmp_path / "gr€n\N{GRINNING FACE}", DatasetMetadata(name="x", licence="CC0-1.0")
    )
    poor = {"PYTHONIOENCODING": "ascii"}
    for verb in ("validate", "info"):
        done = exumi(verb, root, **poor)
        assert done.returncode == 0, done.stderr
        assert r"gr\u20acn\U0001f600" in done.stdout
        told = json.loads(exumi(verb, root, "--format", "json", **poor).stdout)
        assert told["path"] == str(root)
    junit = exumi("validate", root, "--format", "junit", **poor).stdout
    assert ET.fromstring(junit)[0].attrib["name"] == str(root)  # noqa: S314  # our own
