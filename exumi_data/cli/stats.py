"""``exumi stats``."""

from dataclasses import asdict
from typing import Annotated

import typer

from exumi_data.cli.options import (
    DataArgument,
    Format,
    FormatOption,
    QuietOption,
    WorkersOption,
    epilog,
)

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi stats my-dataset",
    "exumi stats my-dataset --require tactile_left --require pose",
    "exumi stats my-dataset --format json > statistics.json",
)


def run(
    path: DataArgument,
    require: Annotated[
        list[str] | None,
        typer.Option(
            help="Stream that must be valid for a moment to be usable; may be given several "
            "times. Default: all streams of an episode."
        ),
    ] = None,
    tick: Annotated[
        float | None,
        typer.Option(help="Seconds between ticks of the common timeline. Default: 3/59.94."),
    ] = None,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Measure a dataset: rates, gaps, touch, usable time, labels, sizes.

    Reads times and stored activity, decodes no frame. Exit code 1 if an episode could not be read.
    """
    import exumi_data
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import print_json, progress_of, result_console
    from exumi_data.stats import measure
    from exumi_data.ticks import DEFAULT_TICK_S

    source = exumi_data.open(path)
    total = 1 if isinstance(source, exumi_data.Episode) else len(source)
    with progress_of("Measuring", quiet=quiet) as update:
        update(0, total, "")
        statistics = measure(
            source,
            tick_s=DEFAULT_TICK_S if tick is None else tick,
            required=require or None,
            workers=workers,
            on_done=lambda done: update(done, total, ""),
        )
    if output is Format.JSON:
        print_json(asdict(statistics))
    else:
        from exumi_data.cli.stats_text import print_statistics

        print_statistics(statistics, result_console())
    if statistics.unreadable:
        raise typer.Exit(FOUND_WRONG)
