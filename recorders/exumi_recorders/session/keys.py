"""Keys of the operator's terminal, one at a time, without Return; or lines of a program."""

import contextlib
import select
import sys
import threading
from collections.abc import Callable, Iterator
from typing import TextIO

__all__ = ["HELP", "KEYS", "read_keys", "read_lines"]

KEYS = {
    " ": "toggle",
    "\r": "toggle",
    "\n": "toggle",
    "d": "discard",
    "u": "undo",
    "g": "success",
    "b": "failure",
    "q": "quit",
}
"""What each key wants."""
HELP = "space start/stop · g good · b bad · d discard · u undo · q quit"

_LOOK_S = 0.2


@contextlib.contextmanager
def read_keys(on_key: Callable[[str], None], stream: TextIO | None = None) -> Iterator[bool]:
    """Listen to keys while the block runs; the terminal is as before afterwards.

    Parameters
    ----------
    on_key : callable
        Told of what a key wants, in a thread of its own.
    stream : file, optional
        Default: stdin.

    Yields
    ------
    bool
        Whether there is a terminal to listen to.
    """
    stream = stream or sys.stdin
    try:
        import termios
        import tty

        descriptor = stream.fileno()
        before = termios.tcgetattr(descriptor)
    except (ImportError, OSError, ValueError, termios.error):
        yield False
        return
    ending = threading.Event()

    def listen() -> None:
        while not ending.is_set():
            if not select.select([descriptor], [], [], _LOOK_S)[0]:
                continue
            key = stream.read(1)
            if not key:
                return
            if key.lower() in KEYS:
                on_key(KEYS[key.lower()])

    thread = threading.Thread(target=listen, name="keys", daemon=True)
    try:
        tty.setcbreak(descriptor)
        thread.start()
        yield True
    finally:
        ending.set()
        thread.join(2 * _LOOK_S)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


@contextlib.contextmanager
def read_lines(on_line: Callable[[str, str], None], stream: TextIO | None = None) -> Iterator[None]:
    """Listen to the lines of a program: a command, and after a space its reason.

    Parameters
    ----------
    on_line : callable
        Told of the command and the reason, in a thread of its own.
    stream : file, optional
        Default: stdin.
    """
    stream = stream or sys.stdin
    wanted = set(KEYS.values()) | {"start", "stop"}

    def listen() -> None:
        for line in stream:
            name, _, reason = line.strip().partition(" ")
            if name in wanted:
                on_line(name, reason.strip())

    # It may wait for a line for ever: it ends with the program.
    threading.Thread(target=listen, name="lines", daemon=True).start()
    yield
