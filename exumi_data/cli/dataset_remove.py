"""``exumi dataset remove``."""

import sys
from typing import Annotated

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

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi dataset remove my-dataset 8f21 --reason 'the gel was torn' --dry-run",
    "exumi dataset remove my-dataset --where success=false --reason failed --yes",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    dataset: DatasetArgument,
    reason: Annotated[str, typer.Option(help="Why; it stays on record.")],
    episodes: EpisodesArgument = None,
    where: WhereOption = None,
    split: SplitOption = None,
    everything: AllOption = False,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Do not ask: the data are gone afterwards.")
    ] = False,
    dry_run: DryRunOption = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Remove episodes for good, from splits and catalog as well; a note of each stays.

    To keep a copy, first: exumi dataset select DATASET COPY.
    """
    from exumi_data.cli.dataset_options import changing, opened
    from exumi_data.cli.output import print_json, printable, progress_of, size_text
    from exumi_data.editing.copying import chosen_of
    from exumi_data.editing.removal import remove_episodes
    from exumi_data.editing.selection import choose
    from exumi_data.errors import UsageError

    if not reason.strip():
        raise UsageError("no reason is given", fix="Say --reason 'the gel was torn', or another.")
    with changing(dataset, dry_run=dry_run):
        source = opened(dataset)
        ids = choose(
            source, ids=episodes or (), where=where or (), split=split, everything=everything
        )
        size = size_text(sum(int(one.row["bytes"]) for one in chosen_of(source, ids)))
        said = f"{len(ids)} of {len(source)} episodes, {size}"
        if ids and not (dry_run or yes):
            if not sys.stdin.isatty():
                raise UsageError(
                    f"{said}, would be removed for good", fix="Say --yes, or --dry-run."
                )
            typer.confirm(
                printable(f"Remove {said}, from {dataset} for good?"), abort=True, err=True
            )
        if not dry_run:
            with progress_of("Removing", quiet=quiet) as update:
                remove_episodes(source, ids, reason, on_done=lambda n: update(n, len(ids), ""))
    if output is Format.JSON:
        print_json({"removed": ids, "reason": reason, "dry_run": dry_run})
        return
    for one in ids:
        print(one)
    print(f"{said} {'would be removed' if dry_run else 'removed'}")
