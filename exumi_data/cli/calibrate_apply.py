"""``exumi calibrate apply``."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_recorders.calibration.apply import Applied

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate apply my-dataset --calibration rig.json",
    "exumi calibrate apply grasp.zarr --calibration rig.json --dry-run",
)


def run(
    path: Annotated[
        Path,
        typer.Argument(
            parser=given_path, metavar="PATH", help="An episode's folder, or a dataset's."
        ),
    ],
    calibration: Annotated[
        list[Path],
        typer.Option(
            "--calibration",
            "-c",
            parser=given_path,
            metavar="FILE",
            help="The calibration file; may be given several times, if they do not disagree.",
        ),
    ],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only tell what would change.")
    ] = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Compute times and widths of finished episodes again, by a calibration made later.

    Raw times and values stay as they are. An episode that changes is replaced, one revision later;
    one that the calibration says nothing new of is not touched. Exit code 1 if one failed.
    """
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.indexing import refresh_catalog
    from exumi_data.cli.output import error_console, print_json, printable, progress_of
    from exumi_data.dataset import DATASET_DOCUMENT
    from exumi_data.errors import ExumiError
    from exumi_recorders.calibration.apply import apply_calibration, named
    from exumi_recorders.calibration.files import merge, read_calibration

    rig = merge({str(file): read_calibration(file) for file in calibration})
    source = ", ".join(named(file) for file in calibration)
    is_dataset = (path / DATASET_DOCUMENT).exists()
    episodes = _episodes(path) if is_dataset else [path]
    done: list[Applied] = []
    failed: dict[str, str] = {}
    with progress_of("Applying", quiet=quiet) as update:
        for number, episode in enumerate(episodes):
            update(number, len(episodes), "")
            try:
                done.append(apply_calibration(episode, rig, source, dry_run=dry_run))
            except ExumiError as error:
                failed[str(episode)] = str(error)
    changed = [one for one in done if one.is_changed]
    if is_dataset and changed and not dry_run:
        refresh_catalog(path)
    if output is Format.JSON:
        print_json({"episodes": [asdict(one) for one in done], "failed": failed})
    else:
        for line in _lines(done):
            print(printable(line))
        print(f"{len(changed)} of {len(done)} episodes {'would change' if dry_run else 'changed'}")
    for reason in failed.values():
        error_console().print(f"error: {reason}", markup=False)
    if failed:
        raise typer.Exit(FOUND_WRONG)


def _episodes(root: Path) -> list[Path]:
    from exumi_data.catalog import list_episodes

    return [root / path for path in list_episodes(root)]


def _lines(done: "list[Applied]") -> list[str]:
    """Say what changed, once for episodes of which the same is to be said."""
    same: dict[tuple[object, ...], list[Applied]] = {}
    for one in done:
        key = (one.changed, one.times, one.widths, tuple(one.left_out.items()))
        same.setdefault(key, []).append(one)
    lines = []
    for alike in same.values():
        first = alike[0]
        lines.append(first.path if len(alike) == 1 else f"{len(alike)} episodes")
        for what, names in (
            ("items", first.changed),
            ("times of", first.times),
            ("widths of", first.widths),
        ):
            if names:
                lines.append(f"  {what}: {', '.join(names)}")
        lines += [f"  left out: {name}: {why}" for name, why in first.left_out.items()]
        if not first.is_changed:
            lines.append("  nothing to change")
    return lines
