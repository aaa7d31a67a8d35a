"""``exumi dataset split``."""

import re
from enum import StrEnum
from typing import Annotated

import typer

from exumi_data.cli.dataset_options import DatasetArgument, DryRunOption
from exumi_data.cli.options import Format, FormatOption, epilog

__all__ = ["EPILOG", "run", "shares_of"]

EPILOG = epilog(
    "exumi dataset split my-dataset",
    "exumi dataset split my-dataset --name parts --by part --lists train=8,val=1,test=1 --seed 3",
)
# Names of files, on every system, once lists are written down one by one.
_LIST = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*(?:\.[A-Za-z0-9_-]+)*")
_LONGEST = 64
_MOST_DIGITS = 9


class By(StrEnum):
    """What is kept together."""

    EPISODE = "episode"
    OBJECT = "object"
    PART = "part"


def run(
    dataset: DatasetArgument,
    name: Annotated[
        str, typer.Option(help="Of the split: small letters, digits, - and _.")
    ] = "default",
    by: Annotated[By, typer.Option(help="What falls into one list together.")] = By.EPISODE,
    lists: Annotated[
        str, typer.Option(metavar="NAME=SHARE,...", help="The lists, and how much falls into each.")
    ] = "train=15,val=1",
    seed: Annotated[int, typer.Option(min=0, help="Another one gives another order.")] = 0,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a split of this name.")
    ] = False,
    dry_run: DryRunOption = False,
    output: FormatOption = Format.TEXT,
) -> None:
    """Divide a dataset into named lists; all episodes of an object or part can be kept together.

    The same dataset and seed give the same lists, on every machine.
    """
    from exumi_data.cli.dataset_options import changing, opened
    from exumi_data.cli.output import print_json, printable
    from exumi_data.editing.documents import write_splits
    from exumi_data.errors import UsageError
    from exumi_data.model.documents import dump
    from exumi_data.splits import make_split

    if len(name) > _LONGEST:
        raise UsageError(f"the name of a split has at most {_LONGEST} letters")
    with changing(dataset, dry_run=dry_run):
        source = opened(dataset)
        if name in source.splits and not overwrite:
            raise UsageError(
                f"there is a split {name!r} already",
                where=dataset,
                fix="Choose another --name, or say --overwrite.",
            )
        document = make_split(source, level=by.value, lists=shares_of(lists), seed=seed, name=name)
        if not dry_run:
            write_splits(dataset, {name: document})
    if output is Format.JSON:
        print_json(dump(document))
        return
    counts = ", ".join(f"{part} {len(ids)}" for part, ids in document.lists.items())
    print(printable(f"split {name} {'would be' if dry_run else 'is'}: {counts}"))


def shares_of(text: str) -> dict[str, int]:
    """Return the lists of a split and their shares.

    Parameters
    ----------
    text : str
        Such as ``train=8,val=1,test=1``.

    Raises
    ------
    UsageError
        It names none.
    """
    from exumi_data.errors import UsageError

    shares: dict[str, int] = {}
    for item in text.split(","):
        name, divided, share = item.strip().partition("=")
        if not divided or not name or not share.isdecimal() or name in shares:
            raise UsageError(
                f"{text!r} names no lists", fix="Write them such as train=8,val=1,test=1."
            )
        if not _LIST.fullmatch(name) or len(name) > _LONGEST:
            raise UsageError(
                f"{name[:_LONGEST]!r} is no name of a list",
                fix=f"At most {_LONGEST} letters, digits, - and _, such as train or val-seen.",
            )
        if len(share) > _MOST_DIGITS:
            raise UsageError(f"the share of {name} has more than {_MOST_DIGITS} digits")
        shares[name] = int(share)
    return shares
