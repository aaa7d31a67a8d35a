"""``exumi calibrate apply``."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_recorders.calibration.apply import Applied
    from exumi_recorders.calibration.files import Calibration

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
    from exumi_data.cli.output import error_console, print_json, printable
    from exumi_data.dataset import DATASET_DOCUMENT
    from exumi_data.leftovers import settle
    from exumi_recorders.calibration.apply import apply_calibration, named
    from exumi_recorders.calibration.files import merge, read_calibration

    rig = merge({str(file): read_calibration(file) for file in calibration})
    source = ", ".join(named(file) for file in calibration)
    notices: list[str] = []
    failed: dict[str, str] = {}
    if (path / DATASET_DOCUMENT).exists():
        done = _to_dataset(path, rig, source, failed, notices, dry_run=dry_run, quiet=quiet)
    else:
        if not dry_run and settle(path):
            notices.append("an episode that an earlier run had put aside was brought back")
        done = [apply_calibration(path, rig, source, dry_run=dry_run)]
    changed = [one for one in done if one.is_changed]
    if output is Format.JSON:
        episodes = [asdict(one) for one in done]
        print_json({"episodes": episodes, "failed": failed, "notices": notices, "dry_run": dry_run})
    else:
        for line in _lines(done):
            print(printable(line))
        print(f"{len(changed)} of {len(done)} episodes {'would change' if dry_run else 'changed'}")
    for notice in () if quiet else notices:
        error_console().print(f"note: {notice}", style="dim", markup=False)
    for reason in failed.values():
        error_console().print(f"error: {reason}", markup=False)
    if failed:
        raise typer.Exit(FOUND_WRONG)


def _to_dataset(  # what, whereto, and how
    root: Path,
    rig: "Calibration",
    source: str,
    failed: dict[str, str],
    notices: list[str],
    *,
    dry_run: bool,
    quiet: bool,
) -> "list[Applied]":
    """Bring all episodes of a dataset to a calibration, and its catalog to them."""
    import errno
    from contextlib import ExitStack

    from exumi_data.cli.indexing import refresh_catalog
    from exumi_data.cli.output import progress_of
    from exumi_data.destination import only_run
    from exumi_data.errors import ExumiError
    from exumi_data.leftovers import clean_leftovers
    from exumi_recorders.calibration.apply import apply_calibration

    done: list[Applied] = []
    with ExitStack() as stack:
        if not dry_run:
            stack.enter_context(only_run(root))
            notices += clean_leftovers(root)
            # Also for what an earlier run changed before it was stopped.
            stack.callback(refresh_catalog, root)
        episodes = _episodes(root)
        update = stack.enter_context(progress_of("Applying", quiet=quiet))
        for number, episode in enumerate(episodes):
            update(number, len(episodes), "")
            try:
                done.append(apply_calibration(episode, rig, source, dry_run=dry_run))
            except ExumiError as error:
                failed[str(episode)] = str(error)
            except OSError as error:
                if error.errno in {errno.ENOSPC, errno.EDQUOT}:
                    raise
                failed[str(episode)] = f"{episode}: {error.strerror or error}"
    return done


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
        for stream in first.widths:
            beyond = sum(one.out_of_range.get(stream, 0) for one in alike)
            if beyond:
                lines.append(f"  {stream}: {beyond:,} readings are beyond the map: out_of_range")
        lines += [f"  left out: {name}: {why}" for name, why in first.left_out.items()]
        if not first.is_changed:
            lines.append("  nothing to change")
    return lines
