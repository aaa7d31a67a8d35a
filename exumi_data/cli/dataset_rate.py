"""``exumi dataset rate``."""

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
    "exumi dataset rate my-dataset 8f21 c077 --success",
    "exumi dataset rate my-dataset 8f21 --failure --note dropped='It fell after 3 s'",
    "exumi dataset rate my-dataset --where quality=dropped --clear-note dropped --dry-run",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    dataset: DatasetArgument,
    episodes: EpisodesArgument = None,
    where: WhereOption = None,
    split: SplitOption = None,
    everything: AllOption = False,
    success: Annotated[
        bool | None,
        typer.Option("--success/--failure", help="Whether the task was done."),
    ] = None,
    unknown: Annotated[
        bool, typer.Option("--unknown", help="Take back whether the task was done.")
    ] = False,
    note: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CODE=TEXT",
            help="Something that a user of the episode should know. May be given several times.",
        ),
    ] = None,
    clear_note: Annotated[
        list[str] | None,
        typer.Option(metavar="CODE", help="Take notes of this code back."),
    ] = None,
    dry_run: DryRunOption = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Judge episodes after the fact: success, and notes on quality. Samples are not touched.

    An episode that changes is one revision later.
    """
    from exumi_data.cli.dataset_options import changing, opened, revise_all, tell_revisions
    from exumi_data.editing.labels import Rating, rate
    from exumi_data.editing.selection import choose
    from exumi_data.errors import UsageError
    from exumi_data.model.episode import EpisodeMetadata

    if unknown and success is not None:
        raise UsageError("the task was done, or it is not known: not both")
    notes = {}
    for text in note or []:
        code, divided, message = text.partition("=")
        if not divided or not code or not message:
            raise UsageError(
                f"{text!r} is no note", fix="Write CODE=TEXT, such as dropped='It fell'."
            )
        notes[code] = message
    rating = Rating(
        success=success,
        is_judged=unknown or success is not None,
        notes=notes,
        without=tuple(clear_note or ()),
    )
    if not (rating.is_judged or rating.notes or rating.without):
        raise UsageError("no judgement was given", fix="Say --success, --failure or --note.")

    def change(metadata: EpisodeMetadata) -> None:
        rate(metadata, rating)

    with changing(dataset, dry_run=dry_run):
        source = opened(dataset)
        ids = choose(
            source, ids=episodes or (), where=where or (), split=split, everything=everything
        )
        done = revise_all(source, ids, change, dry_run=dry_run, quiet=quiet)
    tell_revisions(done, dry_run=dry_run, as_json=output is Format.JSON)
