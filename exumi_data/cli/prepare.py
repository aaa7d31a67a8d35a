"""``exumi prepare``."""

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

__all__ = ["EPILOG", "Rgb", "Tactile", "run"]

EPILOG = epilog(
    "exumi prepare my-dataset my-training-set",
    "exumi prepare my-dataset my-training-set --size 224 --gray --quality 95",
    "exumi prepare my-dataset my-training-set --lossless",
    "exumi prepare my-dataset my-training-set --tactile combined --rgb rectify",
)


class Tactile(StrEnum):
    """What becomes of two fingers."""

    SEPARATE = "separate"
    COMBINED = "combined"


class Rgb(StrEnum):
    """What becomes of camera frames."""

    RESIZE = "resize"
    RECTIFY = "rectify"


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    source: Annotated[
        Path,
        typer.Argument(
            parser=given_path, metavar="SRC", help="A dataset or an episode. Only read."
        ),
    ],
    destination: Annotated[
        Path,
        typer.Argument(
            parser=given_path,
            metavar="DST",
            help="The training set: a new or empty folder, or one to go on with.",
        ),
    ],
    size: Annotated[
        int, typer.Option(min=8, max=4096, help="Height and width of frames, pixels.")
    ] = 224,
    gray: Annotated[bool, typer.Option("--gray", help="Store tactile frames in one channel.")] = (
        False
    ),
    quality: Annotated[
        int | None, typer.Option(min=1, max=100, help="JPEG quality. Default: 95.")
    ] = None,
    lossless: Annotated[
        bool, typer.Option("--lossless", help="Store pixels instead of JPEG files: larger.")
    ] = False,
    tactile: Annotated[
        Tactile, typer.Option(help="One image a finger, or one of both as exUMI trains on.")
    ] = Tactile.SEPARATE,
    rgb: Annotated[
        Rgb, typer.Option(help="Resize camera frames, or take their distortion out as well.")
    ] = Rgb.RESIZE,
    fov: Annotated[
        float | None,
        typer.Option(
            min=1, max=170, help="Field of view of rectified camera frames, degrees. Default: 90."
        ),
    ] = None,
    pair_within: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=10,
            help="How far apart frames of two fingers may be to be combined, seconds. Default: "
            "one frame interval.",
        ),
    ] = None,
    keep_going: Annotated[
        bool,
        typer.Option(
            "--keep-going", help="Exit with 0 although some episodes could not be prepared."
        ),
    ] = False,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    engine: EngineOption = EngineName.LOCAL,
    ray_address: RayAddressOption = None,
    quiet: QuietOption = False,
) -> None:
    """Make a training set: frames resized once, each of them one read away.

    The result is a dataset in the same format; every lossy step is on record in it. Run it again
    to go on where it was stopped. Exit code 1 if some episodes could not be prepared.
    """
    from exumi_converters import prepare
    from exumi_data.cli.engines import chosen_engine
    from exumi_data.cli.run_report import finish, run_progress
    from exumi_data.errors import UsageError

    if lossless and quality is not None:
        raise UsageError("--lossless and --quality exclude each other", fix="Give one of them.")
    if fov is not None and rgb is not Rgb.RECTIFY:
        raise UsageError("--fov goes with --rgb rectify", fix="Add it, or leave --fov out.")
    if pair_within is not None and tactile is not Tactile.COMBINED:
        raise UsageError(
            "--pair-within goes with --tactile combined", fix="Add it, or leave --pair-within out."
        )
    with (
        chosen_engine(
            engine,
            ray_address,
            workers=workers,
            reads=[source],
            writes=[destination],
            quiet=quiet,
        ) as chosen,
        run_progress("Preparing", quiet=quiet) as on_progress,
    ):
        report = prepare(
            source,
            destination,
            size=size,
            gray=gray,
            quality=95 if quality is None else quality,
            lossless=lossless,
            tactile=tactile.value,
            rgb=rgb.value,
            fov_deg=90.0 if fov is None else fov,
            pair_within_s=pair_within,
            workers=workers,
            engine=chosen,
            on_progress=on_progress,
        )
    finish(report, output=output, quiet=quiet, keep_going=keep_going)
