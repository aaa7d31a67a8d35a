"""``exumi stats``."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.engines import EngineName, EngineOption, RayAddressOption
from exumi_data.cli.options import (
    DataArgument,
    Format,
    FormatOption,
    QuietOption,
    WorkersOption,
    epilog,
    given_path,
)
from exumi_data.cli.stats_html import PageLevel, make_page

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi stats my-dataset",
    "exumi stats my-dataset --require tactile_left --require pose",
    "exumi stats my-dataset --engine ray --ray-address 10.0.0.1:6379",
    "exumi stats my-dataset --format json > statistics.json",
    "exumi stats my-dataset --html my-dataset.html",
    "exumi stats my-dataset --html my-dataset.html --level arrays",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
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
    html: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FILE",
            help="Validate and look at frames, too, and write a page for the browser: one file "
            "that needs no network.",
        ),
    ] = None,
    level: Annotated[
        PageLevel | None,
        typer.Option(
            help="With --html: how far to validate, as exumi validate has it, by the standard "
            "alone. Default: data, which decodes every frame."
        ),
    ] = None,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    engine: EngineOption = EngineName.LOCAL,
    ray_address: RayAddressOption = None,
    quiet: QuietOption = False,
) -> None:
    """Measure a dataset: rates, gaps, touch, usable time, labels, sizes.

    Reads times and stored activity, decodes no frame (but for --html). Exit code 1 if an episode
    could not be read.
    """
    import exumi_data
    from exumi_data.cli.engines import chosen_engine
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import (
        print_json,
        printable,
        progress_of,
        result_console,
        size_text,
    )
    from exumi_data.errors import UsageError
    from exumi_data.stats import measure
    from exumi_data.ticks import DEFAULT_TICK_S
    from exumi_data.wording import counted

    if level is not None and html is None:
        raise UsageError("--level belongs to --html", fix="Add --html FILE.")
    if html is not None:
        _check_page(html, path)
    source = exumi_data.open(path)
    total = 1 if isinstance(source, exumi_data.Episode) else len(source)
    with (
        chosen_engine(engine, ray_address, workers=workers, reads=[path], quiet=quiet) as where,
        progress_of("Measuring", quiet=quiet) as update,
    ):
        update(0, total, "")
        statistics = measure(
            source,
            tick_s=DEFAULT_TICK_S if tick is None else tick,
            required=require or None,
            workers=workers,
            engine=where,
            on_done=lambda done: update(done, total, ""),
        )
    size = 0
    if html is not None:
        chosen = level or PageLevel.DATA
        size = make_page(source, statistics, html, level=chosen, workers=workers, quiet=quiet)
    if output is Format.JSON:
        print_json(asdict(statistics))
    elif html is not None:
        count = counted(statistics.episodes, "episode")
        print(printable(f"{html}: {count}, {size_text(size)}"))
    else:
        from exumi_data.cli.stats_text import print_statistics

        print_statistics(statistics, result_console())
    if statistics.unreadable:
        raise typer.Exit(FOUND_WRONG)


def _check_page(html: Path, path: str) -> None:
    """Refuse a page that cannot be made, before the work is done."""
    from exumi_data.errors import UsageError
    from exumi_data.stats.html import check_target

    if "://" in path:
        raise UsageError(
            "--html looks at every frame, and takes data on this machine",
            fix="Download the dataset first, or its preview.",
        )
    check_target(html)
