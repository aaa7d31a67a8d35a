"""``exumi calibrate tactile``."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.calibrate_options import (
    OutOption,
    RigOption,
    asked,
    check_out,
    check_stream,
    finish,
    numbers,
    refusing,
)
from exumi_data.cli.options import Format, FormatOption, epilog, given_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from exumi_recorders.calibration.files import Calibration

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate tactile --rig rig.toml --out rig.json",
    "exumi calibrate tactile rest.zarr --stream tactile_left --out rig.json",
    "exumi calibrate tactile play.zarr --stream tactile_left --has-contact --out rig.json",
    "exumi calibrate tactile --stream tactile_left --ninedtact sensor_1 --out rig.json",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    out: OutOption,
    stream: Annotated[
        str | None,
        typer.Option(help="The tactile stream that it is about. Default with --rig: all."),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Argument(
            parser=given_path,
            metavar="[RECORDING]",
            help="An episode, or a folder of images, in which nothing is touched.",
        ),
    ] = None,
    rig: RigOption = None,
    has_contact: Annotated[
        bool,
        typer.Option("--has-contact", help="There is contact: select quiet frames."),
    ] = False,
    ninedtact: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FOLDER",
            help="9DTact's calibration of this sensor: rectification maps and depth table.",
        ),
    ] = None,
    crop: Annotated[
        str | None, typer.Option(help="Rows,columns of its rectified images. Default: 340,460.")
    ] = None,
    mm_per_px: Annotated[
        str | None, typer.Option(help="Scale across,down of images that are not rectified.")
    ] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Capture a finger's reference without contact; import its rectification, depth and scale."""
    from exumi_data.errors import UsageError
    from exumi_recorders.calibration.files import merge

    if recording is not None and rig is not None:
        raise UsageError("a recording and --rig exclude each other", fix="Give one of them.")
    check_out(out)
    if crop is not None and ninedtact is None:
        raise UsageError("--crop goes with --ninedtact", fix="Add it, or leave --crop out.")
    parts: dict[str, Calibration] = {}
    if stream is not None:
        check_stream(stream)
        with refusing(output):
            parts = _of_stream(
                stream, recording, ninedtact, crop, mm_per_px, has_contact=has_contact
            )
    elif recording is not None or ninedtact is not None or mm_per_px is not None:
        raise UsageError("which sensor it is about is not said", fix="Name it with --stream.")
    if rig is not None:
        with refusing(output):
            parts["reference"] = _live(rig, stream)
    if not parts:
        raise UsageError(
            "nothing to calibrate from",
            fix="Give a recording, --rig, --ninedtact or --mm-per-px.",
        )
    finish(merge(parts), out, output, [recording, ninedtact])


def _of_stream(  # what a user says of a sensor
    stream: str,
    recording: Path | None,
    ninedtact: Path | None,
    crop: str | None,
    mm_per_px: str | None,
    *,
    has_contact: bool,
) -> "dict[str, Calibration]":
    from exumi_recorders.calibration import tactile

    parts: dict[str, Calibration] = {}
    if recording is not None:
        with _frames(recording, stream) as frames:
            capture = tactile.selected_reference if has_contact else tactile.captured_reference
            parts["reference"] = capture(frames, stream)
    if ninedtact is not None:
        parts.update(_imported(ninedtact, stream, crop))
    if mm_per_px is not None:
        across, down = numbers(mm_per_px, count=2, option="--mm-per-px")
        parts["scale"] = tactile.scale((across, down), stream, method="given by the operator")
    return parts


def _live(rig: str, stream: str | None) -> "Calibration":
    from exumi_recorders.calibration.live import capture_references, live_rig, tactile_of

    with live_rig(rig) as started:
        ports = tactile_of(started, stream)
        names = ", ".join(port.stream for port in ports)
        asked(f"nothing may touch the fingers ({names}); then Enter: ")
        return capture_references(ports)


def _imported(folder: Path, stream: str, crop: str | None) -> "dict[str, Calibration]":
    from exumi_data.errors import UsageError
    from exumi_recorders.calibration import tactile

    size = None
    if crop is not None:
        rows, columns = numbers(crop, count=2, option="--crop")
        size = round(rows), round(columns)
    parts: dict[str, Calibration] = {}
    maps, table = folder / "camera_calibration", folder / "depth_calibration/Pixel_to_Depth.npy"
    if (maps / "row_index.npy").exists():
        parts["rectification"] = tactile.rectification(maps, stream, crop_px=size)
    if table.exists():
        parts["depth"] = tactile.depth_table(table, stream)
    if not parts:
        raise UsageError(
            "no calibration of 9DTact",
            where=folder,
            fix="It holds camera_calibration/row_index.npy, col_index.npy and position_scale.npy, "
            "or depth_calibration/Pixel_to_Depth.npy.",
        )
    return parts


@contextmanager
def _frames(recording: Path, stream: str) -> "Iterator[Sequence[np.ndarray]]":
    from exumi_data.episode import open_episode
    from exumi_recorders.calibration.recordings import ImageFolder, stream_of

    if recording.is_dir() and not (recording / "zarr.json").exists():
        yield ImageFolder(recording)
        return
    with open_episode(recording) as episode:
        yield stream_of(episode, "tactile", stream).frames  # type: ignore[misc]  # len and [i], which is what is needed of a sequence
