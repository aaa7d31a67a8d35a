"""``exumi dataset relabel``."""

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
    from exumi_data.dataset import Dataset

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi dataset relabel my-dataset --where task=pres --task press --dry-run",
    "exumi dataset relabel my-dataset 8f21 --object-id mug --label hardness=8:0..10",
    "exumi dataset relabel my-dataset --all --clear operator",
)


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    dataset: DatasetArgument,
    episodes: EpisodesArgument = None,
    where: WhereOption = None,
    split: SplitOption = None,
    everything: AllOption = False,
    task: Annotated[str | None, typer.Option(help="Name of the task.")] = None,
    instruction: Annotated[str | None, typer.Option(help="The task in plain language.")] = None,
    regime: Annotated[
        str | None, typer.Option(help="demonstration, play or touch.", metavar="REGIME")
    ] = None,
    operator: Annotated[str | None, typer.Option(help="A pseudonym.")] = None,
    site: Annotated[str | None, typer.Option(help="Where it was recorded.")] = None,
    licence: Annotated[str | None, typer.Option(help="SPDX expression.")] = None,
    object_name: Annotated[
        str | None, typer.Option("--object", help="What was touched, in plain words.")
    ] = None,
    object_id: Annotated[str | None, typer.Option(help="Its id in the dataset.")] = None,
    part: Annotated[str | None, typer.Option(help="Which part, in plain words.")] = None,
    part_id: Annotated[str | None, typer.Option(help="Its id in the dataset.")] = None,
    instance_id: Annotated[str | None, typer.Option(help="Which one of several alike.")] = None,
    procedure: Annotated[str | None, typer.Option(help="press, slide, twist.")] = None,
    pad_type: Annotated[str | None, typer.Option(help="plain or dotted.", metavar="PAD")] = None,
    trial: Annotated[int | None, typer.Option(min=0, help="Which time it was touched.")] = None,
    label: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PROPERTY=VALUE",
            help="A person's judgement: hardness=7:0..10, material=wood. May be given several "
            "times.",
        ),
    ] = None,
    clear: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FIELD",
            help="Take a field away, such as operator or object_id, or labels of a property. May "
            "be given several times.",
        ),
    ] = None,
    dry_run: DryRunOption = False,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Say anew what was done, with what, and what it is like. Samples are not touched.

    An episode that changes is one revision later.
    """
    from exumi_data.cli.dataset_options import changing, opened, revise_all, tell_revisions
    from exumi_data.editing.labels import FIELDS, parse_label, relabel
    from exumi_data.editing.selection import choose
    from exumi_data.errors import UsageError
    from exumi_data.model.episode import EpisodeMetadata
    from exumi_data.release.licence import stated_licence

    given: dict[str, Any] = {
        "task": task,
        "instruction": instruction,
        "regime": regime,
        "operator": operator,
        "site": site,
        "licence": None if licence is None else stated_licence(licence),
        "object": object_name,
        "object_id": object_id,
        "part": part,
        "part_id": part_id,
        "instance_id": instance_id,
        "procedure": procedure,
        "pad_type": pad_type,
        "trial": trial,
    }
    fields = {name: value for name, value in given.items() if value is not None}
    cleared = [name.replace("-", "_") for name in clear or []]
    both = [name for name in cleared if name in fields]
    if both:
        raise UsageError(f"both said and cleared: {', '.join(both)}")
    fields |= {name: None for name in cleared if name in FIELDS}
    labels = tuple(parse_label(text) for text in label or [])
    properties = tuple(name for name in clear or [] if name.replace("-", "_") not in FIELDS)
    if not (fields or labels or properties):
        raise UsageError("nothing is to be said anew", fix="Say --task, --object or another.")

    def change(metadata: EpisodeMetadata) -> None:
        relabel(metadata, fields, labels=labels, without_labels=properties)

    with changing(dataset, dry_run=dry_run):
        source = opened(dataset)
        ids = choose(
            source, ids=episodes or (), where=where or (), split=split, everything=everything
        )
        _refuse_unknown(source, ids, properties)
        done = revise_all(source, ids, change, dry_run=dry_run, quiet=quiet)
    tell_revisions(done, dry_run=dry_run, as_json=output is Format.JSON)


def _refuse_unknown(dataset: "Dataset", ids: list[str], properties: tuple[str, ...]) -> None:
    """Refuse words that are neither fields nor properties of which an episode has a label."""
    from exumi_data.editing.copying import chosen_of
    from exumi_data.editing.labels import FIELDS
    from exumi_data.episode import open_episode
    from exumi_data.errors import UsageError

    if not properties:
        return
    known: set[str] = set()
    for one in chosen_of(dataset, ids):
        with open_episode(one.path) as episode:
            annotations = episode.metadata.annotations
            known |= {label.property for label in (annotations and annotations.labels) or ()}
    unknown = [name for name in properties if name not in known]
    if unknown:
        labels = f"; labels of these episodes: {', '.join(sorted(known))}" if known else ""
        raise UsageError(
            f"nothing can be cleared that is called {', '.join(map(repr, unknown))}",
            fix=f"Fields are {', '.join(FIELDS)}{labels}.",
        )
