"""Splits of a dataset: by episode, object or part; deterministic; never leaking."""

from hashlib import sha256
from typing import TYPE_CHECKING, Literal

from exumi_data.errors import UsageError
from exumi_data.model.dataset import SplitDocument

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["make_split", "split_ids"]

Level = Literal["episode", "object", "part"]
_COLUMNS = {"episode": "id", "object": "object_id", "part": "part_id"}


def make_split(
    dataset: "Dataset",
    *,
    level: Level = "episode",
    ratio: tuple[int, int] = (15, 1),
    seed: int = 0,
    name: str = "default",
) -> SplitDocument:
    """Divide a dataset into ``train`` and ``val``.

    All episodes of an object or part fall into the same list. The order of groups is that of a
    hash of (seed, group), so it depends neither on the order of episodes nor on the platform.

    Parameters
    ----------
    dataset : Dataset
    level : {"episode", "object", "part"}
    ratio : (int, int)
        Groups in train to groups in val; exUMI's is 15:1. At least one group is in each, if there
        are two.
    seed : int
    name : str

    Returns
    -------
    SplitDocument

    Raises
    ------
    UsageError
        An episode has no object or part, or the ratio makes no sense.
    """
    train, val = ratio
    if train < 0 or val < 0 or train + val == 0:
        raise UsageError(f"a split of {train}:{val} makes no sense")
    if level not in _COLUMNS:
        raise UsageError(f"invalid level ({level!r}). Supported values are {', '.join(_COLUMNS)}")
    keys = dataset.catalog.column(_COLUMNS[level]).to_pylist()
    missing = [i for i, key in enumerate(keys) if key is None]
    if missing:
        raise UsageError(
            f"{len(missing)} episode(s) have no {_COLUMNS[level]}, the first is "
            f"{dataset.ids[missing[0]]}",
            where=dataset.path,
            fix="Split by episode, or select the episodes that have one.",
        )
    groups = sorted(set(keys), key=lambda key: sha256(f"{seed}/{key}".encode()).digest())
    count = round(len(groups) * val / (train + val))
    if val and train and len(groups) > 1:
        count = min(max(count, 1), len(groups) - 1)
    held_out = set(groups[:count])
    lists: dict[str, list[str]] = {"train": [], "val": []}
    for episode_id, key in zip(dataset.ids, keys, strict=True):
        lists["val" if key in held_out else "train"].append(episode_id)
    return SplitDocument(
        name=name,
        level=level,
        seed=seed,
        method=f"hash order of {_COLUMNS[level]}, {train}:{val}",
        lists=lists,
    )


def split_ids(
    dataset: "Dataset",
    split: str,
    *,
    by: Level = "episode",
    ratio: tuple[int, int] = (15, 1),
    seed: int = 0,
) -> list[str]:
    """Return the episode ids of one list of a split.

    Parameters
    ----------
    dataset : Dataset
    split : str
        ``train`` or ``val`` of `make_split`; or ``<name>/<list>`` of a split stored with the
        dataset, in which case the other parameters play no part.
    by : {"episode", "object", "part"}
    ratio : (int, int)
    seed : int
        See `make_split`.

    Returns
    -------
    list of str

    Raises
    ------
    UsageError
        There is no such split or list.
    """
    if "/" in split:
        name, _, part = split.partition("/")
        stored = dataset.splits.get(name)
        if stored is None:
            known = ", ".join(dataset.splits) or "none"
            raise UsageError(f"no split {name!r}; there are: {known}", where=dataset.path)
        lists = stored.lists
    else:
        part = split
        lists = make_split(dataset, level=by, ratio=ratio, seed=seed).lists
    if part not in lists:
        raise UsageError(
            f"no list {part!r} in the split; there are: {', '.join(lists)}", where=dataset.path
        )
    return [episode_id for episode_id in lists[part] if episode_id in dataset]
