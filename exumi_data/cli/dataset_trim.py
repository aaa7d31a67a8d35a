"""``exumi dataset trim``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.dataset_options import (
    AllOption,
    DatasetArgument,
    DryRunOption,
    EpisodesArgument,
    SplitOption,
    WhereOption,
)
from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog

if TYPE_CHECKING:
    from exumi_data.editing.trimming import Trim

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi dataset trim my-dataset 8f21 --end 4.2 --dry-run",
    "exumi dataset trim my-dataset 8f21 --start 1.5 --end 4.2",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    dataset: DatasetArgument,
    episodes: EpisodesArgument = None,
    where: WhereOption = None,
    split: SplitOption = None,
    everything: AllOption = False,
    start: Annotated[
        float | None, typer.Option(help="Seconds of the episode's time; what is before goes.")
    ] = None,
    end: Annotated[
        float | None, typer.Option(help="Seconds of the episode's time; from there on it goes.")
    ] = None,
    dry_run: DryRunOption = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Shorten episodes. Nothing is resampled or encoded; times stay what they are.

    What is cut off is gone: keep a copy with `exumi dataset select`. Video files are not cut; those
    that hold a frame of the stretch stay whole.
    """
    from dataclasses import asdict

    from exumi_data.cli.dataset_options import changing, opened
    from exumi_data.cli.output import print_json, printable, progress_of
    from exumi_data.editing.copying import chosen_of
    from exumi_data.editing.selection import choose
    from exumi_data.editing.trimming import stretch_of, trim_episode
    from exumi_data.errors import UsageError
    from exumi_data.wording import counted

    if start is None and end is None:
        raise UsageError("from when to when?", fix="Say --start, --end or both.")
    stretch_of(start, end)  # refused once, not for each episode
    with changing(dataset, dry_run=dry_run):
        source = opened(dataset)
        ids = choose(
            source, ids=episodes or (), where=where or (), split=split, everything=everything
        )
        paths = [one.path for one in chosen_of(source, ids)]
        done = _planned(paths, start, end)
        if not dry_run:
            with progress_of("Trimming", quiet=quiet) as update:
                for number, path in enumerate(paths):
                    update(number, len(paths), "")
                    done[number] = trim_episode(path, start, end)
    if output is Format.JSON:
        print_json({"episodes": [asdict(one) for one in done], "dry_run": dry_run})
        return
    for one in done:
        print(one.id)
        for stream, (kept, total) in one.kept.items():
            whole = " (its video files are not cut)" if stream in one.whole else ""
            print(printable(f"  {stream}: {kept:,} of {total:,} samples{whole}"))
        for key in one.dropped:
            print(printable(f"  derived/{key} is left out"))
    changed = sum(one.is_changed for one in done)
    said = counted(len(done), "episode")
    print(f"{changed:,} of {said} {'would be trimmed' if dry_run else 'trimmed'}")


def _planned(paths: Sequence[Path], start: float | None, end: float | None) -> "list[Trim]":
    """Look at all before the first one changes; tell all that cannot be trimmed."""
    from exumi_data.editing.trimming import trim_episode
    from exumi_data.errors import ExumiError, UsageError

    done, failed = [], []
    for path in paths:
        try:
            done.append(trim_episode(path, start, end, dry_run=True))
        except ExumiError as error:
            failed.append(error)
    if len(failed) == 1:
        raise failed[0]
    if failed:
        raise UsageError(
            "\n".join([f"{len(failed)} episodes cannot be trimmed:", *map(str, failed)]),
            fix="Nothing was changed. Mend them, or choose the others.",
        )
    return done
