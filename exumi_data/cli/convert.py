"""``exumi convert``."""

from enum import StrEnum
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

EPILOG = epilog(
    "exumi convert --list",
    "exumi convert videos my-dataset --from octopi --labels labels.csv",
    "exumi convert my-clips my-dataset --from clips --kind rgb --stream rgb_front",
    "exumi convert my-clips my-dataset --dry-run",
    "exumi convert my-dataset my-dataset-mcap --to mcap",
    "exumi convert /shared/videos /shared/my-dataset --engine ray --ray-address 10.0.0.1:6379",
)


class _PadType(StrEnum):
    PLAIN = "plain"
    DOTTED = "dotted"


class _Kind(StrEnum):
    TACTILE = "tactile"
    RGB = "rgb"


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    source: Annotated[
        Path | None,
        typer.Argument(parser=given_path, metavar="SRC", help="What to convert. Only read."),
    ] = None,
    destination: Annotated[
        Path | None,
        typer.Argument(
            parser=given_path,
            metavar="DST",
            help="The dataset: a new or empty folder, or one to go on with. With --to: a new "
            "folder or file.",
        ),
    ] = None,
    from_format: Annotated[
        str | None,
        typer.Option(
            "--from", metavar="FORMAT", help="Format of SRC. Default: the one that recognises it."
        ),
    ] = None,
    to_format: Annotated[
        str | None,
        typer.Option("--to", metavar="FORMAT", help="Write SRC, a dataset or episode, as this."),
    ] = None,
    list_formats: Annotated[
        bool,
        typer.Option("--list", help="Say which formats there are, what each keeps and loses."),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be written and lost; write nothing.")
    ] = False,
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-o",
            metavar="NAME=VALUE",
            help="An option of the format itself (see --list). Can be given more than once.",
        ),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(parser=given_path, metavar="CSV", help="Table of labels (octopi)."),
    ] = None,
    licence: Annotated[
        str | None,
        typer.Option(
            metavar="SPDX",
            help="SPDX expression, such as CC-BY-4.0. Default: said to be unknown.",
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
    decode: Annotated[
        bool,
        typer.Option("--decode", help="Store frames instead of videos (exumi-session)."),
    ] = False,
    keep_going: Annotated[
        bool,
        typer.Option(
            "--keep-going", help="Exit with 0 although some episodes could not be converted."
        ),
    ] = False,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    engine: EngineOption = EngineName.LOCAL,
    ray_address: RayAddressOption = None,
    quiet: QuietOption = False,
) -> None:
    """Convert other formats into a dataset of episodes, and (--to) episodes into other formats.

    Run it again to go on where it was stopped: episodes that are complete are skipped, those whose
    source, labels or options changed are made anew. Exit code 1 if something could not be
    converted; everything else is. With --to, what the format cannot hold is listed before anything
    is written, and the result appears when it is complete.
    """
    from exumi_data.cli import convert_formats, convert_in, convert_out
    from exumi_data.cli.engines import chosen_engine
    from exumi_data.errors import UsageError

    if list_formats:
        convert_formats.show(None if source is None else str(source), output=output)
        return
    if source is None or (destination is None and not dry_run):
        raise UsageError(
            "SRC and DST are missing" if source is None else "DST is missing",
            fix="Say: exumi convert SRC DST. Formats: exumi convert --list",
        )
    settings = convert_formats.settings_of(option or [])
    if decode:
        settings["decode"] = "yes"
    if to_format is not None:
        if from_format not in (None, "exumi"):
            raise UsageError(
                f"--from {from_format} and --to {to_format} at once: every format is converted to "
                "exUMI first",
                fix=f"Say: exumi convert {source} my-dataset --from {from_format}; then: "
                f"exumi convert my-dataset DST --to {to_format}",
            )
        target = destination or Path(f"{source.name}-{to_format}")
        if dry_run:
            convert_out.show_plan(
                source,
                target,
                to_format=to_format,
                settings=settings,
                keep_going=keep_going,
                output=output,
            )
            return
        with chosen_engine(
            engine, ray_address, workers=workers, reads=[source], writes=[target], quiet=quiet
        ) as chosen:
            convert_out.run(
                source,
                target,
                to_format=to_format,
                settings=settings,
                keep_going=keep_going,
                output=output,
                workers=workers,
                engine=chosen,
                quiet=quiet,
            )
        return
    from exumi_converters import ConvertOptions
    from exumi_data.model import UNKNOWN_LICENCE
    from exumi_data.release.licence import stated_licence

    options = ConvertOptions(
        labels=labels,
        licence=UNKNOWN_LICENCE if licence is None else stated_licence(licence),
        task=task,
        rate=rate,
        sensor=sensor,
        pad_type=None if pad_type is None else pad_type.value,
        stream=stream,
        kind=kind.value,
        workers=workers,
        keep_going=keep_going,
        settings=settings,
    )
    if dry_run:
        convert_in.show_plan(source, from_format=from_format, options=options, output=output)
        return
    assert destination is not None  # noqa: S101  # refused above
    with chosen_engine(
        engine,
        ray_address,
        workers=workers,
        reads=[source] if labels is None else [source, labels],
        writes=[destination],
        quiet=quiet,
    ) as chosen:
        convert_in.run(
            source,
            destination,
            from_format=from_format,
            options=options,
            engine=chosen,
            licence_given=licence is not None,
            output=output,
            quiet=quiet,
        )
