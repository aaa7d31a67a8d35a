"""``exumi demo``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import QuietOption, WorkersOption, epilog, given_path

if TYPE_CHECKING:
    from rich.console import Console

    from exumi_data.cli.demo_play import Played
    from exumi_data.dataset import Dataset
    from exumi_data.demo import SheetWindow, ShownGrasp
    from exumi_data.episode import Episode
    from exumi_loaders import TPPWindows

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi demo",
    "exumi demo --out /tmp/play --seed 3 --seconds 30",
    "exumi demo --out /tmp/play --direct --seconds 600",
)


def run(  # options of the command line
    out: Annotated[
        Path, typer.Option(parser=given_path, metavar="PATH", help="Folder to write into.")
    ] = Path("exumi-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Chooses what is left to chance.")] = 7,
    seconds: Annotated[
        float,
        typer.Option(
            min=3,
            max=3600,
            help="Length of the session, about 5 s a grasp. What lies between grasps is in no "
            "episode.",
        ),
    ] = 20.0,
    direct: Annotated[
        bool,
        typer.Option(
            "--direct",
            help="Write the episodes straight from the simulation, without recording: the same "
            "seed gives the same dataset.",
        ),
    ] = False,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Show the whole path on a simulated play session, in under a minute.

    A simulated hand with a tactile gripper plays for --seconds. Its devices speak the real
    protocols; what they send is recorded live, one episode a grasp. Then everything is validated,
    measured and prepared, training windows are loaded, and a picture of one grasp is drawn, with
    the truth on it.
    """
    from exumi_data.cli.demo_play import record, simulate
    from exumi_data.cli.output import result_console
    from exumi_data.demo import DemoSettings, demo_folder, shown_grasp

    settings = DemoSettings(seed=seed, seconds=seconds)
    console = result_console()
    console.print(f"[bold]exUMI demo[/]: {seconds:g} s of simulated play, seed {seed}")
    with demo_folder(out) as folder:
        if direct:
            played = simulate(folder.dataset, settings, workers=workers, quiet=quiet)
        else:
            played = record(folder.dataset, settings, quiet=quiet)
        _step(console, 1, "Simulate and write" if direct else "Record", played.text)
        valid = _validate(console, played.dataset)
        _measure(console, played.dataset)
        training = _prepare(console, played.dataset, folder.training, workers=workers, quiet=quiet)
        shown = shown_grasp(played.session, played.dataset, played.epoch_ns)
        prepared = _prepared(training, shown.episode_id)
        window = _load(console, training, prepared, shown)
        _draw(console, played, prepared, shown, window, folder.picture)
    _say_next(console, folder.dataset, folder.training)
    if not valid:
        from exumi_data.cli.failures import FOUND_WRONG

        raise typer.Exit(FOUND_WRONG)


def _step(console: "Console", number: int, what: str, result: str) -> None:
    console.print()
    console.print(f"[bold cyan]{number}[/] [bold]{what}[/]  {result}", soft_wrap=True)


def _validate(console: "Console", dataset: "Dataset") -> bool:
    from exumi_data.wording import counted
    from exumi_validators import validate

    report = validate(dataset.path)
    coverage = report.coverage
    if report.valid:
        result = (
            f"[green]valid[/]: {coverage.rules} rules, {coverage.arrays:,} arrays, "
            f"{coverage.frames:,} frames decoded"
        )
        warnings = report.count("warning")
        result += f", {counted(warnings, 'warning')}" if warnings else ""
    else:
        result = f"[red]invalid[/]: {counted(report.count('error'), 'error')}"
    _step(console, 2, "Validate", result)
    if report.count("error") or report.count("warning"):
        console.print(report.to_text(), markup=False, end="")
    return bool(report.valid)


def _measure(console: "Console", dataset: "Dataset") -> None:
    from exumi_data.cli.stats_text import print_statistics
    from exumi_data.stats import measure

    _step(console, 3, "Measure", "")
    print_statistics(measure(dataset), console)


