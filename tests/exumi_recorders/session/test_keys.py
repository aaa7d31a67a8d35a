"""Keys of a real terminal, and lines of a program."""

import os
import pty
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from exumi_recorders.session.keys import read_keys, read_lines


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Both ends of one: where the operator types, and what the program has as stdin."""
    ours, its = pty.openpty()
    yield ours, its
    for descriptor in (ours, its):
        os.close(descriptor)


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_keys_and_a_terminal_as_it_was(terminal: tuple[int, int]) -> None:
    ours, its = terminal
    before = termios.tcgetattr(its)
    heard: list[str] = []

    def hear(name: str, reason: str) -> None:
        heard.append(f"{name} {reason}".strip())

    with os.fdopen(its, closefd=False) as stdin, read_keys(hear, stdin) as there:
        assert there
        # Several at once are several: none waits for the next one.
        os.write(ours, b" Dx02u")
        until(lambda: len(heard) == 4)
        # An arrow key ends in a letter; and Ctrl-S and Ctrl-Z do not stop the recording.
        os.write(ours, b"\x1b[D")
        time.sleep(0.3)
        os.write(ours, b"\x13\x1a")
        os.write(ours, b"q")
        until(lambda: len(heard) == 5)
        assert heard == ["toggle", "discard", "reason 2", "undo", "quit"]
        assert not termios.tcgetattr(its)[3] & termios.ECHO
    assert termios.tcgetattr(its) == before


def test_a_terminal_that_goes_away() -> None:
    ours, its = pty.openpty()
    with os.fdopen(its) as stdin, read_keys(lambda *_: None, stdin) as there:
        assert there
        os.close(ours)
        began = time.monotonic()
    assert time.monotonic() - began < 2


def test_no_terminal() -> None:
    with Path(os.devnull).open() as nothing, read_keys(lambda *_: None, nothing) as there:
        assert not there


def test_lines() -> None:
    its, ours = os.pipe()
    heard: list[tuple[str, str]] = []
    with os.fdopen(its) as stdin, read_lines(lambda *said: heard.append(said), stdin):
        os.write(ours, b"start\n\n  discard  the cup fell \nsto")
        until(lambda: len(heard) == 2)
        os.write(ours, b"p\nun\xffdo\nx" + b"x" * 9999)
        until(lambda: len(heard) == 4)
        os.close(ours)
    assert heard == [("start", ""), ("discard", "the cup fell"), ("stop", ""), ("un\ufffddo", "")]
