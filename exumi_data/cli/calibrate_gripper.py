"""``exumi calibrate gripper``."""

import math
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
    from exumi_data.gripper_readings import GripperReadings

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate gripper --rig rig.toml --openings-mm 0,10,20,30,40,50,60,70,80 --out rig.json",
    "exumi calibrate gripper readings.csv --out rig.json",
    "exumi calibrate gripper gripper_calibration.json --out rig.json",
    "exumi calibrate gripper steps.zarr --openings-mm 0,10,20,30,40,50,60,70,80 --out rig.json",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    out: OutOption,
    readings: Annotated[
        Path | None,
        typer.Argument(
            parser=given_path,
            metavar="[READINGS]",
            help="CSV (count, opening_mm), exUMI's JSON, or an episode in which the gripper was "
            "set to openings, one by one.",
        ),
    ] = None,
    rig: RigOption = None,
    device: Annotated[
        str | None, typer.Option(help="Of a rig: the encoder, if it has several.")
    ] = None,
    openings_mm: Annotated[
        str | None,
        typer.Option(
            help="Of an episode or a rig: the openings in their order, divided by commas."
        ),
    ] = None,
    stream: Annotated[str | None, typer.Option(help="Its stream of widths.")] = None,
    unit: Annotated[
        str | None, typer.Option(help="Of the openings in a file, whatever it says: m, cm, mm.")
    ] = None,
    gauge_mm: Annotated[
        float,
        typer.Option(min=0.0, max=10.0, help="How well openings were set: standard deviation."),
    ] = 0.5,
    name: Annotated[str, typer.Option(help="Of the item: raw.transform names it.")] = "width_map",
    output: FormatOption = Format.TEXT,
) -> None:
    """Find the map from encoder counts to openings, from readings at known openings.

    With --rig, openings are set and read one by one. Openings 1 cm apart or less. Counts may run
    over the encoder's end. What does not go one way, or is too coarse, is refused.
    """
    from exumi_data.errors import UsageError
    from exumi_data.gripper_readings import fit_gripper, gripper_item
    from exumi_recorders.calibration.files import Calibration

    if (readings is None) == (rig is None):
        raise UsageError("one of READINGS and --rig", fix="Give the one that you have.")
    check_out(out)
    check_stream(name)
    openings = None
    if openings_mm is not None:
        openings = [1e-3 * value for value in numbers(openings_mm, option="--openings-mm")]
    with refusing(output):
        found = _readings(readings, rig, device, stream, unit, openings)
        fitted = fit_gripper(found, gauge_m=1e-3 * gauge_mm)
    table = [
        {
            "opening_mm": round(1e3 * opening, 4),
            "count": round(count, 2),
            "left_out_mm": _number(1e3 * residual),
        }
        for (opening, count), residual in zip(fitted.knots, fitted.residual_m, strict=True)
    ]
    if output is Format.TEXT:
        from exumi_data.cli.output import plain_table, print_table, result_console

        shown = plain_table(("opening mm", "right"), ("count", "right"), ("left out mm", "right"))
        for row in table:
            off = row["left_out_mm"]
            cells = (row["opening_mm"], row["count"])
            shown.add_row(*(f"{cell:.1f}" for cell in cells), "" if off is None else f"{off:+.2f}")
        print_table(shown, result_console())
    finish(Calibration({name: gripper_item(fitted)}), out, output, [readings], {"readings": table})


def _readings(  # what a user says of where they are
    readings: Path | None,
    rig: str | None,
    device: str | None,
    stream: str | None,
    unit: str | None,
    openings: list[float] | None,
) -> "GripperReadings":
    from exumi_data.errors import UsageError
    from exumi_data.gripper_readings import check_openings, read_gripper_file

    if openings is not None:
        # Before the operator sets one after the other.
        check_openings(openings)
    if rig is not None:
        return _live(rig, device, openings)
    assert readings is not None  # noqa: S101  # one of the two was given
    if openings is not None:
        return _recorded(readings, stream, openings)
    if readings.is_dir() or readings.name.endswith(".zarr.zip"):
        raise UsageError(
            "which openings were set in it is not said",
            where=readings,
            fix="Name them: --openings-mm 0,10,20,30",
        )
    return read_gripper_file(readings, unit=unit)


def _live(rig: str, device: str | None, openings: list[float] | None) -> "GripperReadings":
    import sys

    from exumi_data.errors import UsageError
    from exumi_recorders.calibration.live import encoder_of, live_rig, read_openings

    if openings is None:
        raise UsageError(
            "which openings are set is not said", fix="Name them: --openings-mm 0,10,20,30"
        )
    with live_rig(rig) as started, encoder_of(started, device).opened() as encoder:
        return read_openings(
            encoder, openings, asked, lambda text: print(text, file=sys.stderr, flush=True)
        )


def _recorded(path: Path, stream: str | None, openings: list[float]) -> "GripperReadings":
    from exumi_data.episode import open_episode
    from exumi_data.errors import UsageError
    from exumi_data.gripper_readings import readings_at_rest
    from exumi_recorders.calibration.recordings import stream_of

    with open_episode(path) as episode:
        width = stream_of(episode, "width", stream)
        raw = width.raw
        if raw is None or raw.dtype.kind not in "iu":
            raise UsageError(
                f"{width.name!r} has no raw counts",
                where=path,
                fix="Record the encoder's own values.",
            )
        modulus = getattr(getattr(width.metadata, "raw", None), "modulus", None)
        if modulus is None and raw.dtype.kind == "u":
            modulus = 4096  # counts with their turns can be negative
        return readings_at_rest(width.time, raw, openings, modulus=modulus)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 4)