def _prepare(
    console: "Console", dataset: "Dataset", target: Path, *, workers: int | None, quiet: bool
) -> "Dataset":
    import exumi_data
    from exumi_converters import prepare
    from exumi_data.cli.output import plain, time_text
    from exumi_data.cli.run_report import run_progress
    from exumi_data.errors import ExumiError

    with run_progress("Preparing", quiet=quiet) as on_progress:
        report = prepare(dataset.path, target, workers=workers, on_progress=on_progress)
    if report.failed:
        raise ExumiError(report.failed[0].reason, where=report.failed[0].name)
    _step(
        console,
        4,
        "Prepare",
        f"{report.frames:,} frames resized to 224 pixels, activity measured, "
        f"in {time_text(report.seconds)}: {plain(target)}",
    )
    opened = exumi_data.open(target)
    assert isinstance(opened, exumi_data.Dataset)  # noqa: S101  # it was made as one
    return opened


def _prepared(training: "Dataset", parent: str) -> "Episode":
    """Return the prepared episode that was made of an episode."""
    return next(one for one in training if one.metadata.source.parent_id == parent)


def _load(
    console: "Console", training: "Dataset", prepared: "Episode", shown: "ShownGrasp"
) -> "SheetWindow":
    """Load training windows; return the one around the first touch of the grasp."""
    import exumi_loaders
    from exumi_data.cli.output import plain
    from exumi_data.demo import window_of_episode
    from exumi_data.errors import MissingExtraError

    try:
        windows = exumi_loaders.TPPWindows(training, random_history=False, cache=False)
    except MissingExtraError as error:
        _step(console, 5, "Load windows", f"[yellow]left out[/]: {plain(error)}")
        return window_of_episode(prepared, shown.window_ns, "tactile_left")
    _step(console, 5, "Load windows", _loading(windows))
    return _window_at(windows, training.ids.index(prepared.id), shown.window_ns)


def _loading(windows: "TPPWindows") -> str:
    import time

    shapes: dict[str, tuple[int, ...]] = {}
    loaded = 0
    began = time.perf_counter()
    for batch in windows.loader(batch_size=16):
        shapes = shapes or {name: tuple(value.shape) for name, value in batch.items()}
        loaded += len(batch["valid"])
        if time.perf_counter() - began > 1.0:
            break
    rate = loaded / (time.perf_counter() - began)
    shown = ", ".join(f"{name} {shapes[name]}" for name in ("tactile_left", "rgb", "action"))
    return (
        f"{len(windows):,} windows, {windows.active.mean():.0%} of them active, {rate:,.0f} a "
        f"second in one process; a batch: {shown}"
    )


def _window_at(windows: "TPPWindows", episode: int, time_ns: int) -> "SheetWindow":
    """Return the window whose step 0 is nearest to a time of an episode."""
    from exumi_data.demo import SheetWindow

    timeline = windows.timeline
    first, end = timeline.edges[episode], timeline.edges[episode + 1]
    tick = round((time_ns - int(timeline.start_ns[episode])) * 1e-9 / timeline.settings.tick_s)
    item = windows[int(min(max(first + tick, first), end - 1))]
    return SheetWindow(
        time_ns=int(item["time_ns"]),
        steps=item["tactile_steps"].tolist(),
        tactile=item["tactile_left"].numpy().transpose(0, 2, 3, 1),
        rgb=item["rgb"].numpy()[0].transpose(1, 2, 0),
        loader="TPPWindows",
    )


def _draw(  # what the picture is put together from
    console: "Console",
    played: "Played",
    prepared: "Episode",
    shown: "ShownGrasp",
    window: "SheetWindow",
    target: Path,
) -> None:
    from exumi_data.cli.output import plain
    from exumi_data.demo import deviation_of, draw_grasp

    with played.dataset[shown.episode_id] as episode:
        draw_grasp(episode, prepared, shown, window, played.command).save(target)
        apart = deviation_of(played.session, episode, shown.span)
    _step(
        console,
        6,
        "Draw",
        f"[bold]{plain(target)}[/]: the grasp of the {shown.object_name}; from the truth, its "
        f"width is {apart.width_m * 1e3:.2f} mm away, its place {apart.place_m * 1e3:.2f} mm (rms)",
    )


def _say_next(console: "Console", dataset: Path, training: Path) -> None:
    console.print()
    console.print("[bold]Look at the picture, then try:[/]")
    for line in (
        f"exumi info {dataset}",
        f"exumi validate {dataset} --format json",
        f"exumi stats {training}",
        f"python -c \"import exumi_data; print(exumi_data.open('{dataset}')[0].streams)\"",
    ):
        console.print(f"  {line}", markup=False, soft_wrap=True)
