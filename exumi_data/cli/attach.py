"""``exumi attach``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.calibrate_options import (
    MarkerDictionary,
    MarkerId,
    MarkerSize,
    marker_settings,
)
from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_recorders.attach import AttachReport

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi attach card/DCIM/100GOPRO my-session.zarr --out my-demos --dry-run",
    "exumi attach card/DCIM/100GOPRO my-session.zarr --out my-demos",
    "exumi attach card/DCIM/100GOPRO my-sessions --session 01932c00-... --out my-demos",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    clips: Annotated[
        Path,
        typer.Argument(
            parser=given_path, metavar="CLIPS", help="Folder of clips from the camera's card."
        ),
    ],
    session: Annotated[
        Path,
        typer.Argument(
            parser=given_path,
            metavar="SESSION",
            help="The episode that the hub recorded, or a dataset that holds it. Only read.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            parser=given_path,
            metavar="DATASET",
            help="The dataset: a new or empty folder, or one to go on with.",
        ),
    ],
    sessions: Annotated[
        list[str] | None,
        typer.Option(
            "--session", metavar="ID", help="Of the episodes of SESSION, this one. May be repeated."
        ),
    ] = None,
    pose: Annotated[
        str | None,
        typer.Option(metavar="STREAM", help="Poses of the hand with the camera, if not implied."),
    ] = None,
    stream: Annotated[str, typer.Option(help="What the clips' stream is called.")] = "rgb",
    margin: Annotated[
        float,
        typer.Option(min=0, max=60, help="Seconds of the session kept before and after a clip."),
    ] = 0.5,
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="STREAM", help="Leave a stream of the session out. May be repeated."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FILE",
            help="Calibration file with the camera's intrinsics, for clips without a gyroscope. "
            "Default: those of the session.",
        ),
    ] = None,
    marker: MarkerId = 4,
    marker_mm: MarkerSize = 60.0,
    dictionary: MarkerDictionary = "DICT_4X4_50",
    check_frames: Annotated[
        bool,
        typer.Option(
            "--check-frames",
            help="Decode every frame of the clips, and list only those that can be decoded.",
        ),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what belongs where, and write nothing.")
    ] = False,
    keep_going: Annotated[
        bool,
        typer.Option("--keep-going", help="Exit with 0 although some clips were left out."),
    ] = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Attach clips of a camera to the session in which they were filmed: one episode a clip.

    Clips are placed by the camera's gyroscope against the hand's poses; those without one, by a
    sweep before a marker, and only their frames are decoded. Clocks only help where that leaves a
    doubt. The clip stays as it is, and the session's streams are cut. Run it again to go on where
    it was stopped. Exit code 1 if a clip was left out.
    """
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import print_json, progress_of
    from exumi_recorders.attach import AttachOptions, attach

    options = AttachOptions(
        sessions=tuple(sessions or ()),
        pose=pose,
        stream=stream,
        margin_s=margin,
        without=tuple(without or ()),
        calibration=calibration,
        marker=marker_settings(dictionary, marker, marker_mm),
        check_frames=check_frames,
        dry_run=dry_run,
    )
    with progress_of("Attaching", quiet=quiet) as update:
        report = attach(
            clips,
            session,
            out,
            options=options,
            on_progress=lambda what, done, total: update(done, total, what),
        )
    if output is Format.JSON:
        print_json(report.to_json())
    else:
        _print(report)
    _print_notes(report, quiet=quiet)
    if report.left_out and not keep_going:
        raise typer.Exit(FOUND_WRONG)


def _print(report: "AttachReport") -> None:
    from exumi_data.cli.output import (
        plain,
        plain_table,
        print_table,
        printable,
        result_console,
        time_text,
    )

    table = plain_table(
        ("clip", "left"), ("begins at", "right"), ("±", "right"), ("fit", "right"), ("", "left")
    )
    for clip in report.clips:
        if clip.start_s is None or clip.sigma_s is None or clip.correlation is None:
            table.add_row(plain(clip.name), "-", "", "", plain(f"{clip.status}: {clip.reason}"))
            continue
        said = "; ".join((clip.status, *filter(None, (clip.reason,)), *clip.doubts, *clip.notes))
        table.add_row(
            plain(clip.name),
            f"{clip.start_s:.3f} s",
            time_text(clip.sigma_s),
            f"{clip.correlation:.3f}",
            plain(said),
        )
    print_table(table, result_console())
    counts = dict.fromkeys(("attached", "present", "placed", "refused", "failed"), 0)
    for clip in report.clips:
        counts[clip.status] += 1
    parts = [f"{number:,} {status}" for status, number in counts.items() if number]
    print(printable(f"{report.destination}: {', '.join(parts)} of {len(report.clips):,} clips"))


def _print_notes(report: "AttachReport", *, quiet: bool) -> None:
    from exumi_data.cli.output import error_console

    console = error_console()
    for missing in report.missing:
        console.print(
            f"[bold yellow]warning:[/] the hand is at work from {missing.start_s:.1f} s to "
            f"{missing.stop_s:.1f} s of {missing.session}, and there is no clip of it"
        )
    for clip in report.left_out:
        console.print("[bold red]error:[/]", end=" ")
        console.print(f"{clip.name} was left out: {clip.reason}", markup=False)
    if quiet:
        return
    for note in report.notices:
        console.print(f"note: {note}", style="dim", markup=False)
    if any(clip.status in ("attached", "present") for clip in report.clips):
        console.print(f"Next: exumi validate {report.destination}", style="dim", markup=False)
