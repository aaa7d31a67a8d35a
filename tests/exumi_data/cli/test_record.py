"""``exumi record`` as it is used: at a terminal, by a program, and when it is interrupted."""

import contextlib
import fcntl
import json
import os
import pty
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from http.client import HTTPConnection
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

import pytest

from exumi_data.calibration_items import now
from exumi_data.catalog import list_episodes
from exumi_data.episode import open_episode
from exumi_recorders.journal.states import list_journals
from exumi_validators import validate
from tests.exumi_data.cli.conftest import Program

PATIENCE_S = 60.0
RIG = """
format = "exumi-rig"
version = "1.0"

[rig]
calibration = ["gripper.json"]
name = "toy"
licence = "CC0-1.0"

[limits]
least_minutes = 0
reserve_mb = 1

[devices.encoder]
driver = "as5600"
simulated = { seed = 7, duration_s = 5.0, epoch_ns = 0 }
streams = { width = "width" }
"""

CALIBRATION = {
    "format": "exumi-calibration",
    "version": "1.0",
    "items": {
        "width_map": {"value": {"raw_to_data": {"raw": [3934, 4546], "data": [-0.002, 0.1]}}},
        "latency/width": {"value": 0, "unit": "ns", "time": now()},
    },
}


class Recording:
    """The program, and what it has said so far."""

    def __init__(self, folder: Path, environment: dict[str, str], *arguments: str) -> None:
        rig = folder / "rig.toml"
        rig.write_text(RIG)
        (folder / "gripper.json").write_text(json.dumps(CALIBRATION))
        self.dataset = folder / "set"
        which = () if "--rig" in arguments else ("--rig", str(rig))
        self.command = [sys.executable, "-m", "exumi_data.cli", "record", *which, *arguments]
        self.command += ["--task", "toy", "--out", str(self.dataset)]
        self.environment = environment
        self.said = b""
        self._read_to = 0
        self.process: subprocess.Popen[bytes]
        self.readable: int
        self.writable: int

    def __enter__(self) -> Self:
        self.process = subprocess.Popen(
            self.command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=self.environment,
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.readable, self.writable = self.process.stdout.fileno(), self.process.stdin.fileno()
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def wait(self, text: str) -> None:
        """Wait for it to say something, after what was waited for before."""
        wanted = text.encode()
        self.until(lambda: wanted in self.said[self._read_to :])
        self._read_to = self.said.index(wanted, self._read_to) + len(wanted)

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, self.said[-2000:]
            if select.select([self.readable], [], [], 0.1)[0]:
                data = self._read()
                assert data, self.said[-2000:]
                self.said += data

    def _read(self) -> bytes:
        try:
            return os.read(self.readable, 1 << 16)
        except OSError:
            return b""  # the other end of a terminal is gone

    def rest(self) -> bytes:
        """Wait for the program's end; return what it said till then."""
        while data := self._read():
            self.said += data
        self.process.wait(PATIENCE_S)
        return self.said

    def write(self, text: str) -> None:
        os.write(self.writable, text.encode())

    def check_only_episode(self) -> Path:
        """There is one, it is valid, and nothing is left beside it."""
        (path,) = list_episodes(self.dataset)
        found = validate(self.dataset / path).problems
        assert [one for one in found if one.severity == "error"] == []
        assert list((self.dataset / ".recording").iterdir()) == []
        return self.dataset / path


class AtTerminal(Recording):
    """The program at a terminal of its own."""

    def __enter__(self) -> Self:
        self.readable, self.stdin = pty.openpty()
        self.writable = self.readable
        fcntl.ioctl(self.stdin, termios.TIOCSWINSZ, struct.pack("4H", 30, 100, 0, 0))
        self.before = termios.tcgetattr(self.stdin)
        self.process = subprocess.Popen(
            self.command,
            stdin=self.stdin,
            stdout=self.stdin,
            stderr=self.stdin,
            env={**self.environment, "TERM": "xterm-256color"},
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509  # one call of the system
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        for descriptor in {self.readable, self.stdin}:
            with contextlib.suppress(OSError):
                os.close(descriptor)


def test_keys_at_a_terminal(tmp_path: Path, plain_environment: dict[str, str]) -> None:
    with AtTerminal(tmp_path, plain_environment) as run:
        run.wait("waiting")
        # The live table.
        run.wait("jitter ms")
        run.wait("width")
        run.write(" ")
        run.wait("recording episode 1")
        run.wait(" REC ")
        run.write(" ")
        run.wait("stopped after")
        run.write("d")
        run.wait("discarded; why: 1 it failed")
        run.write("2")
        run.wait("because: tracking was lost")
        run.write("u")
        run.wait("taken back")
        # All at once: record another one, discard it, and go.
        run.write(" dq")
        run.wait("recording episode 2")
        run.wait("finishing the last episodes")
        run.wait("1 episode kept, 1 discarded")
        run.until(lambda: run.process.poll() is not None)
        assert run.process.returncode == 0
        assert termios.tcgetattr(run.stdin) == run.before
        # The cursor is shown again.
        assert run.said.count(b"\x1b[?25l") == run.said.count(b"\x1b[?25h") == 1
    assert len(list_episodes(run.dataset)) == 1
    assert len(list_journals(run.dataset)) == 1


def test_a_lost_connection_ends_the_session_cleanly(
    tmp_path: Path, plain_environment: dict[str, str]
) -> None:
    with AtTerminal(tmp_path, plain_environment) as run:
        run.wait("waiting")
        run.write(" ")
        run.wait("recording episode 1")
        time.sleep(0.3)
        os.close(run.stdin)
        os.close(run.readable)
        # As the shell does, besides the terminal.
        run.process.send_signal(signal.SIGHUP)
        assert run.process.wait(PATIENCE_S) == 0
    run.check_only_episode()


def test_without_a_terminal_there_are_plain_lines(
    tmp_path: Path, plain_environment: dict[str, str]
) -> None:
    with Recording(tmp_path, plain_environment, "--duration", "60") as run:
        run.wait("recording episode 1")
        time.sleep(0.3)
        run.process.send_signal(signal.SIGINT)
        said = run.rest().decode()
    assert run.process.returncode == 0
    assert not re.search(r"[^\x20-\x7e\n]", said)
    lines = said.splitlines()[1:]
    assert [re.sub(r"\d[\d:.,]*", "#", line).split(":")[0] for line in lines] == [
        "# stopped after # s, # samples",
        "# finishing the last episodes ...",
        "# kept",
        "# episode kept, # discarded",
    ]
    episode = run.check_only_episode()
    assert str(episode) in said


def test_for_programs(tmp_path: Path, plain_environment: dict[str, str]) -> None:
    labels = ("--object", "mug", "--regime", "touch")
    with Recording(tmp_path, plain_environment, "--status-json", *labels) as run:
        run.wait('"type": "status"')
        run.write("start\ndance\n")
        run.wait('"code": "recording"')
        run.wait('"state": "recording"')
        run.write("success\nstop\ndiscard the cup fell\n")
        run.wait('"code": "discarded"')
        run.write("undo\n")
        run.wait('"code": "undone"')
        run.process.send_signal(signal.SIGTERM)
        said = [json.loads(line) for line in run.rest().decode().splitlines()]
    assert run.process.returncode == 0
    assert {one["type"] for one in said[:-1]} == {"message", "status"}
    codes = [one["code"] for one in said if one["type"] == "message"]
    expected = ["recording", "unknown_command", "judged", "stopped", "discarded", "undone"]
    assert sorted(codes) == sorted([*expected, "finishing", "kept"])
    episode = run.check_only_episode()
    assert said[-1] == {
        "type": "report",
        "episodes": [str(episode)],
        "discarded": [],
        "problems": [],
        "left": [],
    }
    status = next(one for one in said if one.get("state") == "recording")
    assert status["next_trial"] == 1
    assert [one["name"] for one in status["streams"]] == ["width"]
    with open_episode(episode) as found:
        assert found.metadata.success is True
        assert found.metadata.annotations is not None
        assert found.metadata.annotations.trial == 1


def test_a_second_interrupt_leaves_the_journal(
    tmp_path: Path, plain_environment: dict[str, str], exumi: Program
) -> None:
    slow = tmp_path / "bin" / "nice"  # what finishes an episode is started through it
    slow.parent.mkdir()
    slow.write_text("#!/bin/sh\nexec sleep 60\n")
    slow.chmod(0o755)
    environment = plain_environment | {"PATH": f"{slow.parent}:{plain_environment['PATH']}"}
    with Recording(tmp_path, environment, "--duration", "60") as run:
        run.wait("recording episode 1")
        time.sleep(0.3)
        run.process.send_signal(signal.SIGINT)
        run.wait("finishing the last episodes")
        run.process.send_signal(signal.SIGINT)
        said = run.rest().decode()
    assert run.process.returncode == 130
    assert f"1 not finished: exumi recover {run.dataset}\n" in said
    assert len(list_journals(run.dataset)) == 1
    assert list_episodes(run.dataset) == []
    assert exumi("recover", run.dataset).returncode == 0
    run.check_only_episode()


def children_of(process: int) -> list[int]:
    found = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [int(one) for one in found]


def is_running(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_a_killed_recorder_of_the_simulated_rig(
    tmp_path: Path, plain_environment: dict[str, str], exumi: Program
) -> None:
    options = ("--rig", "simulated", "--status-json", "--duration", "9", "--preview", ":0")
    with Recording(tmp_path, plain_environment, *options) as run:
        run.until(lambda: b"http://" in run.said and b'"recording"' in run.said)
        url = re.search(rb"http://[^\s\"]+", run.said)
        assert url is not None
        address = urlsplit(url.group().decode())
        assert address.hostname == "127.0.0.1"
        connection = HTTPConnection("127.0.0.1", address.port or 0, timeout=5)
        connection.request("GET", "/tactile_left.jpg")
        assert connection.getresponse().read(2) == b"\xff\xd8"
        # Nobody else can look: not even this machine by another of its addresses.
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", address.port or 0), timeout=5)
        time.sleep(1.0)
        devices = children_of(run.process.pid)
        assert len(devices) >= 4
        run.process.kill()
        run.process.wait()
        end = time.monotonic() + 5
        while any(map(is_running, devices)):
            assert time.monotonic() < end
            time.sleep(0.05)
    assert (run.dataset / ".recording" / ".reserve").exists()
    done = exumi("recover", run.dataset, "--format", "json", "--quiet")
    assert done.returncode == 0
    (journal,) = json.loads(done.stdout)["journals"]
    assert journal["crashed"]
    assert journal["samples"]["width"] > 100
    run.check_only_episode()
