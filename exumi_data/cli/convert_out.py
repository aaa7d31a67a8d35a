"""``exumi convert SRC DST --to FORMAT``: episodes into other formats."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from exumi_data.cli.failures import FOUND_WRONG
from exumi_data.cli.options import Format
from exumi_data.cli.output import error_console, print_json, printable, size_text, time_text

if TYPE_CHECKING:
    from exumi_converters import ExportPlan, ExportReport
    from exumi_data.engine import Engine

__all__ = ["run", "show_plan"]


def run(  # noqa: PLR0913  # options of the command line
    source: Path,
    destination: Path,
    *,
    to_format: str,
    settings: Mapping[str, str],
    keep_going: bool,
    output: Format,
    workers: int | None,
    engine: "Engine | None",
    quiet: bool,
) -> None:
    """Export, after saying what will be lost.

    Parameters
    ----------
    source, destination : pathlib.Path
    to_format : str
    settings : mapping of str to str
        Options of the format itself.
    keep_going : bool
    output : Format
    workers : int, optional
    engine : Engine or None
    quiet : bool

    Raises
    ------
    typer.Exit
        With code 1, if episodes could not be written.
    """
    from exumi_converters import ExportOptions, export
    from exumi_data.cli.run_report import run_progress

    options = ExportOptions(settings=settings, workers=workers, keep_going=keep_going)

    def announce(plan: "ExportPlan") -> None:
        if not quiet:
            for line in _losses(plan):
                error_console().print(printable(line), style="dim", markup=False)

    with run_progress("Writing", quiet=quiet) as on_progress:
        report = export(
            source,
            destination,
            to_format=to_format,
            options=options,
            engine=engine,
            on_plan=announce,
            on_progress=on_progress,
        )
    _print_report(report, output, quiet=quiet)
    unfinished = not (report.written or report.skipped)
    if unfinished or (report.failed and not keep_going):
        raise typer.Exit(FOUND_WRONG)


def show_plan(
    source: Path,
    destination: Path,
    *,
    to_format: str,
    settings: Mapping[str, str],
    keep_going: bool,
    output: Format,
) -> None:
    """Print what an export would do; exit code 1 if episodes could not be written.

    Parameters
    ----------
    source, destination : pathlib.Path
    to_format : str
    settings : mapping of str to str
        Options of the format itself.
    keep_going : bool
    output : Format

    Raises
    ------
    typer.Exit
        With code 1, if episodes could not be written.
    """
    from exumi_converters import ExportOptions, plan_export

    options = ExportOptions(settings=settings, keep_going=keep_going)
    plan = plan_export(source, destination, to_format=to_format, options=options)
    _print_plan(plan, output)
    if plan.refused and not keep_going:
        raise typer.Exit(FOUND_WRONG)


def _losses(plan: "ExportPlan") -> list[str]:
    """Say what will be lost, streams with the same fate together."""
    streams: dict[tuple[str, str], list[str]] = {}
    for loss in plan.losses:
        named = streams.setdefault((loss.facet, loss.detail), [])
        if loss.stream is not None:
            named.append(loss.stream)
    lines = []
    for (facet, detail), named in streams.items():
        which = f" ({', '.join(named)})" if named else ""
        lines.append(f"lost: {facet}{which}: {detail}")
    return lines


def _print_plan(plan: "ExportPlan", output: Format) -> None:
    if output is Format.JSON:
        from dataclasses import asdict

        print_json(asdict(plan))
        return
    size = "" if plan.estimated_bytes is None else f", about {size_text(plan.estimated_bytes)}"
    print(printable(f"would write {len(plan.items):,} episodes{size}: {plan.layout}"))
    for line in _losses(plan):
        print(printable(f"  {line}"))
    for line in plan.notices:
        print(printable(f"  note: {line}"))
    for failure in plan.refused:
        print(printable(f"  cannot be written: {failure.name}: {failure.reason}"))


def _print_report(report: "ExportReport", output: Format, *, quiet: bool) -> None:
    if output is Format.JSON:
        print_json(report.to_json())
    elif report.skipped:
        print(printable(f"{report.destination}: there already, {report.skipped:,} episodes"))
    else:
        written = f"{report.written:,} of {report.total:,} episodes, {size_text(report.bytes)}"
        took = f"{time_text(report.seconds)} ({report.layout})"
        print(printable(f"{report.destination}: {written}, {took}"))
    console = error_console()
    if not quiet:
        for line in report.notices:
            console.print(f"note: {printable(line)}", style="dim", markup=False)
    if report.failed:
        console.print(f"[bold red]error:[/] {len(report.failed):,} of {report.total:,} failed:")
        for failure in report.failed:
            console.print(printable(f"  {failure.name}: {failure.reason}"), markup=False)
