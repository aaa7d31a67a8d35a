"""``exumi convert SRC DST``: other formats into a dataset."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from exumi_data.cli.failures import FOUND_WRONG
from exumi_data.cli.options import Format
from exumi_data.cli.output import print_json, printable, size_text

if TYPE_CHECKING:
    from exumi_converters import ConversionPlan, ConvertOptions
    from exumi_data.engine import Engine

__all__ = ["run", "show_plan"]

_NAMES_SHOWN = 5


def run(
    source: Path,
    destination: Path,
    *,
    from_format: str | None,
    options: "ConvertOptions",
    engine: "Engine | None",
    licence_given: bool,
    output: Format,
    quiet: bool,
) -> None:
    """Convert, and print what became of every episode.

    Parameters
    ----------
    source, destination : pathlib.Path
    from_format : str, optional
    options : ConvertOptions
    engine : Engine or None
    licence_given : bool
    output : Format
    quiet : bool
    """
    from exumi_converters import convert
    from exumi_data.cli.run_report import finish, run_progress

    with run_progress("Converting", quiet=quiet) as on_progress:
        report = convert(
            source,
            destination,
            from_format=from_format,
            options=options,
            engine=engine,
            on_progress=on_progress,
        )
    notes = (
        [] if licence_given else ["no --licence was given: the episodes say that it is not known"]
    )
    finish(report, output=output, quiet=quiet, keep_going=options.keep_going, notes=notes)


def show_plan(
    source: Path, *, from_format: str | None, options: "ConvertOptions", output: Format
) -> None:
    """Print what a conversion would do; exit code 1 if something could not be converted.

    Parameters
    ----------
    source : pathlib.Path
    from_format : str, optional
    options : ConvertOptions
    output : Format
    """
    from exumi_converters import plan_conversion

    plan = plan_conversion(source, from_format=from_format, options=options)
    if output is Format.JSON:
        print_json(plan.to_json())
    else:
        for line in _lines(plan):
            print(printable(line))
    if plan.failed and not options.keep_going:
        raise typer.Exit(FOUND_WRONG)


def _lines(plan: "ConversionPlan") -> Iterator[str]:
    yield f"{plan.source}: {plan.converter}, {plan.layout}"
    size = size_text(plan.estimated_bytes)
    yield f"would write {len(plan.episodes):,} episodes, about {size}: {_some(plan.episodes)}"
    yield from (f"  keeps {line}" for line in plan.keeps)
    yield from (f"  loses {line}" for line in plan.loses)
    yield from (f"  note: {line}" for line in plan.notices)
    for failure in plan.failed:
        yield f"  cannot be converted: {failure.name}: {failure.reason}"


def _some(names: tuple[str, ...]) -> str:
    more = len(names) - _NAMES_SHOWN
    return ", ".join(names[:_NAMES_SHOWN]) + (f" and {more:,} more" if more > 0 else "")
