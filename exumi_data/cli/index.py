"""``exumi index``."""

from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.engines import EngineName, EngineOption, RayAddressOption
from exumi_data.cli.options import (
    Format,
    FormatOption,
    QuietOption,
    WorkersOption,
    epilog,
    given_path,
)

__all__ = ["EPILOG", "run"]

EPILOG = epilog("exumi index my-dataset", "exumi index my-dataset --all")


def run(
    path: Annotated[Path, typer.Argument(parser=given_path, metavar="PATH", help="A dataset.")],
    everything: Annotated[
        bool,
        typer.Option("--all", help="Read every episode anew, not only those that changed."),
    ] = False,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    engine: EngineOption = EngineName.LOCAL,
    ray_address: RayAddressOption = None,
    quiet: QuietOption = False,
) -> None:
    """Write the dataset's catalog, so that it opens at once.

    Only episodes whose metadata changed are read. Episodes that cannot be read are left out and
    named; exit code 1 then.
    """
    from exumi_data.cli.engines import chosen_engine
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.indexing import refresh_catalog
    from exumi_data.cli.output import error_console, print_json, printable, progress_of

    with (
        chosen_engine(engine, ray_address, workers=workers, reads=[path], quiet=quiet) as chosen,
        progress_of("Reading", quiet=quiet) as update,
    ):
        change = refresh_catalog(
            path,
            everything=everything,
            workers=workers,
            engine=chosen,
            on_done=lambda done, total: update(done, total, ""),
        )
    if output is Format.JSON:
        print_json(change.as_dict())
    else:
        for line in change.lines():
            print(printable(line))
    if change.failed:
        console = error_console()
        console.print(f"[bold red]error:[/] {len(change.failed)} episode(s) cannot be read:")
        for reason in change.failed.values():
            console.print(f"  {reason}", markup=False)
        raise typer.Exit(FOUND_WRONG)
