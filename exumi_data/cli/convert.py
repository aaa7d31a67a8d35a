"""``exumi convert``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.options import (
    Format,
    FormatOption,
    QuietOption,
    WorkersOption,
    epilog,
    given_path,
)

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi convert videos my-dataset --from octopi --labels labels.csv",
    "exumi convert my-clips my-dataset --from clips --licence CC-BY-4.0",
    "exumi convert my-clips my-dataset --from clips --kind rgb --stream rgb_front",
)


class _PadType(StrEnum):
    PLAIN = "plain"
    DOTTED = "dotted"


class _Kind(StrEnum):
    TACTILE = "tactile"
    RGB = "rgb"


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    source: Annotated[
        Path, typer.Argument(parser=given_path, metavar="SRC", help="Folder to convert. Only read.")
    ],
    destination: Annotated[
        Path,
        typer.Argument(
            parser=given_path,
            metavar="DST",
            help="The dataset: a new or empty folder, or one to go on with.",
        ),
    ],
    from_format: Annotated[
        str | None,
        typer.Option("--from", metavar="FORMAT", help="Format of SRC, such as octopi or clips."),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(parser=given_path, metavar="CSV", help="Table of labels (octopi)."),
    ] = None,
    licence: Annotated[
        str | None,
        typer.Option(
            metavar="SPDX",
            help="Licence of the data, such as CC-BY-4.0. Default: said to be unknown.",
        ),
    ] = None,
    task: Annotated[str, typer.Option(help="Name of the task.")] = "touch",
    rate: Annotated[
        str | None,
        typer.Option(
            metavar="N/D", help="Frames a second where SRC does not say, such as 60000/1001."
        ),
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(help="Sensor model, such as gelsight-mini, if not implied.")
    ] = None,
    pad_type: Annotated[
        _PadType | None, typer.Option(help="Gel of the sensor, if not implied.")
    ] = None,
    stream: Annotated[str, typer.Option(help="Name of the image stream (clips).")] = "tactile",
    kind: Annotated[_Kind, typer.Option(help="Kind of the image stream (clips).")] = _Kind.TACTILE,
    keep_going: Annotated[
        bool,
        typer.Option(
            "--keep-going", help="Exit with 0 although some files could not be converted."
        ),
    ] = False,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Convert other formats into a dataset of episodes.

    Run it again to go on where it was stopped: episodes that are complete are skipped, those whose
    source, labels or options changed are made anew. Exit code 1 if something could not be
    converted; everything else is.
    """
    from exumi_converters import ConvertOptions, convert, converters
    from exumi_data.cli.run_report import finish, run_progress
    from exumi_data.errors import UsageError
    from exumi_data.model import UNKNOWN_LICENCE

    if from_format is None:
        lines = [f"{name} ({item.describes})" for name, item in converters().items()]
        raise UsageError(
            "--from is missing: the format of the source is not guessed",
            fix=f"Formats: {'; '.join(lines)}.",
        )
    options = ConvertOptions(
        labels=labels,
        licence=licence or UNKNOWN_LICENCE,
        task=task,
        rate=rate,
        sensor=sensor,
        pad_type=None if pad_type is None else pad_type.value,
        stream=stream,
        kind=kind.value,
        workers=workers,
        keep_going=keep_going,
    )
    with run_progress("Converting", quiet=quiet) as on_progress:
        report = convert(
            source, destination, from_format=from_format, options=options, on_progress=on_progress
        )
    notes = [] if licence else ["no --licence was given: the episodes say that it is not known"]
    finish(report, output=output, quiet=quiet, keep_going=keep_going, notes=notes)
