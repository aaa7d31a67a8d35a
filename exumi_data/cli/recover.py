"""``exumi recover``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_recorders.finalise.episode import Finalised
    from exumi_recorders.finalise.purging import Purge

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi recover my-dataset",
    "exumi recover my-dataset --dry-run --format json",
    "exumi recover my-dataset --purge-discarded --older-than 30",
)

_DAMAGES_SHOWN = 5
_DAYS_KEPT = 7.0


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
    purge_discarded: Annotated[
        bool,
        typer.Option(
            "--purge-discarded",
            help="Instead: remove the samples of discarded journals, for good.",
        ),
    ] = False,
    older_than: Annotated[
        float | None,
        typer.Option(
            "--older-than",
            metavar="DAYS",
            min=0.0,
            help="Purge what was discarded at least so long ago. Default: 7.",
        ),
    ] = None,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Make episodes of what was being recorded when the program or the power went.

    A journal is removed only when its episode was written and read back. One that is being recorded
    right now is left alone, and so is one that was discarded. Running it again changes nothing.

    A discarded journal can be taken back until it is purged; then its header and the reason stay.
    """
    from exumi_data.errors import UsageError

    if purge_discarded:
        _purge(paths, older_than, dry_run=dry_run, output=output)
    elif older_than is not None:
        raise UsageError("--older-than is of --purge-discarded", fix="Give both, or none.")
    else:
        _recover(paths, dry_run=dry_run, output=output, quiet=quiet)


def _recover(paths: list[Path], *, dry_run: bool, output: Format, quiet: bool) -> None:
    from exumi_data.cli.output import error_console, print_json, printable, progress_of
    from exumi_recorders.finalise.recover import recover

    with progress_of("Recovering", quiet=quiet) as update:
        result = recover(paths, dry_run=dry_run, on_done=update)
    if output is Format.JSON:
        print_json(result.to_json())
    else:
        for one in result.done:
            print(printable(_line(one)))
            for damage in one.damages[:_DAMAGES_SHOWN]:
                lost = "" if damage.lost is None else f", {damage.lost} samples lost"
                where = f"{damage.path}: {damage.bytes:,} bytes at {damage.offset:,}"
                print(printable(f"  {where} ({damage.what}){lost}"))
            if len(one.damages) > _DAMAGES_SHOWN:
                print(f"  and {len(one.damages) - _DAMAGES_SHOWN} more (--format json lists all)")
        if not result.done and not result.failed:
            print("nothing to recover")
    if not quiet:
        for notice in result.notices:
            error_console().print(f"note: {notice}", style="dim", markup=False)
    _end(result.failed)


def _purge(paths: list[Path], older_than: float | None, *, dry_run: bool, output: Format) -> None:
    from exumi_data.cli.output import print_json
    from exumi_recorders.finalise.purging import purge_discarded

    days = _DAYS_KEPT if older_than is None else older_than
    result = purge_discarded(paths, older_than_days=days, dry_run=dry_run)
    if output is Format.JSON:
        print_json(result.to_json())
    else:
        _print_purge(result, dry_run=dry_run)
    _end(result.failed)


def _print_purge(result: "Purge", *, dry_run: bool) -> None:
    from exumi_data.cli.output import printable

    for one in result.done:
        said = {"purged": "purged", "found": "would be purged", "kept": "too young, stays"}
        when = f"discarded {max(one.days, 0.0):.1f} days ago ({one.reason or 'no reason given'})"
        print(printable(f"{one.journal}: {said[one.outcome]}, {one.bytes:,} bytes, {when}"))
    if dry_run:
        size = sum(one.bytes for one in result.done if one.outcome == "found")
        print(f"{size:,} bytes would be freed")
    else:
        print(f"{result.freed:,} bytes freed")


def _end(failed: tuple[tuple[Path, str], ...]) -> None:
    """Say what failed; end with an error if anything did."""
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import error_console

    console = error_console()
    for path, reason in failed:
        console.print("[bold red]error:[/] ", end="")
        text = reason if str(path) in reason else f"{path}: {reason}"
        console.print(text, markup=False)
    if failed:
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
