"""Beeps and LEDs: programs that are started when something happens, and never waited for."""

import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress

from exumi_recorders.rig.model import Hooks
from exumi_recorders.session import beep

__all__ = ["Hook", "HookRunner", "missing_program"]

Hook = str
"""``ready``, ``start``, ``stop``, ``discard`` or ``problem``."""

_BEEP = "exumi_recorders.session.beep"
_MOST_RUNNING = 8
_LAST_MOMENT_S = 2.0


def missing_program(command: Sequence[str]) -> str | None:
    """Return the program that a hook needs and that is not there; None where all is there.

    Parameters
    ----------
    command : sequence of str
        As the rig file has it.
    """
    program = beep.PLAYER[0] if command[0] == beep.NAME else command[0]
    return None if shutil.which(program) else program


def _started(command: Sequence[str]) -> list[str]:
    """Return what is started for a hook: our own beep by the Python that runs already."""
    if command[0] == beep.NAME:
        return [sys.executable, "-m", _BEEP, *command[1:]]
    return list(command)


class HookRunner:
    """Starts the programs of a rig file's ``[hooks]``.

    Parameters
    ----------
    hooks : Hooks
    """

    def __init__(self, hooks: Hooks) -> None:
        self._hooks = hooks
        self._running: list[subprocess.Popen[bytes]] = []
        self._failed: dict[str, str] = {}

    def run(self, name: Hook) -> bool:
        """Start the program of a hook; return whether there is one and it could be started.

        Parameters
        ----------
        name : str
        """
        command: Sequence[str] | None = getattr(self._hooks, name)
        self._running = [process for process in self._running if process.poll() is None]
        if command is None or name in self._failed or len(self._running) >= _MOST_RUNNING:
            return False
        try:
            # A list of words from the operator's own file: there is no shell to trick.
            process = subprocess.Popen(  # noqa: S603
                _started(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as error:
            self._failed[name] = f"hook {name}: {command[0]} cannot be started ({error.strerror})"
            return False
        self._running.append(process)
        return True

    def close(self) -> None:
        """Give programs that still run a moment; those that take longer go on by themselves."""
        end = time.monotonic() + _LAST_MOMENT_S
        for process in self._running:
            with suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, end - time.monotonic()))

    @property
    def problems(self) -> tuple[str, ...]:
        """What could not be started; each is tried once."""
        return tuple(self._failed.values())
