"""``exumi calibrate camera``."""

from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.calibrate_options import OutOption, check_out, check_stream, finish
from exumi_data.cli.options import Format, FormatOption, epilog, given_path

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate camera gopro_intrinsics_2_7k.json --stream rgb --out rig.json",
    "exumi calibrate camera wrist.yaml --stream rgb --fisheye --size 1920x1080 --out rig.json",
)


def run(
    file: Annotated[
        Path,
        typer.Argument(
            parser=given_path,
            metavar="FILE",
            help="Of OpenImuCameraCalibrator (JSON), OpenCV (YAML, JSON, XML) or ROS (YAML).",
        ),
    ],
    out: OutOption,
    stream: Annotated[str, typer.Option(help="The camera's stream.")],
    fisheye: Annotated[
        bool | None,
        typer.Option("--fisheye/--pinhole", help="Model, where the file does not say."),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Of the images, where the file does not say."),
    ] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Import the intrinsics of a camera."""
    from exumi_data.errors import UsageError
    from exumi_recorders.calibration.camera import intrinsics_item, read_intrinsics
    from exumi_recorders.calibration.files import Calibration

    check_out(out)
    check_stream(stream)
    wanted = None
    if size is not None:
        width, _, height = size.partition("x")
        if not (width.isdecimal() and height.isdecimal()):
            raise UsageError(f"--size is {size!r}", fix="Such as 1920x1080.")
        wanted = int(width), int(height)
    camera, residual, method = read_intrinsics(file, fisheye=fisheye, size=wanted)
    name, item = intrinsics_item(camera, residual, method, stream)
    finish(Calibration({name: item}), out, output, [file])
