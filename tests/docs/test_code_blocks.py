"""Every code block of the documentation runs as it stands, in the order of its page.

A page's blocks share one folder, which holds `my-clips` (three short tactile videos), `my-touches`
(six of three parts, with a table of labels), `my-session` (a raw exUMI session) and, where a page
does not make it itself, `demo/dataset` (simulated play). Blocks of
Python are programs of their own in one process, which imports only once what they use. A block that
is not run says why in an HTML comment on the line above: ``<!-- not run: reason -->``.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Self

import numpy as np
import pytest

from exumi_data.demo import DemoSettings, write_play_dataset
from exumi_data.simulation.hub_session import HubSettings, simulate_hub_session

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(
    r"(?P<skip><!-- not run: .+? -->\n)?^```(?P<language>\w+)\n(?P<code>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
SKIPPED = re.compile(r"^<!-- not run: .+? -->\n```.*?^```$", re.DOTALL | re.MULTILINE)
RUN = ("bash", "python")
SHOWN = ("text", "json", "toml", "csv", "bibtex")
TIMEOUT_S = 240
# What python_blocks.py prints after a block.
DONE = "--- the block is done ---"


def press(number: int, frames: int = 60) -> np.ndarray:
    """A blob that is pressed into a gel and let go, (N, 64, 80, 3) uint8."""
    y, x = np.mgrid[0:64, 0:80].astype(np.float32)
    depth = np.clip(np.sin(np.linspace(-0.5, 3.6, frames)), 0, 1)
    blob = np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / (60 + 40 * number))
    shade = depth[:, None, None] * blob * 70
    base = np.stack((100 + x / 4, 110 + y / 4, 120 - x / 4), axis=-1)
    return np.asarray(np.clip(base + shade[..., None], 0, 255), np.uint8)


def write_video(path: Path, number: int) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 80, 64, "yuv420p"
        for image in press(number):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clips") / "my-clips"
    folder.mkdir()
    for number in range(3):
        write_video(folder / f"ball_{number}.mov", number)
    return folder


@pytest.fixture(scope="module")
def touches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("touches") / "my-touches"
    folder.mkdir()
    for number, part in enumerate(("brush_handle", "brush_bristles", "sponge")):
        for trial in range(2):
            write_video(folder / f"{part}_{trial}.mov", 2 * number + trial)
    (folder / "labels.csv").write_text(
        "part_id,object,hardness_0_10,roughness_0_10,adjectives\n"
        "brush_handle,a brush,8.67,1.33,hard|smooth\n"
        "brush_bristles,a brush,4.33,7,prickly\n"
        "sponge,a sponge,1.33,,soft|springy\n"
    )
    return folder


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("session") / "my-session"
    settings = HubSettings(seconds=4.0, sweep_s=0.0, tactile_size=(72, 96))
    simulate_hub_session(folder, settings, demonstrations=2)
    return folder


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "dataset"
    write_play_dataset(folder, DemoSettings(seconds=3.0), workers=1)
    return folder


def test_there_are_pages_and_blocks() -> None:
    assert sum(len(BLOCK.findall(page.read_text())) for page in PAGES) > 5


class PythonBlocks:
    """A process that runs the Python blocks of a page; the first of them starts it."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self._folder = folder
        self._environment = environment
        self._process: subprocess.Popen[str] | None = None

    def run(self, code: str) -> str | None:
        """Run a block; return what it printed if it failed."""
        process = self._process = self._process or self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        last_resort = threading.Timer(TIMEOUT_S, process.kill)
        last_resort.start()
        printed = ""
        try:
            print(json.dumps(code), file=process.stdin, flush=True)
            for line in process.stdout:
                if line == f"{DONE}\n":
                    return None
                printed += line
        finally:
            last_resort.cancel()
        return printed

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self._process.communicate(timeout=TIMEOUT_S)

    def _start(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-W", "error", str(Path(__file__).with_name("python_blocks.py"))],
            cwd=self._folder,
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )


def run_commands(code: str, folder: Path, environment: dict[str, str]) -> str | None:
    """Run a block of shell commands; return what it printed if it failed."""
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", code],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    return None if done.returncode == 0 else f"{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_code_blocks(
    page: Path, clips: Path, touches: Path, session: Path, demo: Path, tmp_path: Path
) -> None:
    text = page.read_text()
    (tmp_path / "my-session").symlink_to(session)
    (tmp_path / "my-clips").symlink_to(clips)
    (tmp_path / "my-touches").symlink_to(touches)
    if "demo/dataset" in text and "--out demo" not in re.sub(SKIPPED, "", text):
        shutil.copytree(demo, tmp_path / "demo" / "dataset")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    folder = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
    if page.name != "README.md":
        # Starting worker processes takes longer than what they are given here; one page has them.
        environment["PYTHON_CPU_COUNT"] = "1"
    with PythonBlocks(tmp_path, environment) as python:
        for match in BLOCK.finditer(text):
            language, code = match["language"], match["code"]
            assert language in RUN + SHOWN, f"a block in {language!r}: neither run nor plain text"
            if match["skip"] or language in SHOWN:
                continue
            if language == "python":
                trouble = python.run(code)
            else:
                trouble = run_commands(code, tmp_path, environment)
            assert trouble is None, f"{page.name}:\n{code}\n{trouble}"
