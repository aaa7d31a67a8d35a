"""``exumi view``."""

import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import (
    DataArgument,
    Format,
    FormatOption,
    QuietOption,
    epilog,
    given_path,
)

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset
    from exumi_data.episode import Episode
    from exumi_data.view.names import ViewOptions
    from exumi_data.view.report import ViewReport

__all__ = ["EPILOG", "run"]

_MAGIC = b"RRF"
"""With which Rerun files begin, whatever their version."""

EPILOG = epilog(
    "exumi view my-dataset",
    "exumi view my-dataset --episode 7d11 --web",
    "exumi view my-dataset --max-episodes 3 --save my-dataset.rrd",
)

_EPISODES = 16
_PORT = 9090


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    path: DataArgument,
    episode: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID",
            help="Episode of a dataset: its id, or the beginning or end of it where that is "
            "enough; may be given several times.",
        ),
    ] = None,
    stream: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Stream to show; may be given several times."),
    ] = None,
    max_episodes: Annotated[
        int, typer.Option(min=1, help="Most episodes of a dataset, the first ones.")
    ] = _EPISODES,
    save: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FILE.rrd",
            help="Write a file for Rerun's viewers instead of opening one.",
        ),
    ] = None,
    web: Annotated[
        bool, typer.Option("--web", help="Open in the browser, served on this machine only.")
    ] = False,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Of --web; 0 takes a free one.")
    ] = _PORT,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="With --web: print the address, open no browser.")
    ] = False,
    decode_video: Annotated[
        bool,
        typer.Option(
            "--decode-video",
            help="Show video as decoded frames: for viewers that cannot decode it themselves.",
        ),
    ] = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Look at episodes in Rerun: images, touch, poses, width, forces and events, in time.

    Opens a window, or serves a browser (--web), or writes a file (--save). Exit code 1 if something
    is damaged and therefore missing from the view. Needs: pip install "exumi-data[view]".
    """
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.view.names import ViewOptions
    from exumi_data.view.sdk import require_rerun

    require_rerun()
    _check(save, web=web, no_open=no_open)
    source = _chosen(path, episode or [])
    options = ViewOptions(streams=tuple(stream or ()), decode_video=decode_video)
    if save is not None and not web:
        report = _write(source, save, options, max_episodes, quiet=quiet)
        _tell(report, save, output, quiet=quiet)
    else:
        with tempfile.TemporaryDirectory(prefix="exumi-view-") as folder:
            file = Path(folder, "view.rrd") if save is None else save
            report = _write(source, file, options, max_episodes, quiet=quiet)
            _tell(report, save, output, quiet=quiet)
            if web:
                _serve(file, port, no_open=no_open)
            else:
                from exumi_data.view.looking import look

                look(file)
    if report.is_damaged:
        raise typer.Exit(FOUND_WRONG)


def _check(save: Path | None, *, web: bool, no_open: bool) -> None:
    """Refuse what cannot work before anything long is done."""
    from exumi_data.errors import UsageError
    from exumi_data.opening import check_outside
    from exumi_data.view.looking import check_display

    if save is not None:
        check_outside(save)
    if save is not None and save.suffix != ".rrd":
        raise UsageError("is no name of a Rerun file", where=save, fix="Name it FILE.rrd.")
    if save is not None and save.is_dir():
        raise UsageError("is a folder", where=save, fix="Name a file in it.")
    if save is not None and save.exists() and not _is_recording(save):
        raise UsageError("exists and is no Rerun file", where=save, fix="Name another file.")
    if no_open and not web:
        raise UsageError("--no-open goes with --web")
    if save is None and not web:
        check_display()


def _is_recording(file: Path) -> bool:
    with file.open("rb") as opened:
        return opened.read(len(_MAGIC)) == _MAGIC


def _chosen(path: str, named: Sequence[str]) -> "Episode | Dataset":
    import exumi_data
    from exumi_data.editing.selection import find_ids
    from exumi_data.errors import UsageError

    source = exumi_data.open(path)
    if not named:
        return source
    if isinstance(source, exumi_data.Episode):
        raise UsageError("is one episode", where=path, fix="Leave out --episode.")
    return source.select(list(dict.fromkeys(find_ids(source, named))))


def _write(
    source: "Episode | Dataset",
    file: Path,
    options: "ViewOptions",
    max_episodes: int,
    *,
    quiet: bool,
) -> "ViewReport":
    from exumi_data.cli.output import printable, progress_of
    from exumi_data.view.saving import save_view

    with progress_of("Reading", quiet=quiet) as update:
        return save_view(
            source,
            file,
            options=options,
            max_episodes=max_episodes,
            on_progress=lambda done, total, name: update(done, total, printable(name)),
        )


def _tell(report: "ViewReport", saved: Path | None, output: Format, *, quiet: bool) -> None:
    from exumi_data.cli.output import error_console, print_json, printable, size_text, time_text
    from exumi_data.wording import counted

    if output is Format.JSON:
        print_json(report.to_json())
    elif saved is not None:
        count = f"{len(report.episodes):,} of {counted(report.available, 'episode')}"
        print(
            printable(f"{saved}: {count}, {size_text(report.bytes)}, {time_text(report.seconds)}")
        )
    console = error_console()
    for line in _troubles(report):
        console.print("[bold red]damaged:[/] ", end="")
        console.print(printable(line), markup=False)
    if not quiet:
        for line in _notes(report):
            console.print(f"note: {printable(line)}", style="dim", markup=False)


def _troubles(report: "ViewReport") -> list[str]:
    lines = [f"{one.id} cannot be read: {one.reason}" for one in report.unreadable]
    for episode in report.episodes:
        for fault in episode.faults:
            frames = "frame is" if fault.count == 1 else "frames are"
            what = f"{fault.count:,} {frames} missing: " if fault.count else ""
            lines.append(f"{episode.id}: {fault.stream}: {what}{fault.reason}")
    return lines


def _notes(report: "ViewReport") -> list[str]:
    notes: dict[str, int] = {}
    for episode in report.episodes:
        for note in episode.notes:
            notes[note] = notes.get(note, 0) + 1
    lines = [f"{note} ({count} episodes)" if count > 1 else note for note, count in notes.items()]
    shown = len(report.episodes) + len(report.unreadable)
    if shown < report.available:
        more = f"--max-episodes {report.available}, or name some with --episode"
        lines.append(f"{shown:,} of {report.available:,} episodes are shown; for more: {more}")
    return lines


def _serve(file: Path, port: int, *, no_open: bool) -> None:
    import webbrowser

    from exumi_data.cli.output import error_console
    from exumi_data.view.serving import served

    with served(file, port=port) as serving:
        print(serving.address, flush=True)
        error_console().print("Open it in a browser; Ctrl-C ends it.", style="dim", markup=False)
        if not no_open:
            webbrowser.open(serving.address)
        with suppress(KeyboardInterrupt):  # this is how it is ended
            serving.wait()
