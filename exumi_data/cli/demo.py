"""``exumi demo``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import QuietOption, WorkersOption, epilog, given_path

if TYPE_CHECKING:
    from rich.console import Console

    from exumi_data.dataset import Dataset
    from exumi_data.demo import DemoSettings, SheetWindow
    from exumi_loaders import TPPWindows

__all__ = ["EPILOG", "run"]

EPILOG = epilog("exumi demo", "exumi demo --out /tmp/play --seed 3 --seconds 30")

PICTURE = "contact-sheet.png"


def run(
    out: Annotated[
        Path, typer.Option(parser=given_path, metavar="PATH", help="Folder to write into.")
    ] = Path("exumi-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Chooses what is left to chance.")] = 7,
    seconds: Annotated[
        float, typer.Option(min=3, max=3600, help="Length of the session, about 5 s a grasp.")
    ] = 20.0,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Show the whole path on a simulated play session, in under a minute.

    Simulates a gripper with two tactile fingertips, writes what its sensors say as a dataset,
    validates and measures it, loads training windows, and draws a picture of one grasp.
    """
    from exumi_data.cli.output import result_console
    from exumi_data.demo import DemoSettings

    settings = DemoSettings(seed=seed, seconds=seconds)
    console = result_console()
    console.print(f"[bold]exUMI demo[/]: {seconds:g} s of simulated play, seed {seed}")
    dataset = _write(console, out / "dataset", settings, workers=workers, quiet=quiet)
    valid = _validate(console, dataset)
    _measure(console, dataset)
    window = _load(console, dataset, settings)
    _draw(console, dataset, settings, window, out / PICTURE)
    _say_next(console, dataset.path, out / PICTURE)
    if not valid:
        from exumi_data.cli.failures import FOUND_WRONG

        raise typer.Exit(FOUND_WRONG)


def _step(console: "Console", number: int, what: str, result: str) -> None:
    console.print()
    console.print(f"[bold cyan]{number}[/] [bold]{what}[/]  {result}", soft_wrap=True)


def _write(
    console: "Console", root: Path, settings: "DemoSettings", *, workers: int | None, quiet: bool
) -> "Dataset":
    import time

    from exumi_data.cli.output import progress_of, size_text, time_text
    from exumi_data.demo import write_play_dataset

    began = time.perf_counter()
    with progress_of("Simulating", quiet=quiet) as update:
        dataset = write_play_dataset(
            root,
            settings,
            workers=workers,
            on_done=lambda done, total: update(done, total, "grasps"),
        )
    streams = [stream["name"] for stream in dataset.catalog.column("streams")[0].as_py()]
    size = size_text(sum(dataset.catalog.column("bytes").to_pylist()))
    _step(
        console,
        1,
        "Simulate and write",
        f"{len(dataset)} grasp(s), one episode each ({', '.join(streams)}), {size} "
        f"in {time_text(time.perf_counter() - began)}",
    )
    return dataset


def _validate(console: "Console", dataset: "Dataset") -> bool:
    from exumi_validators import validate

    report = validate(dataset.path)
    coverage = report.coverage
    if report.valid:
        result = (
            f"[green]valid[/]: {coverage.rules} rules, {coverage.arrays:,} arrays, "
            f"{coverage.frames:,} frames decoded"
        )
        warnings = report.count("warning")
        result += f", {warnings} warning(s)" if warnings else ""
    else:
        result = f"[red]invalid[/]: {report.count('error')} error(s)"
    _step(console, 2, "Validate", result)
    if report.count("error") or report.count("warning"):
        console.print(report.to_text(), markup=False, end="")
    return bool(report.valid)


def _measure(console: "Console", dataset: "Dataset") -> None:
    from exumi_data.cli.stats_text import print_statistics
    from exumi_data.stats import measure

    _step(console, 3, "Measure", "")
    print_statistics(measure(dataset), console)


def _load(console: "Console", dataset: "Dataset", settings: "DemoSettings") -> "SheetWindow":
    """Load training windows; return the one around the first touch of the first grasp."""
    import exumi_loaders
    from exumi_data.cli.output import plain
    from exumi_data.demo import shown_grasp, window_of_episode
    from exumi_data.errors import MissingExtraError

    shown = shown_grasp(settings)
    try:
        windows = exumi_loaders.TPPWindows(dataset, random_history=False, cache=False)
    except MissingExtraError as error:
        _step(console, 4, "Load windows", f"[yellow]left out[/]: {plain(error)}")
        return window_of_episode(dataset[shown.episode_id], shown.window_ns, "tactile_left")
    _step(console, 4, "Load windows", _loading(windows))
    return _window_at(windows, dataset.ids.index(shown.episode_id), shown.window_ns)


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


def _draw(
    console: "Console",
    dataset: "Dataset",
    settings: "DemoSettings",
    window: "SheetWindow",
    target: Path,
) -> None:
    from exumi_data.cli.output import plain
    from exumi_data.demo import draw_grasp, shown_grasp

    shown = shown_grasp(settings)
    with dataset[shown.episode_id] as episode:
        draw_grasp(episode, settings, shown, window).save(target)
    _step(console, 5, "Draw", f"[bold]{plain(target)}[/]: the grasp of the {shown.object_name}")


def _say_next(console: "Console", dataset: str, picture: Path) -> None:
    console.print()
    console.print("[bold]Look at the picture, then try:[/]")
    for line in (
        f"exumi info {dataset}",
        f"exumi validate {dataset} --format json",
        f"exumi prepare {dataset} {picture.parent}/training --size 224 --gray",
        f"python -c \"import exumi_data; print(exumi_data.open('{dataset}')[0].streams)\"",
    ):
        console.print(f"  {line}", markup=False, soft_wrap=True)
