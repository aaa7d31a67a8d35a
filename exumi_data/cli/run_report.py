"""What ``convert`` and ``prepare`` show: progress, and at the end what became of every episode."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from exumi_data.cli.failures import FOUND_WRONG
from exumi_data.cli.options import Format
from exumi_data.cli.output import error_console, print_json, printable, progress_of, time_text

if TYPE_CHECKING:
    from exumi_converters import ConversionReport, Flag, PrepareReport, Progress

__all__ = ["finish", "run_progress"]

_NAMES_SHOWN = 5


@contextmanager
def run_progress(what: str, *, quiet: bool) -> Iterator["Callable[[Progress], None]"]:
    """Show a bar with frames a second while the block runs; on a terminal only.

    Parameters
    ----------
    what : str
    quiet : bool

    Yields
    ------
    callable
        To be told after each episode.
    """
    with progress_of(what, quiet=quiet) as update:

        def on_progress(now: "Progress") -> None:
            rate = now.frames / now.seconds if now.seconds > 0 else 0.0
            update(now.done, now.total, f"{rate:,.0f} frames/s")

        yield on_progress


def finish(
    report: "ConversionReport | PrepareReport",
    *,
    output: Format,
    quiet: bool,
    keep_going: bool,
    notes: Sequence[str] = (),
) -> None:
    """Print a report; end with exit code 1 if something failed, unless told to keep going.

    Parameters
    ----------
    report : ConversionReport or PrepareReport
    output : Format
    quiet : bool
        Leave out everything but the result and the failures.
    keep_going : bool
        Failures do not change the exit code.
    notes : sequence of str
        What else the user should know.

    Raises
    ------
    typer.Exit
        With code 1.
    """
    if output is Format.JSON:
        print_json(report.to_json())
    else:
        for line in _result(report):
            print(printable(line))
    console = error_console()
    if not quiet:
        for note in (*report.notices, *notes):
            console.print(f"note: {printable(note)}", style="dim", markup=False)
        if report.unexplained:
            console.print(
                f"note: {len(report.unexplained):,} episodes of {report.destination} do not come "
                "from this source; they were left alone",
                style="dim",
                markup=False,
            )
    if report.failed:
        console.print(f"[bold red]error:[/] {len(report.failed):,} of {report.total:,} failed:")
        for failure in report.failed:
            console.print(printable(f"  {failure.name}: {failure.reason}"), markup=False)
    elif not quiet:
        console.print(f"Next: exumi validate {report.destination}", style="dim", markup=False)
    if report.failed and not keep_going:
        raise typer.Exit(FOUND_WRONG)


def _result(report: "ConversionReport | PrepareReport") -> Iterator[str]:
    parts = [f"{report.converted:,} written"]
    if report.skipped:
        parts.append(f"{report.skipped:,} there already")
    if report.failed:
        parts.append(f"{len(report.failed):,} failed")
    speed = ""
    if report.frames and report.seconds > 0:
        speed = (
            f"; {report.frames:,} frames in {time_text(report.seconds)}, "
            f"{report.frames / report.seconds:,.0f} a second"
        )
    yield f"{report.destination}: {', '.join(parts)} of {report.total:,} episodes{speed}"
    codes: dict[tuple[str, str], list[Flag]] = {}
    for flag in report.flagged:
        codes.setdefault((flag.severity, flag.code), []).append(flag)
    for (severity, code), flags in sorted(codes.items(), reverse=True):
        yield f"{severity} {code}: {_count(len({flag.name for flag in flags}))}"
        for flag in flags[:_NAMES_SHOWN]:
            yield f"  {flag.name}: {flag.message}"
        if len(flags) > _NAMES_SHOWN:
            yield f"  and {len(flags) - _NAMES_SHOWN:,} more (--format json lists all)"


def _count(number: int) -> str:
    return f"{number:,} episode" if number == 1 else f"{number:,} episodes"
