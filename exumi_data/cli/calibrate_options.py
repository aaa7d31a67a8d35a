"""Options that the verbs of ``exumi calibrate`` share, and how they end."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exumi_data.cli.options import Format, given_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from exumi_data.clips.markers import MarkerSettings
    from exumi_data.model.description import CalibrationItem
    from exumi_data.synchronisation.timing import Range
    from exumi_recorders.calibration.files import Calibration

__all__ = [
    "EpisodeArgument",
    "MarkerCameraOption",
    "MarkerDictionary",
    "MarkerId",
    "MarkerSize",
    "OutOption",
    "PoseOption",
    "RigOption",
    "asked",
    "check_out",
    "check_stream",
    "finish",
    "marker_settings",
    "numbers",
    "range_of",
    "refusing",
]

OutOption = Annotated[
    Path,
    typer.Option(
        "--out",
        parser=given_path,
        metavar="FILE",
        help="The calibration file; items of the same name are replaced, others stay.",
    ),
]
EpisodeArgument = Annotated[
    Path, typer.Argument(parser=given_path, metavar="EPISODE", help="A recording. Only read.")
]
PoseOption = Annotated[
    str | None, typer.Option("--pose", help="Stream of poses. Default: the only one, or pose.")
]
RigOption = Annotated[
    str | None,
    typer.Option(
        "--rig",
        metavar="FILE",
        help="Read the devices of this rig file now (or: simulated), in place of a recording.",
    ),
]
MarkerCameraOption = Annotated[
    str | None,
    typer.Option(
        "--camera", help="Stream that shows the marker. Default: the only camera, or rgb."
    ),
]
MarkerId = Annotated[int, typer.Option("--marker", min=0, help="Id of the ArUco marker.")]
MarkerSize = Annotated[
    float, typer.Option("--marker-mm", min=1, help="Edge of its black square, mm.")
]
MarkerDictionary = Annotated[str, typer.Option("--dictionary", help="Its dictionary, in OpenCV.")]


def asked(text: str) -> str:
    """Tell the operator what to do, on stderr, and return the line that is typed when it is done.

    Parameters
    ----------
    text : str

    Raises
    ------
    UsageError
        The input has ended.
    """
    import sys

    from exumi_data.errors import UsageError

    print(text, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline()
    if not line:
        print(file=sys.stderr)
        raise UsageError(
            "the input ended before all was read; nothing was written",
            fix="Run it in a terminal, or send a line for each step.",
        )
    return line.strip().lower()


def numbers(text: str, *, count: int | None = None, option: str) -> list[float]:
    """Read numbers that are divided by commas.

    Parameters
    ----------
    text : str
    count : int, optional
        How many there must be.
    option : str
        Named in errors.

    Raises
    ------
    UsageError
        There are others.
    """
    import math

    from exumi_data.errors import UsageError

    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(map(math.isfinite, found)) or (count and len(found) != count):
        many = f"{count} numbers" if count else "numbers"
        raise UsageError(f"{option} is {text!r}", fix=f"Give {many}, divided by commas.")
    return found


def range_of(text: str | None, option: str) -> "Range | None":
    """Read a number, or two that it lies between, in milliseconds; return seconds.

    Parameters
    ----------
    text : str or None
    option : str
        Named in errors.

    Raises
    ------
    UsageError
        It is neither.
    """
    from exumi_data.errors import UsageError
    from exumi_data.synchronisation.timing import Range

    if text is None:
        return None
    found = numbers(text, option=option)
    try:
        low, high = (found[0], found[0]) if len(found) == 1 else found
        return Range(1e-3 * low, 1e-3 * high)
    except ValueError:
        raise UsageError(
            f"{option} is {text!r}", fix="Give one number, or the lowest and the highest: 1,16."
        ) from None


def check_out(out: Path) -> None:
    """Refuse a calibration file that cannot be written into, before any work is done for it.

    Parameters
    ----------
    out : pathlib.Path

    Raises
    ------
    UsageError, MetadataError, UnsupportedError, DamagedDataError, LimitError
        It has no name of one, or holds something else.
    """
    from exumi_recorders.calibration.files import check_name, read_calibration

    check_name(out)
    if out.exists():
        read_calibration(out)


def check_stream(name: str) -> None:
    """Refuse what is no name of a stream.

    Parameters
    ----------
    name : str

    Raises
    ------
    UsageError
        It is none.
    """
    import re

    from exumi_data.errors import UsageError
    from exumi_data.model.base import STREAM_NAME

    if not re.fullmatch(STREAM_NAME, name):
        raise UsageError(
            f"{name!r} is no name of a stream",
            fix="Names are lower-case letters, digits and _, and begin with a letter.",
        )


@contextmanager
def refusing(output: Format) -> Iterator[None]:
    """Say what was refused, and end with exit code 1 then.

    Parameters
    ----------
    output : Format
        JSON has it on stdout as well.

    Raises
    ------
    typer.Exit
        In place of a refusal.
    """
    from exumi_data.calibration_items import CalibrationRefusedError
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import error_console, print_json, printable

    try:
        yield
    except CalibrationRefusedError as error:
        where = "" if error.where is None else f"{error.where}: "
        if output is Format.JSON:
            refused = {"reason": f"{where}{error.what}", "fix": error.fix}
            print_json({"file": None, "items": {}, "refused": [refused]})
        console = error_console()
        console.print("[bold red]refused:[/] ", end="")
        console.print(printable(f"{where}{error.what}"), markup=False)
        if error.fix:
            console.print(f"         {printable(error.fix)}", markup=False)
        raise typer.Exit(FOUND_WRONG) from None


def marker_settings(dictionary: str, number: int, side_mm: float) -> "MarkerSettings":
    """Return which marker to look for.

    Parameters
    ----------
    dictionary : str
    number : int
    side_mm : float

    Raises
    ------
    UsageError
        There is no such dictionary or marker.
    """
    from exumi_data.clips.markers import MarkerSettings
    from exumi_data.errors import UsageError

    try:
        return MarkerSettings(dictionary, number, 1e-3 * side_mm)
    except ValueError as error:
        raise UsageError(str(error)) from None


def finish(
    found: "Calibration",
    out: Path,
    output: Format,
    sources: "Sequence[Path | None]",
    more: dict[str, Any] | None = None,
) -> None:
    """Stamp items with time and digest, put them into the calibration file, and print them.

    Parameters
    ----------
    found : Calibration
    out : pathlib.Path
    output : Format
    sources : sequence of pathlib.Path or None
        What they are made from; None counts for nothing.
    more : dict, optional
        What else the JSON says.
    """
    from exumi_data.calibration_items import now
    from exumi_data.cli.output import print_json, printable
    from exumi_data.model.documents import dump
    from exumi_recorders.calibration.files import Calibration, update
    from exumi_recorders.calibration.sources import digest_of_sources

    said = {"time": now(), "digest": digest_of_sources([path for path in sources if path])}
    items = {name: item.model_copy(update=said) for name, item in found.items.items()}
    update(out, Calibration(items, found.arrays))
    if output is Format.JSON:
        stated = {name: dump(item) for name, item in items.items()}
        print_json({"file": str(out), "items": stated, **(more or {})})
        return
    for name, item in items.items():
        print(printable(f"{name}: {_said(item)}"))
        if item.procedure:
            print(printable(f"  {item.procedure}"))
    print(f"written to {printable(str(out))}")


def _said(item: "CalibrationItem") -> str:
    factor, unit = (1e-6, "ms") if item.unit == "ns" else (1.0, item.unit or "")
    if item.unit == "m":
        factor, unit = 1e3, "mm"
    parts = []
    if isinstance(item.value, int | float):
        parts.append(f"{factor * item.value:.2f} {unit}")
    if item.uncertainty is not None:
        parts.append(f"standard deviation {factor * item.uncertainty:.2f} {unit}")
    if item.residual is not None:
        parts.append(f"residual {factor * item.residual:.2f} {unit}")
    return ", ".join(parts) or (item.method or "imported")
