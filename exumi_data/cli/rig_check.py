"""``exumi rig check``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.calibrate_options import asked
from exumi_data.cli.options import Format, FormatOption, epilog, given_path

if TYPE_CHECKING:
    from collections.abc import Callable

    from exumi_recorders.rig.checking import RigReport
    from exumi_recorders.rig.gate import Gate

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi rig check rig.toml",
    "exumi rig check rig.toml --seconds 20 --out my-dataset",
    "exumi rig check rig.toml --touch",
    "exumi rig check simulated --format json",
)

_STYLES = {"pass": "green", "warn": "yellow", "fail": "bold red", "skipped": "dim"}
_SIMULATED_WIDTH = 160


def run(
    rig: Annotated[str, typer.Argument(metavar="FILE", help="The rig file, or: simulated.")],
    seconds: Annotated[
        float, typer.Option(min=0.5, max=600, help="How long to watch the devices.")
    ] = 3.0,
    out: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="DATASET",
            help="Where to record to, for its disk. Default: that of the rig file.",
        ),
    ] = None,
    touch: Annotated[
        bool,
        typer.Option("--touch", help="Then have each finger pressed: are left and right right?"),
    ] = False,
    output: FormatOption = Format.TEXT,
) -> None:
    """Open all devices, watch them for some seconds, and say everything that is not well.

    Devices and their rates, losses, magnet, world frame, record flag, left and right, fingers
    without contact, calibration, disk and clock. Nothing is recorded. Exit code 1 if a gate fails;
    a warning is yours to judge.
    """
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import print_json

    report = _checked(rig, seconds, out, asked if touch else None)
    if output is Format.JSON:
        print_json(report.to_json())
    else:
        _print(report)
    if not report.passed:
        raise typer.Exit(FOUND_WRONG)


def _checked(
    name: str, seconds: float, out: Path | None, ask: "Callable[[str], str] | None"
) -> "RigReport":
    from exumi_data.cli.output import error_console
    from exumi_data.errors import UsageError
    from exumi_recorders.rig.checking import check_rig
    from exumi_recorders.rig.loading import load_rig
    from exumi_recorders.rig.model import expanded
    from exumi_recorders.rig.simulated import NAME, SimulatedSettings, simulated_rig

    console = error_console()
    if name != NAME:
        rig = load_rig(expanded(str(given_path(name))))
        console.print(f"watching for {seconds:g} s ...", style="dim")
        return check_rig(rig, out=out, seconds=seconds, ask=ask)
    if ask is not None:
        raise UsageError("nobody can press simulated fingers", fix="Leave out --touch.")
    console.print("starting the simulated devices ...", style="dim")
    settings = SimulatedSettings(seconds=seconds + 5.0, frame_width=_SIMULATED_WIDTH)
    with simulated_rig(settings) as started:
        return check_rig(started.rig, calibrated=started.calibrated, out=out, seconds=seconds)


def _print(report: "RigReport") -> None:
    from collections import Counter

    from exumi_data.cli.output import plain, plain_table, print_table, result_console

    console = result_console()
    table = plain_table(("", "left"), ("gate", "left"), ("of", "left"), ("found", "left"))
    for gate in report.gates:
        verdict = f"[{_STYLES[gate.verdict]}]{gate.verdict}[/]"
        table.add_row(verdict, gate.name, plain(gate.where), plain(_found(gate)))
    print_table(table, console)
    todo = [gate for gate in report.gates if gate.verdict in {"fail", "warn"}]
    if todo:
        console.print("\nto do:")
    for text in dict.fromkeys(gate.what_to_do for gate in todo):
        about = [gate for gate in todo if gate.what_to_do == text]
        style = _STYLES["fail" if any(gate.verdict == "fail" for gate in about) else "warn"]
        names = ", ".join(dict.fromkeys(f"{gate.name} {gate.where}".strip() for gate in about))
        console.print(f"  [{style}]{plain(names)}[/]: {plain(text)}", soft_wrap=True)
    counts = Counter(gate.verdict for gate in report.gates)
    said = ", ".join(
        f"{counts[each]} {each}" for each in ("fail", "warn", "skipped") if counts[each]
    )
    console.print(
        f"\n{counts['pass']} of {len(report.gates)} gates pass{f'; {said}' if said else ''}"
    )


def _found(gate: "Gate") -> str:
    if gate.verdict in {"pass", "skipped"} or gate.found == gate.expected:
        return gate.found
    return f"{gate.found} (expected: {gate.expected})"
