"""What the verbs of ``exumi dataset`` share: which episodes, and how a change is made and told."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exumi_data.cli.options import Format, given_path

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset
    from exumi_data.editing.merging import Merge
    from exumi_data.editing.revising import Revision
    from exumi_data.model.dataset import DatasetMetadata, MadeBy
    from exumi_data.model.episode import EpisodeMetadata

__all__ = [
    "AllOption",
    "DatasetArgument",
    "DryRunOption",
    "EpisodesArgument",
    "SplitOption",
    "WhereOption",
    "changing",
    "made_by",
    "opened",
    "revise_all",
    "tell_revisions",
    "write_dataset",
]

DatasetArgument = Annotated[
    Path, typer.Argument(parser=given_path, metavar="DATASET", help="The dataset's folder.")
]
EpisodesArgument = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[EPISODE]...", help="Ids, or their beginnings or ends where these are enough."
    ),
]
WhereOption = Annotated[
    list[str] | None,
    typer.Option(
        "--where",
        "-w",
        metavar="CONDITION",
        help="Episodes of which it holds: COLUMN=VALUE, also with != < > <= >= and a|b; the "
        "columns are the catalog's, and stream and kind. May be given several times.",
    ),
]
SplitOption = Annotated[
    str | None, typer.Option("--split", metavar="NAME/LIST", help="Episodes of a split's list.")
]
AllOption = Annotated[bool, typer.Option("--all", help="All episodes.")]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Only tell what would change.")]

_SHOWN = 5


def opened(path: Path) -> "Dataset":
    """Open a dataset, and nothing else.

    Parameters
    ----------
    path : pathlib.Path
    """
    from exumi_data.catalog import EPISODES_FOLDER
    from exumi_data.dataset import open_dataset
    from exumi_data.wording import counted

    dataset = open_dataset(path)
    links = sorted(one for one in (path / EPISODES_FOLDER).glob("*/*") if one.is_symlink())
    if links:
        warnings.warn(
            f"{counted(len(links), 'link')} in {path / EPISODES_FOLDER}, not followed: what they "
            f"lead to is left out. The first is {links[0]}",
            stacklevel=2,
        )
    return dataset


@contextmanager
def changing(root: Path, *, dry_run: bool) -> Iterator[list[str]]:
    """Be the only one who changes a dataset; its catalog is right again afterwards.

    Parameters
    ----------
    root : pathlib.Path
    dry_run : bool
        Then nothing is done.

    Yields
    ------
    list of str
        What was cleared away of an earlier run that was killed.
    """
    from exumi_data.cli.indexing import refresh_catalog
    from exumi_data.destination import only_run
    from exumi_data.errors import UsageError
    from exumi_data.leftovers import clean_leftovers
    from exumi_data.manifest import MANIFEST_NAME

    if (root / MANIFEST_NAME).exists():
        raise UsageError(
            "is a release, which its manifest.json describes: releases are not changed",
            where=root,
            fix="Change the dataset it was made of, or a copy: exumi dataset select DATASET COPY "
            "--all",
        )
    if dry_run:
        yield []
        return
    with only_run(root):
        notices = clean_leftovers(root)
        try:
            yield notices
        finally:
            refresh_catalog(root)


def revise_all(
    dataset: "Dataset",
    ids: list[str],
    change: "Callable[[EpisodeMetadata], None]",
    *,
    dry_run: bool,
    quiet: bool,
) -> "list[Revision]":
    """Change the metadata of episodes: of all, or where one would break the standard, of none.

    Parameters
    ----------
    dataset : Dataset
    ids : list of str
    change : callable
        See `exumi_data.editing.revising.revise`.
    dry_run, quiet : bool
    """
    from exumi_data.cli.output import progress_of
    from exumi_data.editing.copying import chosen_of
    from exumi_data.editing.revising import revise

    paths = [one.path for one in chosen_of(dataset, ids)]
    done = [revise(path, change, dry_run=True) for path in paths]
    if not dry_run:
        with progress_of("Changing", quiet=quiet) as update:
            for number, path in enumerate(paths):
                update(number, len(paths), "")
                done[number] = revise(path, change)
    return done


def tell_revisions(done: "list[Revision]", *, dry_run: bool, as_json: bool) -> None:
    """Tell what changed, once for episodes of which the same is to be said.

    Parameters
    ----------
    done : list of Revision
    dry_run, as_json : bool
    """
    from dataclasses import asdict

    from exumi_data.cli.output import print_json, printable
    from exumi_data.wording import counted

    changed = [one for one in done if one.changed]
    if as_json:
        print_json({"episodes": [asdict(one) for one in done], "dry_run": dry_run})
        return
    alike: dict[str, list[Any]] = {}
    for one in changed:
        text = "\n".join(
            f"  {name}: {_text(before)} -> {_text(after)}"
            for name, (before, after) in one.changed.items()
        )
        alike.setdefault(text, []).append(one)
    for text, same in alike.items():
        named = ", ".join(one.id for one in same[:_SHOWN])
        print(
            printable(f"{named}{f' and {len(same) - _SHOWN} more' if len(same) > _SHOWN else ''}")
        )
        print(printable(text, lines=True))
    total = counted(len(done), "episode")
    print(f"{len(changed):,} of {total} {'would change' if dry_run else 'changed'}")


def _text(value: object) -> str:
    import json

    return "nothing" if value is None else json.dumps(value, ensure_ascii=False)


def write_dataset(
    made: "Merge",
    metadata: "DatasetMetadata",
    target: Path,
    *,
    sources: "Sequence[Path]",
    dry_run: bool,
    output: Format,
    quiet: bool,
) -> None:
    """Write a dataset of chosen episodes, and tell of it.

    Parameters
    ----------
    made : Merge
    metadata : DatasetMetadata
        Splits and how it was made are filled in.
    target : pathlib.Path
    sources : sequence of pathlib.Path
        The datasets that are read, also those of which nothing is chosen.
    dry_run : bool
    output : Format
    quiet : bool

    Raises
    ------
    UsageError
        Nothing is chosen, or another dataset is there, or other revisions of the episodes.
    """
    from exumi_data.cli.output import print_json, printable, progress_of, size_text
    from exumi_data.destination import begin, only_run
    from exumi_data.errors import UsageError
    from exumi_data.wording import counted

    if not made.chosen:
        raise UsageError("no episode is chosen")
    # Other episodes than those of a release are not that release.
    metadata.splits, metadata.made_by, metadata.release = [], made_by(), None
    notices = list(made.notices)
    _refuse_other_data(made, target, sources)
    if not dry_run:
        begin(target, metadata)
        copying = progress_of("Copying", quiet=quiet)
        with only_run(target), _told_if_stopped(target), copying as update:
            total = len(made.chosen)
            notices += _fill(made, target, lambda done: update(done, total, ""))
    size = sum(int(one.row["bytes"]) for one in made.chosen)
    if output is Format.JSON:
        print_json(
            {
                "dataset": str(target),
                "episodes": [one.id for one in made.chosen],
                "bytes": size,
                "splits": list(made.splits),
                "notices": notices,
                "dry_run": dry_run,
            }
        )
        return
    what = "would be written" if dry_run else "written"
    said = counted(len(made.chosen), "episode")
    print(printable(f"{target}: {said}, {size_text(size)} {what}"))
    for name, document in made.splits.items():
        lists = ", ".join(f"{part} {len(ids)}" for part, ids in document.lists.items())
        print(printable(f"  split {name}: {lists}"))
    for notice in () if quiet else notices:
        print(printable(f"  {notice}"))


def _fill(made: "Merge", root: Path, on_done: Callable[[int], None]) -> list[str]:
    """Copy what is missing into a dataset; until all is there, it is none to any reader."""
    from exumi_data.dataset import DATASET_DOCUMENT, UNFINISHED_DOCUMENT
    from exumi_data.destination import finish, suspend, update_catalog
    from exumi_data.editing.copying import copy_episodes
    from exumi_data.editing.documents import write_splits
    from exumi_data.leftovers import clean_leftovers

    notices = clean_leftovers(root)
    if not all((root / one.target).exists() for one in made.chosen):
        suspend(root)
    rows = copy_episodes(made.chosen, root, on_done)
    finished = (root / DATASET_DOCUMENT).exists()
    document = DATASET_DOCUMENT if finished else UNFINISHED_DOCUMENT
    write_splits(root, made.splits, document=document)
    notices += update_catalog(root, rows)
    finish(root)
    return notices


@contextmanager
def _told_if_stopped(target: Path) -> Iterator[None]:
    from exumi_data.dataset import is_unfinished

    try:
        yield
    except BaseException:
        if is_unfinished(target):
            warnings.warn(
                f"{target} is not finished, and no dataset yet. Run the same command again: it "
                "goes on where it was stopped",
                stacklevel=3,
            )
        raise


def _refuse_other_data(made: "Merge", target: Path, sources: "Sequence[Path]") -> None:
    from exumi_data.catalog import list_episodes
    from exumi_data.dataset import is_unfinished
    from exumi_data.destination import is_current
    from exumi_data.errors import UsageError
    from exumi_data.manifest import MANIFEST_NAME
    from exumi_data.wording import counted

    inside = {source.resolve() for source in sources}
    here = target.resolve()
    if any(here == root or here.is_relative_to(root) for root in inside):
        raise UsageError(
            "is one of the datasets that are read, or lies in one",
            where=target,
            fix="Name a new folder.",
        )
    if (target / MANIFEST_NAME).exists():
        raise UsageError("is a release, which is not changed", where=target, fix="Name another.")
    wanted = {one.target for one in made.chosen}
    others = [path for path in list_episodes(target) if path not in wanted]
    if others:
        begun = is_unfinished(target)
        raise UsageError(
            f"holds {counted(len(others), 'other episode')}, the first is {others[0]}",
            where=target,
            fix="It is not finished: run the command that began it again, or name a new folder."
            if begun
            else "Name a new folder, and that one among the datasets that are merged.",
        )
    # A run that was stopped left the very bytes that this one would write; whatever else is there
    # was changed since, and nobody said that it may go.
    changed = [
        one.target
        for one in made.chosen
        if (target / one.target).exists() and not is_current(target / one.target, one.row)
    ]
    if changed:
        raise UsageError(
            f"holds {len(changed)} of these episodes as they are not here, such as {changed[0]}: "
            "they would be lost",
            where=target,
            fix="Name a new folder; exumi dataset merge takes the latest revision of each.",
        )


def made_by() -> "MadeBy":
    """Return what made a dataset: this program."""
    from exumi_data._version import __version__
    from exumi_data.model.dataset import MadeBy

    return MadeBy(tool="exumi dataset", tool_version=__version__)
