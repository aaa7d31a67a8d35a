"""How the program ends when something goes wrong: one message, the right exit code, no traceback.

``EXUMI_DEBUG=1`` shows the traceback of every error.
"""

import errno
import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import typer
from typer.core import TyperGroup

from exumi_data.cli.output import error_console, printable
from exumi_data.errors import ExumiError
from exumi_data.stopping import Stopped

__all__ = [
    "COULD_NOT_RUN",
    "FOUND_WRONG",
    "INTERRUPTED",
    "ReportingGroup",
    "escape_what_cannot_be_printed",
    "open_closed_streams",
    "reported",
    "stop_on_signals",
]

FOUND_WRONG = 1
COULD_NOT_RUN = 2
_BUG = 70  # EX_SOFTWARE of sysexits.h
INTERRUPTED = 128 + signal.SIGINT
_BROKEN_PIPE = 141  # 128 + SIGPIPE, which Windows does not have


class ReportingGroup(TyperGroup):
    """The group of all verbs: runs one, and turns what it raises into a message and a code."""

    def invoke(self, ctx: Any) -> Any:
        """Run the verb."""
        with reported():
            return super().invoke(ctx)


@contextmanager
def reported() -> Iterator[None]:
    """Turn exceptions into a message on stderr and an exit code; show warnings as one line each.

    Raises
    ------
    typer.Exit
        In place of every exception but `SystemExit` and those of the command line's own parser.
    """
    try:
        with _plain_warnings():
            yield
        sys.stdout.flush()
    except BrokenPipeError:
        _leave_pipe()
        raise typer.Exit(_BROKEN_PIPE) from None
    except KeyboardInterrupt as error:
        _say("interrupted", "What was complete stays; nothing half-written is left.", error)
        raise typer.Exit(INTERRUPTED) from None
    except ExumiError as error:
        what = error.what if error.where is None else f"{error.where}: {error.what}"
        _say(what, error.fix, error)
        raise typer.Exit(COULD_NOT_RUN) from None
    except OSError as error:
        what = error.strerror or str(error)
        _say(f"{error.filename}: {what}" if error.filename else what, _advice(error), error)
        raise typer.Exit(COULD_NOT_RUN) from None
    except Exception as error:
        if _is_of_the_parser(error):
            raise
        what = f"unexpected {type(error).__name__}: {error}"
        fix = "This is a bug in exUMI Data. Please report it, with what EXUMI_DEBUG=1 shows."
        _say(what, fix, error)
        raise typer.Exit(_BUG) from None


def _is_of_the_parser(error: Exception) -> bool:
    """Whether typer itself handles this: wrong options (ClickException), Exit, Abort."""
    return isinstance(error, typer.Exit | typer.Abort) or hasattr(error, "exit_code")


def _advice(error: OSError) -> str | None:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "Free some space and run the same command again: what was complete is kept."
    if error.errno == errno.ENOENT and error.filename is None:
        try:
            Path.cwd()
        except FileNotFoundError:
            return "The folder you work in is no longer there: change to another one."
    return None


def _say(what: str, fix: str | None, error: BaseException) -> None:
    if os.environ.get("EXUMI_DEBUG", "0") not in ("", "0"):
        traceback.print_exception(error)
    console = error_console()
    console.print("[bold red]error:[/] ", end="")
    console.print(printable(what, lines=True), markup=False)
    if fix:
        console.print(f"       {printable(fix, lines=True)}", markup=False)


@contextmanager
def _plain_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        if not sys.warnoptions:
            # Libraries deprecate things; that is nothing for a user of the command line.
            warnings.simplefilter("ignore")
            warnings.simplefilter("default", UserWarning)
        warnings.showwarning = _show_warning
        yield


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    console = error_console()
    console.print("[bold yellow]warning:[/] ", end="")
    console.print(printable(str(message), lines=True), markup=False)


def _leave_pipe() -> None:
    """Point stdout at nothing, or Python complains at its end that it could not flush it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _stop(number: int, _: object) -> None:
    raise Stopped(128 + number)


def open_closed_streams() -> None:
    """Give the program somewhere to write where it was started without (``>&-``)."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123  # for as long as the program runs


def escape_what_cannot_be_printed() -> None:
    """Print letters as escapes that the terminal's or the file's encoding does not have."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def stop_on_signals() -> None:
    """Make SIGTERM and SIGHUP unwind the program, so that workers stop and files are removed."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # A signal that is ignored (nohup) stays ignored.
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _stop)
