"""``exumi dataset merge``."""

from pathlib import Path
from typing import Annotated

import typer

from exumi_data.cli.dataset_options import DryRunOption
from exumi_data.cli.options import Format, FormatOption, QuietOption, epilog, given_path

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi dataset merge monday tuesday --out week --name kitchen-week",
    "exumi dataset merge ours theirs --out both --licence CC-BY-4.0 --no-splits --dry-run",
)


def run(
    sources: Annotated[
        list[Path],
        typer.Argument(parser=given_path, metavar="DATASET...", help="Datasets; two or more."),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", parser=given_path, help="The dataset to write.")
    ],
    name: Annotated[
        str | None, typer.Option(help="Of the new dataset. Default: the first one's.")
    ] = None,
    licence: Annotated[
        str | None,
        typer.Option(help="SPDX expression; needed where the datasets' licences differ."),
    ] = None,
    splits: Annotated[
        bool, typer.Option("--splits/--no-splits", help="Join splits of equal names.")
    ] = True,
    dry_run: DryRunOption = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Copy the episodes of several datasets, byte for byte, into a new one.

    An episode that several have is taken once, in its latest revision. Started again, it goes on
    where it was stopped.
    """
    from exumi_data.cli.dataset_options import opened, write_dataset
    from exumi_data.editing.merging import plan_merge
    from exumi_data.errors import UsageError
    from exumi_data.release.licence import stated_licence

    licence = None if licence is None else stated_licence(licence)
    datasets = [opened(path) for path in sources]
    if len(datasets) < 2:
        raise UsageError("one dataset is merged already", fix="Name two or more.")
    licences = dict.fromkeys(dataset.metadata.licence for dataset in datasets)
    if licence is None and len(licences) > 1:
        raise UsageError(
            f"the datasets have different licences: {', '.join(licences)}",
            fix="Say that of the merged one with --licence; each episode keeps its own.",
        )
    first = datasets[0].metadata
    metadata = first.model_copy(deep=True)
    metadata.name = name or first.name
    metadata.licence = licence or first.licence
    metadata.authors = list(dict.fromkeys(a for d in datasets for a in d.metadata.authors))
    if len({d.metadata.citation for d in datasets}) > 1:
        metadata.citation = None
    if len({d.metadata.description for d in datasets}) > 1:
        metadata.description = None
    made = plan_merge(datasets, splits=splits)
    write_dataset(made, metadata, out, sources=sources, dry_run=dry_run, output=output, quiet=quiet)
