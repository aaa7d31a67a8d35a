"""Keys of the operator's terminal, one at a time, without Return; or lines of a program."""

import contextlib
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from typing import IO, Any

__all__ = ["HELP", "KEYS", "read_keys", "read_lines"]

KEYS = {
    " ": "toggle",
    "\r": "toggle",
    "\n": "toggle",
    "d": "discard",
    "u": "undo",
    "g": "success",
    "b": "failure",
    "r": "reference",
    "q": "quit",
}
"""What each key wants."""
_REASONS = "123456789"
"""Each says why the last episode was discarded."""
HELP = "space start/stop · g good · b bad · d discard · u undo · r reference · q quit"

_LOOK_S = 0.2
_MOST_BYTES = 1 << 12
_ESCAPE = 0x1B


@contextlib.contextmanager
def read_keys(on_key: Callable[[str, str], None], stream: IO[str] | None = None) -> Iterator[bool]:
    """Listen to keys while the block runs; the terminal is as before afterwards.

    Ctrl-C still interrupts. Ctrl-Z and Ctrl-S do nothing: they would stop the recording, or the
    sight of it.

    Parameters
    ----------
    on_key : callable
        Told of what a key wants, and of the number of a reason, in a thread of its own.
    stream : file, optional
        Default: stdin.

    Yields
    ------
    bool
        Whether there is a terminal to listen to.
    """
    try:
        import termios

        descriptor = (stream or sys.stdin).fileno()
        before = termios.tcgetattr(descriptor)
    except (ImportError, OSError, ValueError, AttributeError, termios.error):
        yield False
        return
    if _is_in_background(descriptor):
        yield False
        return

    def take(typed: bytes) -> None:
        if typed[0] == _ESCAPE:
            return  # an arrow key or the like: its letters are not what was meant
        for key in typed.decode("ascii", errors="replace").lower():
            if key in KEYS:
                on_key(KEYS[key], "")
            elif key in _REASONS:
                on_key("reason", key)

    try:
        termios.tcsetattr(descriptor, termios.TCSANOW, _one_key_at_a_time(before))
        with _listening(descriptor, take, "keys"):
            yield True
    finally:
        # A terminal that is gone needs no restoring. Nor is waited for one that hangs (TCSADRAIN).
        with contextlib.suppress(termios.error, OSError):
            termios.tcsetattr(descriptor, termios.TCSANOW, before)


def _is_in_background(descriptor: int) -> bool:
    """Whether the terminal is another program's just now: to touch it would stop this one."""
    try:
        return os.tcgetpgrp(descriptor) != os.getpgrp()
    except OSError:
        return False


def _one_key_at_a_time(before: list[Any]) -> list[Any]:
    import termios

    after = [*before[:6], list(before[6])]
    after[0] &= ~termios.IXON
    after[3] &= ~(termios.ICANON | termios.ECHO)
    after[6][termios.VSUSP] = b"\0"
    after[6][termios.VMIN], after[6][termios.VTIME] = 1, 0
    return after


@contextlib.contextmanager
def read_lines(
    on_line: Callable[[str, str], None], stream: IO[str] | None = None
) -> Iterator[None]:
    """Listen to the lines of a program: a command, and after a space its reason.

    Parameters
    ----------
    on_line : callable
        Told of the command and the reason, in a thread of its own.
    stream : file, optional
        Default: stdin.
    """
    try:
        descriptor = (stream or sys.stdin).fileno()
    except (OSError, ValueError, AttributeError):
        yield  # started without stdin
        return
    rest = b""

    def take(data: bytes) -> None:
        nonlocal rest
        *lines, rest = (rest + data).split(b"\n")
        rest = rest[:_MOST_BYTES]
        for line in lines:
            name, _, reason = line.decode(errors="replace").strip().partition(" ")
            if name:
                on_line(name, reason.strip())

    with _listening(descriptor, take, "lines"):
        yield


@contextlib.contextmanager
def _listening(descriptor: int, take: Callable[[bytes], None], name: str) -> Iterator[None]:
    """Hand over what comes from a file, in a thread of its own, until it ends or the block does."""
    ending = threading.Event()

    def listen() -> None:
        while not ending.is_set():
            try:
                # Not through the file object: what that has read ahead, select does not see.
                if not select.select([descriptor], [], [], _LOOK_S)[0]:
                    continue
                data = os.read(descriptor, _MOST_BYTES)
            except (OSError, ValueError):
                return  # the terminal is gone
            if not data:
                return
            take(data)

    thread = threading.Thread(target=listen, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join(2 * _LOOK_S)
