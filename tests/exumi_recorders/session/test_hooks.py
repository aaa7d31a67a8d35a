"""Hooks are started, not waited for, and told of when they cannot be."""

import sys
import time
from pathlib import Path

import pytest

from exumi_recorders.rig.model import Hooks
from exumi_recorders.session.beep import wav
from exumi_recorders.session.hooks import HookRunner, missing_program


def test_a_program_is_started_and_not_waited_for(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    code = f"import pathlib, time; pathlib.Path({str(mark)!r}).touch(); time.sleep(1)"
    runner = HookRunner(Hooks(start=[sys.executable, "-c", code]))
    began = time.monotonic()
    assert runner.run("start")
    assert time.monotonic() - began < 1
    while not mark.exists():
        assert time.monotonic() - began < 20
        time.sleep(0.02)
    runner.close()
    assert time.monotonic() - began > 1


def test_no_program() -> None:
    assert not HookRunner(Hooks()).run("stop")


def test_a_program_that_is_not_there_is_told_of_once() -> None:
    runner = HookRunner(Hooks(stop=["/nowhere/beep"]))
    assert not runner.run("stop")
    assert not runner.run("stop")
    (problem,) = runner.problems
    assert "/nowhere/beep" in problem


def test_our_own_beep_is_played_by_aplay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard = tmp_path / "heard"
    player = tmp_path / "aplay"
    player.write_text(f"#!/bin/sh\ncat > {heard}\n")
    hooks = Hooks(start=["exumi-beep", "880", "0.05"])
    monkeypatch.setenv("PATH", "/nowhere")
    assert missing_program(["exumi-beep", "880", "0.05"]) == "aplay"
    player.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    assert missing_program(["exumi-beep", "880", "0.05"]) is None
    runner = HookRunner(hooks)
    assert runner.run("start")
    runner.close()
    assert heard.read_bytes() == wav([(880.0, 0.05)])
