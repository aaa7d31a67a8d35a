"""``exumi dataset remove``."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    from collections.abc import Sequence

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi dataset remove my-dataset 8f21 --reason 'the gel was torn' --dry-run",
    "exumi dataset remove my-dataset --where success=false --reason failed --yes",
    "exumi dataset remove my-dataset --unreadable --reason 'the disk failed' --dry-run",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    dataset: DatasetArgument,
    reason: Annotated[str, typer.Option(help="Why; it stays on record.")],
    episodes: EpisodesArgument = None,
    where: WhereOption = None,
    split: SplitOption = None,
    everything: AllOption = False,
    unreadable: Annotated[
        bool,
        typer.Option(
            "--unreadable", help="Episodes whose documents or times are damaged; all are read."
        ),
    ] = False,
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
    from exumi_data.cli.dataset_options import changing
    from exumi_data.cli.output import print_json, printable, progress_of
    from exumi_data.errors import UsageError

    if not reason.strip():
        raise UsageError("no reason is given", fix="Say --reason 'the gel was torn', or another.")
    if unreadable and (episodes or where or split or everything):
        raise UsageError(
            "--unreadable says which episodes",
            fix="Give no ids, --where, --split or --all with it.",
        )
    with changing(dataset, dry_run=dry_run):
        going = (
            _unreadable(dataset, quiet=quiet)
            if unreadable
            else _chosen(dataset, episodes or (), where or (), split, everything=everything)
        )
        if going.episodes and not (dry_run or yes):
            if not sys.stdin.isatty():
                raise UsageError(
                    f"{going.said}, would be removed for good", fix="Say --yes, or --dry-run."
                )
            typer.confirm(
                printable(f"Remove {going.said}, from {dataset} for good?"), abort=True, err=True
            )
        if not dry_run:
            with progress_of("Removing", quiet=quiet) as update:
                going.remove(reason, on_done=lambda n: update(n, len(going.episodes), ""))
    if output is Format.JSON:
        print_json({**going.listed, "reason": reason, "dry_run": dry_run})
        raise typer.Exit(1 if going.left_alone else 0)
    for line in going.episodes:
        print(printable(line))
    print(f"{going.said} {'would be removed' if dry_run else 'removed'}")
    for line in going.left_alone:
        print(printable(f"left alone: {line}"), file=sys.stderr)
    if going.left_alone:
        raise typer.Exit(1)


@dataclass(frozen=True, slots=True)
class _Going:
    """What is to be removed.

    Attributes
    ----------
    episodes : list of str
        A line each.
    said : str
        How many of how many.
    listed : dict
        For programs.
    remove : callable
        Does it.
    left_alone : list of str
        What cannot be read and stays, a line each.
    """

    episodes: list[str]
    said: str
    listed: dict[str, Any]
    remove: Callable[..., None]
    left_alone: list[str] = field(default_factory=list)


def _chosen(
    root: Path,
    episodes: "Sequence[str]",
    where: "Sequence[str]",
    split: str | None,
    *,
    everything: bool,
) -> _Going:
    from exumi_data.cli.dataset_options import opened
    from exumi_data.cli.output import size_text
    from exumi_data.editing.copying import chosen_of
    from exumi_data.editing.removal import remove_episodes
    from exumi_data.editing.selection import choose
    from exumi_data.wording import counted

    source = opened(root)
    ids = choose(source, ids=episodes, where=where, split=split, everything=everything)
    size = size_text(sum(int(one.row["bytes"]) for one in chosen_of(source, ids)))
    said = f"{len(ids):,} of {counted(len(source), 'episode')}, {size}"
    return _Going(ids, said, {"removed": ids}, partial(remove_episodes, source, ids))


def _unreadable(root: Path, *, quiet: bool) -> _Going:
    from exumi_data.catalog import list_episodes
    from exumi_data.cli.output import progress_of
    from exumi_data.editing.removal import find_unreadable, id_in_name, remove_unreadable
    from exumi_data.wording import counted

    total = len(list_episodes(root))
    with progress_of("Reading", quiet=quiet) as update:
        found = find_unreadable(root, lambda n: update(n, total, ""))
    return _Going(
        [f"{path}: {problem}" for path, problem in found.damaged.items()],
        f"{len(found.damaged):,} of {counted(total, 'episode')} (unreadable)",
        {
            "removed": [id_in_name(path) for path in found.damaged],
            "problems": found.damaged,
            "left_alone": found.left_alone,
        },
        partial(remove_unreadable, found),
        [f"{path}: {problem}" for path, problem in found.left_alone.items()],
    )
