"""``exumi recover``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_recorders.finalise.episode import Finalised

__all__ = ["EPILOG", "run"]

EPILOG = epilog("exumi recover my-dataset", "exumi recover my-dataset --dry-run --format json")

_DAMAGES_SHOWN = 5


def run(
    paths: Annotated[
        list[Path],
        typer.Argument(
            parser=given_path,
            metavar="PATH...",
            help="Datasets, their folders .recording, or journals in them.",
        ),
    ],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what is there, and write nothing.")
    ] = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Make episodes of what was being recorded when the program or the power went.

    A journal is removed only when its episode was written and read back. One that is being recorded
    right now is left alone, and so is one that was discarded. Running it again changes nothing.
    """
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import error_console, print_json, progress_of
    from exumi_recorders.finalise.recover import recover

    with progress_of("Recovering", quiet=quiet) as update:
        result = recover(paths, dry_run=dry_run, on_done=update)
    if output is Format.JSON:
        print_json(result.to_json())
    else:
        for one in result.done:
            print(_line(one))
            for damage in one.damages[:_DAMAGES_SHOWN]:
                lost = "" if damage.lost is None else f", {damage.lost} samples lost"
                print(f"  {damage.path}: {damage.bytes:,} bytes at {damage.offset:,}", end="")
                print(f" ({damage.what}){lost}")
            if len(one.damages) > _DAMAGES_SHOWN:
                print(f"  and {len(one.damages) - _DAMAGES_SHOWN} more (--format json lists all)")
        if not result.done and not result.failed:
            print("nothing to recover")
    console = error_console()
    if not quiet:
        for notice in result.notices:
            console.print(f"note: {notice}", style="dim", markup=False)
    for path, reason in result.failed:
        console.print("[bold red]error:[/] ", end="")
        text = reason if str(path) in reason else f"{path}: {reason}"
        console.print(text, markup=False)
    if result.failed:
        raise typer.Exit(FOUND_WRONG)


def _line(one: "Finalised") -> str:
    total = sum((one.samples or {}).values())
    said = {
        "finalised": f"{one.episode}: {total:,} samples",
        "found": f"{one.journal}: {total:,} samples, not finalised",
        "present": f"{one.episode or one.journal}: was there already",
        "discarded": f"{one.journal}: was discarded, stays",
        "empty": f"{one.journal}: nothing was recorded",
        "recording": f"{one.journal}: is being recorded or finalised, left alone",
    }[one.outcome]
    if one.crashed:
        said += "; the recorder ended without stopping"
    if one.truncated is not None:
        said += f"; it ended early ({one.truncated})"
    return said
