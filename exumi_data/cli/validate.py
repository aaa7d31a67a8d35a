"""``exumi validate``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.options import Format, FormatOption, QuietOption, WorkersOption, epilog

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi validate my-dataset",
    "exumi validate grasp.zarr.zip --level hierarchy",
    "exumi validate my-dataset --format json > report.json",
)


class _Level(StrEnum):
    DOCUMENT = "document"
    HIERARCHY = "hierarchy"
    ARRAYS = "arrays"
    DATA = "data"


def run(
    path: Annotated[
        Path,
        typer.Argument(metavar="PATH", help="A dataset, or one episode (.zarr or .zarr.zip)."),
    ],
    level: Annotated[
        _Level,
        typer.Option(
            help="How far to look, each including those before: the documents, what is there, "
            "the arrays against each other, all data."
        ),
    ] = _Level.DATA,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Check a dataset or an episode against the standard, and list every problem.

    Exit code 0: valid. 1: invalid. 2: could not run, such as for a path that is not there.
    """
    from exumi_data.engine import warm_up

    if path.is_dir():  # a dataset goes to workers: they load what they need while we do
        warm_up("exumi_validators.validation")
    from exumi_data.cli.output import progress_of
    from exumi_data.standard import LEVELS
    from exumi_validators import validate

    with progress_of("Validating", quiet=quiet) as update:
        report = validate(
            path,
            levels=LEVELS[: LEVELS.index(level.value) + 1],
            workers=workers,
            on_progress=lambda done, total: update(done, total, ""),
        )
    print(report.to_json() if output is Format.JSON else report.to_text(), end="")
    raise typer.Exit(report.exit_code)
