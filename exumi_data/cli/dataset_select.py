"""``exumi dataset select``."""

from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.dataset_options import (
    AllOption,
    DatasetArgument,
    DryRunOption,
    SplitOption,
    WhereOption,
)
from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog, given_path

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi dataset select my-dataset good --where success=true --where 'duration_s>=3'",
    "exumi dataset select my-dataset held-out --split default/val",
    "exumi dataset select my-dataset two --episode 8f21 --episode c077",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    source: DatasetArgument,
    target: Annotated[
        Path, typer.Argument(parser=given_path, metavar="NEW", help="The dataset to write.")
    ],
    episode: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID", help="Its id, or its beginning or end. May be given several times."
        ),
    ] = None,
    where: WhereOption = None,
    split: SplitOption = None,
    everything: AllOption = False,
    name: Annotated[
        str | None, typer.Option(help="Of the new dataset. Default: the old one's.")
    ] = None,
    dry_run: DryRunOption = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Copy some episodes of a dataset, byte for byte, into a new one. Splits shrink with it.

    Started again, it goes on where it was stopped.
    """
    from exumi_data.cli.dataset_options import opened, write_dataset
    from exumi_data.editing.copying import chosen_of
    from exumi_data.editing.merging import Merge, join_splits
    from exumi_data.editing.selection import choose

    dataset = opened(source)
    ids = choose(dataset, ids=episode or (), where=where or (), split=split, everything=everything)
    chosen = chosen_of(dataset, ids)
    made = Merge(chosen, join_splits([dataset.splits], chosen), [])
    metadata = dataset.metadata.model_copy(deep=True)
    if name is not None:
        metadata.name = name
    write_dataset(
        made, metadata, target, sources=[source], dry_run=dry_run, output=output, quiet=quiet
    )
