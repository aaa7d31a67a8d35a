"""Rerun's own program: run to its end, or for as long as somebody looks."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["run_rerun", "running_rerun"]

# The launcher of the package, which starts the program from wherever it was installed to. Run with
# -m, it would lose the exit code.
_LAUNCHER = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
# Nothing that lies in the current folder, which may be somebody's data, is a module (-P).
_COMMAND = (sys.executable, "-P", "-c", _LAUNCHER)
_HOMES = ("HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME")
_PATIENCE_S = 5.0


@contextmanager
def running_rerun(*arguments: str, home: Path | None = None) -> Iterator["subprocess.Popen[str]"]:
    """Run Rerun's program while the block runs; what it prints is read from its ``stdout``.

    Parameters
    ----------
    *arguments : str
    home : pathlib.Path, optional
        An empty folder for its settings. For the program every run in one is its first, in which it
        sends no usage statistics: who writes a file has not asked for any.

    Yields
    ------
    subprocess.Popen
    """
    # A group of its own: Ctrl-C reaches this process only, which then ends launcher and program.
    process = subprocess.Popen(  # noqa: S603  # a program of ours
        [*_COMMAND, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=None if home is None else {**os.environ, **dict.fromkeys(_HOMES, str(home))},
        start_new_session=True,
    )
    try:
        yield process
    finally:
        _end(process)
        if process.stdout is not None and not process.stdout.closed:
            process.stdout.read()  # ends when the program does, who is nobody's child by now
            process.stdout.close()


def _end(process: "subprocess.Popen[str]") -> None:
    # The launcher may be gone while its program goes on: so both, and whoever stays is killed.
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(_PATIENCE_S)


def run_rerun(*arguments: str, home: Path | None = None) -> tuple[int, str]:
    """Run Rerun's program to its end.

    Parameters
    ----------
    *arguments : str
    home : pathlib.Path, optional
        As of `running_rerun`.

    Returns
    -------
    int, str
        Its exit code, and what it printed.
    """
    with running_rerun(*arguments, home=home) as process:
        printed, _ = process.communicate()
        return process.returncode, printed
