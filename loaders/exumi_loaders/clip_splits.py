"""Touch clips of one list of a split, in which no part or object is on two sides."""

from typing import TYPE_CHECKING, Literal

from exumi_data.errors import UsageError
from exumi_data.splits import split_ids
from exumi_loaders.options import require_dataset

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["SplitLevel", "split_dataset"]

SplitLevel = Literal["episode", "object", "part"]
_COLUMNS = {"object": "object_id", "part": "part_id"}


def split_dataset(
    dataset: "Dataset",
    split: str | None,
    *,
    by: SplitLevel = "part",
    ratio: tuple[int, int] = (15, 1),
    seed: int = 0,
) -> "Dataset":
    """Select one list of a split, and refuse a stored split that leaks.

    Parameters
    ----------
    dataset : exumi_data.Dataset
    split : str or None
        ``train`` or ``val`` of a split made on the fly, or ``<name>/<list>`` of a stored one; None
        takes the whole dataset.
    by : {"part", "object", "episode"}
        What must be unseen: a part (or object, or episode) of one list is in no other.
    ratio : (int, int)
    seed : int
        Of a split made on the fly.

    Returns
    -------
    exumi_data.Dataset

    Raises
    ------
    UsageError
        There is no such split or list; a part or object is in several lists; it is not known of
        all episodes.
    """
    require_dataset(dataset)
    if split is None:
        return dataset
    ids = split_ids(dataset, split, by=by, ratio=ratio, seed=seed)
    name, _, _ = split.rpartition("/")
    if name:
        _refuse_leaks(dataset, name, by)
    if not ids:
        raise UsageError(f"list {split!r} has no episode of the dataset", where=dataset.path)
    return dataset.select(ids)


def _refuse_leaks(dataset: "Dataset", name: str, by: SplitLevel) -> None:
    known = dict(zip(dataset.ids, _things(dataset, by), strict=True))
    lists_of: dict[str, set[str]] = {}
    nameless: list[str] = []
    for listed, ids in dataset.splits[name].lists.items():
        for episode_id in ids:
            thing = known.get(episode_id)
            if thing is not None:
                lists_of.setdefault(thing, set()).add(listed)
            elif episode_id in known:
                nameless.append(episode_id)
    leaking = sorted(thing for thing, lists in lists_of.items() if len(lists) > 1)
    if leaking:
        first = leaking[0]
        raise UsageError(
            f"split {name!r} leaks: {len(leaking)} {by}(s) are in several lists, the first is "
            f"{first!r} in {', '.join(sorted(lists_of[first]))}",
            where=dataset.path,
            fix=f"Take a split made on the fly: split='train', split_by={by!r}.",
        )
    if nameless:
        raise UsageError(
            f"{len(nameless)} episode(s) of split {name!r} have no {_COLUMNS[by]}, the first is "
            f"{nameless[0]}: whether they are unseen is not known",
            where=dataset.path,
            fix="Split by part or episode, or select the episodes that have one.",
        )


def _things(dataset: "Dataset", by: SplitLevel) -> list[str | None]:
    if by == "episode":
        return list(dataset.ids)
    return list(dataset.catalog.column(_COLUMNS[by]).to_pylist())
