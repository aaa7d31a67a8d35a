"""``exumi view``, as users run it: a file, an answer without a screen, and a real browser."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from exumi_data.dataset import open_dataset
from exumi_data.store.episode_writer import EpisodeWriter
from tests.browser import Tab, chromium_path, open_browser
from tests.exumi_data.builders import (
    CLOCK,
    FRAMES,
    array_images,
    encoded_images,
    jpegs,
    metadata,
    pictures,
    times,
    write_dataset,
)
from tests.exumi_data.cli.conftest import Program
from tests.exumi_data.view.reading import read_view

# Neither the viewer nor the page has any use for these colours.
MAGENTA, GREEN = (255, 0, 255), (0, 255, 0)
BROWSER_FLAGS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)
PATIENCE_S = 90.0
PROGRAM = (sys.executable, "-m", "exumi_data.cli")


def test_a_file_of_a_dataset(exumi: Program, tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 3)
    done = exumi("view", root, "--save", tmp_path / "set.rrd", "--max-episodes", 2)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{tmp_path / 'set.rrd'}: 2 of 3 episodes, ")
    assert "2 of 3 episodes are shown" in done.stderr
    assert set(read_view(tmp_path / "set.rrd")) == set(open_dataset(root).ids[:2])


def test_damage_is_told_and_is_exit_code_one(exumi: Program, tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 3)
    dataset = open_dataset(root)
    wanted = dataset.ids[2]
    shard = next(Path(dataset.episode_location(2), "streams/tactile/data/c").rglob("*"))
    content = bytearray(shard.read_bytes())
    content[content.find(jpegs()[3]) + 40] ^= 0xFF
    shard.write_bytes(content)
    done = exumi(
        "view", root, "--episode", wanted[:6], "--save", tmp_path / "one.rrd", "--format", "json"
    )
    assert done.returncode == 1
    assert f"{wanted}: tactile: 1 frame is missing: " in done.stderr
    report = json.loads(done.stdout)
    assert [episode["id"] for episode in report["episodes"]] == [wanted]
    assert report["episodes"][0]["samples"] == {"width": FRAMES, "tactile": FRAMES}
    assert report["bytes"] == (tmp_path / "one.rrd").stat().st_size


def test_only_its_own_files_are_replaced(exumi: Program, tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 1)
    file = tmp_path / "view.rrd"
    file.write_text("mine")
    done = exumi("view", root, "--save", file)
    assert done.returncode == 2
    assert "exists and is no Rerun file" in done.stderr
    assert file.read_text() == "mine"
    file.write_bytes(b"RRF2 of another time")
    done = exumi("view", root, "--save", file)
    assert done.returncode == 0
    assert done.stdout.startswith(f"{file}: 1 of 1 episode, ")


def test_nothing_is_written_into_the_data(exumi: Program, tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "set", 1)
    episode = open_dataset(root).episode_location(0)
    (tmp_path / "link").symlink_to(root)
    for source, place in ((root, root), (episode, root), (root, tmp_path / "link")):
        done = exumi("view", source, "--save", place / "view.rrd")
        assert done.returncode == 2
        assert "lies inside the data" in done.stderr
    assert not list(root.glob("*.rrd"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--episode", "nowhere", "--save", "x.rrd"], "no episode 'nowhere'"),
        (["--stream", "nothing", "--save", "x.rrd"], "no stream 'nothing'"),
        (["--save", "x.mp4"], "FILE.rrd"),
        (["--no-open", "--save", "x.rrd"], "--no-open goes with --web"),
        ([], "no display"),
    ],
)
def test_what_cannot_be_shown(
    exumi: Program, tmp_path: Path, arguments: list[str], said: str
) -> None:
    root = write_dataset(tmp_path / "set", 1)
    placed = [str(tmp_path / one) if one.startswith("x.") else one for one in arguments]
    done = exumi("view", root, *placed, DISPLAY="", WAYLAND_DISPLAY="", WAYLAND_SOCKET="")
    assert done.returncode == 2
    assert said in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["set"]


def test_without_rerun(exumi: Program, tmp_path: Path) -> None:
    """A stand-in for the metadata of installed packages, which knows no Rerun."""
    (tmp_path / "sitecustomize.py").write_text(
        "import importlib.metadata as m\n"
        "real = m.version\n"
        "def version(name):\n"
        "    if name == 'rerun-sdk':\n"
        "        raise m.PackageNotFoundError(name)\n"
        "    return real(name)\n"
        "m.version = version\n"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path[1:], os.environ.get("PYTHONPATH", "")])
    root = write_dataset(tmp_path / "set", 1)
    done = exumi("view", root, "--save", tmp_path / "x.rrd", PYTHONPATH=path)
    assert done.returncode == 2
    assert 'pip install "exumi-data[view]"' in done.stderr


@pytest.fixture
def coloured(tmp_path: Path) -> Path:
    """An episode whose cameras see nothing but magenta and green."""
    path = tmp_path / "coloured.zarr"
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        for name, colour in (("rgb_front", MAGENTA), ("rgb_top", GREEN)):
            frames = np.broadcast_to(np.array(colour, np.uint8), pictures().shape)
            stream = writer.add_stream(name, kind="rgb", clock=CLOCK, images=array_images())
            stream.append(times(), frames)
        tactile = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=encoded_images())
        tactile.append(times(), jpegs())
    return path


@pytest.fixture
def serving(coloured: Path, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The program, serving that episode: the process and the address that it printed."""
    (tmp_path / "temporary").mkdir()
    process = subprocess.Popen(
        [*PROGRAM, "view", str(coloured), "--web", "--no-open", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(tmp_path / "temporary")},
    )
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def share(tab: Tab, colour: tuple[int, int, int]) -> float:
    """Which part of the window has a colour."""
    picture = cv2.imdecode(np.frombuffer(tab.screenshot(), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert picture is not None
    return float((np.abs(picture.astype(np.int16) - colour).max(axis=-1) < 12).mean())


def status_of(address: str, **headers: str) -> int:
    request = urllib.request.Request(address, headers=headers)  # noqa: S310  # our own server
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:  # noqa: S310  # same
            return int(answer.status)
    except urllib.error.HTTPError as error:
        error.close()
        return error.code


def test_a_browser_shows_the_episode(
    serving: tuple[subprocess.Popen[str], str], tmp_path: Path
) -> None:
    chromium_path()
    process, address = serving
    found = re.fullmatch(r"(http://127\.0\.0\.1:\d+)/\?url=([^&]+)&persist=0", address)
    assert found, address
    began = time.monotonic()
    page = f"{address}&renderer=webgl"
    with open_browser(*BROWSER_FLAGS) as browser, browser.tab(page, (480, 360)) as tab:
        while min(share(tab, MAGENTA), share(tab, GREEN)) < 0.02:
            assert time.monotonic() - began < PATIENCE_S, tab.errors
            browser.listen(0.5)
        # There is no way out of this machine: what the page asks of others fails.
        own = [error for error in tab.errors if "ERR_NAME_NOT_RESOLVED" not in error]
        assert [error for error in own if re.search("panic|crash|ERROR", error)] == []
    file = urllib.parse.unquote(found[2])
    assert status_of(file) == 200
    assert status_of(file.rpartition("/")[0]) == status_of(f"{file}x") == 404
    assert status_of(file, Host="elsewhere.example") == 404
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0
    for gone in (found[1], file):
        with pytest.raises(urllib.error.URLError):
            status_of(gone)
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_port_that_is_taken(exumi: Program, tmp_path: Path) -> None:
    import socket

    root = write_dataset(tmp_path / "set", 1)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = exumi("view", root, "--web", "--no-open", "--port", port)
    assert done.returncode == 2
    assert f"port {port} is taken" in done.stderr
