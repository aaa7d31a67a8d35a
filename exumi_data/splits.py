"""Splits of a dataset: by episode, object or part; deterministic; never leaking."""

import re
from collections.abc import Mapping
from hashlib import sha256
from typing import TYPE_CHECKING, Any, Literal

from exumi_data.errors import UsageError
from exumi_data.model.dataset import SPLIT_NAME, SplitDocument

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["Level", "leaks_of", "make_split", "split_ids"]

Level = Literal["episode", "object", "part"]
_COLUMNS = {"episode": "id", "object": "object_id", "part": "part_id"}


def make_split(
    dataset: "Dataset",
    *,
    level: Level = "episode",
    ratio: tuple[int, int] = (15, 1),
    lists: Mapping[str, int] | None = None,
    seed: int = 0,
    name: str = "default",
) -> SplitDocument:
    """Divide a dataset into lists, such as ``train`` and ``val``.

    All episodes of an object or part fall into the same list. The order of groups is that of a
    hash of (seed, group), so it depends neither on the order of episodes nor on the platform.

    Parameters
    ----------
    dataset : Dataset
    level : {"episode", "object", "part"}
    ratio : (int, int)
        Groups in train to groups in val; exUMI's is 15:1.
    lists : mapping of str to int, optional
        Names of lists and their shares, instead of `ratio`. At least one group is in each whose
        share is not 0, if there are as many.
    seed : int
    name : str

    Returns
    -------
    SplitDocument

    Raises
    ------
    UsageError
        An episode has no object or part, or the ratio makes no sense, or the name is none.
    """
    shares = dict(lists) if lists is not None else {"train": ratio[0], "val": ratio[1]}
    if any(share < 0 for share in shares.values()) or not sum(shares.values()):
        raise UsageError(f"a split of {':'.join(map(str, shares.values()))} makes no sense")
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
    found: dict[str, list[str]] = {part: [] for part in shares}
    of_group = dict(zip(groups, _deal(len(groups), shares), strict=True))
    for episode_id, key in zip(dataset.ids, keys, strict=True):
        found[of_group[key]].append(episode_id)
    if not re.fullmatch(SPLIT_NAME, name):
        raise UsageError(
            f"{name!r} is no name of a split",
            fix="Small letters, digits, - and _, such as by-part.",
        )
    return SplitDocument(
        name=name,
        level=level,
        seed=seed,
        method=f"hash order of {_COLUMNS[level]}, {':'.join(map(str, shares.values()))}",
        lists=found,
    )


def leaks_of(split: SplitDocument, rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return what is in two lists of a split, or twice in one: episodes, objects or parts.

    Parameters
    ----------
    split : SplitDocument
    rows : mapping of str to mapping
        Of each episode its ``object_id`` and ``part_id``; those that are not known are passed over.

    Returns
    -------
    list of str
        One line each.
    """
    column = _COLUMNS[split.level]
    where: dict[str, set[str]] = {}
    seen: dict[str, list[str]] = {}
    for part, ids in split.lists.items():
        for one in ids:
            seen.setdefault(one, []).append(part)
            key = one if column == "id" else rows.get(one, {}).get(column)
            if key is not None:
                where.setdefault(str(key), set()).add(part)
    found = [
        f"{split.level} {key} would be in {' and '.join(sorted(parts))} of {split.name!r}"
        for key, parts in where.items()
        if len(parts) > 1
    ]
    found += [
        f"episode {one} would be twice in {split.name!r}"
        for one, parts in seen.items()
        if len(parts) > 1 and (column != "id" or len(set(parts)) == 1)
    ]
    return found


def _deal(count: int, shares: Mapping[str, int]) -> list[str]:
    """Return the list of each group in turn: the last list's groups come first."""
    total = sum(shares.values())
    wanted = [part for part, share in shares.items() if share]
    sizes = {part: round(count * shares[part] / total) for part in wanted}
    if count >= len(wanted):
        sizes = {part: max(size, 1) for part, size in sizes.items()}
    # What rounding gave or took is the largest list's.
    largest = max(wanted, key=lambda part: shares[part])
    sizes[largest] = 0
    sizes[largest] = max(count - sum(sizes.values()), 0)
    dealt = [part for part in reversed(wanted) for _ in range(sizes[part])]
    return [*dealt, *[largest] * count][:count]


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
