"""Datasets put together: episodes of equal ids are told apart, splits are joined."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from exumi_data.editing.copying import Chosen, chosen_of
from exumi_data.errors import UsageError
from exumi_data.model.dataset import SplitDocument
from exumi_data.splits import leaks_of

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["Merge", "join_splits", "plan_merge"]

_NAMED = 5


@dataclass(frozen=True, slots=True)
class Merge:
    """What a merged dataset will hold.

    Attributes
    ----------
    chosen : list of Chosen
    splits : dict of str to SplitDocument
    notices : list of str
        What a user should know: episodes that several datasets have.
    """

    chosen: list[Chosen]
    splits: dict[str, SplitDocument]
    notices: list[str]


def plan_merge(datasets: Sequence["Dataset"], *, splits: bool = True) -> Merge:
    """Decide which episodes a merged dataset has. Nothing is written.

    An episode that several datasets have is taken once: the one of the latest revision; of equal
    ones, that of the first dataset.

    Parameters
    ----------
    datasets : sequence of Dataset
    splits : bool
        Whether their splits are joined, or left out.

    Returns
    -------
    Merge

    Raises
    ------
    UsageError
        Two datasets have different episodes of one id and revision, or splits that contradict
        each other; all of them are named.
    """
    found: dict[str, Chosen] = {}
    twice: dict[str, list[str]] = {"same": [], "older": [], "conflict": []}
    for dataset in datasets:
        for one in chosen_of(dataset):
            there = found.get(one.id)
            if there is None:
                found[one.id] = one
                continue
            revisions = (there.row["revision"], one.row["revision"])
            if revisions[0] != revisions[1]:
                twice["older"].append(one.id)
                if revisions[1] > revisions[0]:
                    found[one.id] = one
            elif there.row["digest"] == one.row["digest"]:
                twice["same"].append(one.id)
            else:
                twice["conflict"].append(f"{one.id} in {there.root} and {one.root}")
    if twice["conflict"]:
        raise UsageError(
            f"{len(twice['conflict'])} episodes have one id and revision, and are different: "
            f"{_some(twice['conflict'])}",
            fix="Leave one of each out with: exumi dataset select SRC DST --where ...",
        )
    notices = []
    if twice["same"]:
        notices.append(f"{len(twice['same'])} episodes are in several datasets, and taken once")
    if twice["older"]:
        notices.append(f"of {len(twice['older'])} episodes the latest revision is taken")
    chosen = sorted(found.values(), key=lambda one: one.target)
    joined = join_splits([d.splits for d in datasets], chosen) if splits else {}
    return Merge(chosen, joined, notices)


def join_splits(
    splits: Sequence[Mapping[str, SplitDocument]], chosen: Sequence[Chosen]
) -> dict[str, SplitDocument]:
    """Join the splits of datasets, list by list; what is not chosen leaves them.

    Parameters
    ----------
    splits : sequence of mapping
        Of each dataset, by name.
    chosen : sequence of Chosen

    Raises
    ------
    UsageError
        An episode would be in two lists, or an object or part of a split by these; or levels
        differ.
    """
    rows = {one.id: one.row for one in chosen}
    joined: dict[str, SplitDocument] = {}
    problems = []
    for name in dict.fromkeys(name for each in splits for name in each):
        documents = [each[name] for each in splits if name in each]
        first = documents[0]
        levels = {document.level for document in documents}
        if len(levels) > 1:
            problems.append(f"split {name!r} is by {' and by '.join(sorted(levels))}")
            continue
        lists: dict[str, dict[str, None]] = {}
        for document in documents:
            for part, ids in document.lists.items():
                lists.setdefault(part, {}).update(dict.fromkeys(i for i in ids if i in rows))
        seeds = {document.seed for document in documents}
        joined[name] = first.model_copy(
            update={
                "lists": {part: list(ids) for part, ids in lists.items()},
                "seed": first.seed if len(seeds) == 1 else None,
                "method": first.method if len(documents) == 1 else "joined",
            }
        )
        problems += leaks_of(joined[name], rows)
    if problems:
        raise UsageError(
            f"splits cannot be joined: {_some(problems)}",
            fix="Leave them out with --no-splits, and make a new one: exumi dataset split DATASET",
        )
    return joined


def _some(texts: Sequence[str]) -> str:
    return "; ".join(texts[:_NAMED]) + ("; ..." if len(texts) > _NAMED else "")
