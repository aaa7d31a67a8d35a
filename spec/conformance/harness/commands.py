"""Running the program that is judged: as a subprocess, with a time limit."""

import argparse
import json
import os
import shlex
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

__all__ = ["Outcome", "answer", "command_line", "run"]


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes
    ----------
    code : int or None
        Exit code; None where the time was up.
    stdout, stderr : str
    """

    code: int | None
    stdout: str
    stderr: str

    @property
    def last_line(self) -> str:
        """What it said last, for messages."""
        lines = self.stderr.strip().splitlines()
        return lines[-1][:300] if lines else ""


def answer(text: str) -> Any:
    """Parse what a program printed.

    Raises
    ------
    ValueError
        It is no JSON, or nested without end.
    """
    try:
        return json.loads(text)
    except RecursionError:
        msg = "nested too deeply"
        raise ValueError(msg) from None


def command_line(text: str) -> list[str]:
    """Cut a command line into words; for `argparse`."""
    try:
        return shlex.split(text)
    except ValueError as error:
        msg = f"cannot be read: {error}"
        raise argparse.ArgumentTypeError(msg) from None


def run(command: Sequence[str], arguments: Sequence[str], timeout_s: float) -> Outcome:
    """Run a command with arguments, which take the place of ``{}`` or are put at its end.

    Parameters
    ----------
    command : sequence of str
    arguments : sequence of str
    timeout_s : float
        After which the program and what it started are killed.

    Raises
    ------
    OSError
        The program cannot be started.
    """
    process = subprocess.Popen(  # noqa: S603  # running the given program is the purpose
        _filled(command, arguments),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return Outcome(None, "", f"no answer within {timeout_s:g} s")
    return Outcome(process.returncode, _text(out), _text(err))


def _filled(command: Sequence[str], arguments: Sequence[str]) -> list[str]:
    if "{}" not in command:
        return [*command, *arguments]
    at = list(command).index("{}")
    return [*command[:at], *arguments, *command[at + 1 :]]


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", errors="replace")
