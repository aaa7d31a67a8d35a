"""Rerun's own program, run from here."""

import os
import re
import socket
import time
from pathlib import Path

import pytest

from exumi_data.errors import UnsupportedError
from exumi_data.view.looking import look
from exumi_data.view.program import run_rerun, running_rerun


def test_its_exit_code_and_its_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A file of that name in the current folder, which may be somebody's dataset, is no module.
    (tmp_path / "rerun_cli.py").write_text("raise SystemExit('data was run')")
    monkeypatch.chdir(tmp_path)
    code, printed = run_rerun("rrd", "verify", str(tmp_path / "none.rrd"), home=tmp_path)
    assert code != 0
    assert "none.rrd" in printed
    assert run_rerun("--version", home=tmp_path)[0] == 0


def answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
    except ConnectionRefusedError:
        return False
    return True


def test_launcher_and_program_end_with_the_block(tmp_path: Path) -> None:
    arguments = ("--serve-web", "--bind", "127.0.0.1", "--web-viewer-port", "0", "--port", "0")
    with running_rerun(*arguments, home=tmp_path) as process:
        assert process.stdout is not None
        found = None
        while found is None:
            found = re.search(r"web-viewer at http://127\.0\.0\.1:(\d+)", process.stdout.readline())
            assert process.poll() is None
        port = int(found[1])
        assert answers(port)
    deadline = time.monotonic() + 5
    while answers(port):
        assert time.monotonic() < deadline


@pytest.mark.skipif("DISPLAY" in os.environ, reason="there is a display to open a window on")
def test_a_viewer_that_does_not_open_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":99999")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    (tmp_path / "x.rrd").write_bytes(b"")
    with pytest.raises(UnsupportedError, match=r"the viewer ended with code .*--web"):
        look(tmp_path / "x.rrd")
