"""Which episodes of a dataset are meant: by id, by what the catalog says, by a split's list."""

import operator
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from exumi_data.errors import UsageError
from exumi_data.splits import split_ids

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["choose", "find_ids", "matching_ids"]

_CONDITION = re.compile(r"\s*([a-z_0-9]+)\s*(<=|>=|!=|=|<|>)\s*(.*?)\s*", re.DOTALL)
_COMPARE = {"<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge}
_SHORTEST = 4
_NESTED = ("labels", "quality", "streams")


def choose(
    dataset: "Dataset",
    *,
    ids: Sequence[str] = (),
    where: Sequence[str] = (),
    split: str | None = None,
    everything: bool = False,
) -> list[str]:
    """Return the ids of the episodes that are meant, in the dataset's order.

    Parameters
    ----------
    dataset : Dataset
    ids : sequence of str
        Ids, or their beginnings or ends of at least four characters that are one episode's alone.
    where : sequence of str
        Conditions on the catalog, all of which hold: ``task=press``, ``duration_s>=5``,
        ``success!=true``, ``object_id=mug|cup``, ``kind=tactile``, ``object_id=`` for none.
    split : str, optional
        ``<name>/<list>`` of a split.
    everything : bool
        All episodes; needed where nothing else is said.

    Returns
    -------
    list of str

    Raises
    ------
    UsageError
        Nothing was said, or something that makes no sense.
    """
    if not (ids or where or split or everything):
        raise UsageError(
            "which episodes?", fix="Name ids, or say --where COLUMN=VALUE, --split LIST or --all."
        )
    chosen = set(dataset.ids)
    if ids:
        chosen &= set(find_ids(dataset, ids))
    for condition in where:
        chosen &= set(matching_ids(dataset, condition))
    if split is not None:
        if "/" not in split:
            raise UsageError(
                f"{split!r} is no list of a split", fix="Write it such as default/val."
            )
        chosen &= set(split_ids(dataset, split))
    return [episode_id for episode_id in dataset.ids if episode_id in chosen]


def find_ids(dataset: "Dataset", named: Sequence[str]) -> list[str]:
    """Return the ids that are meant by their beginnings or ends.

    Parameters
    ----------
    dataset : Dataset
    named : sequence of str

    Raises
    ------
    UsageError
        None is meant, or several are; all of them are named.
    """
    found, problems = [], []
    for text in named:
        if text in dataset:
            found.append(text)
            continue
        fitting = [
            one for one in dataset.ids if one.startswith(text.lower()) or one.endswith(text.lower())
        ]
        if len(fitting) == 1 and len(text) >= _SHORTEST:
            found.append(fitting[0])
        elif len(fitting) > 1:
            problems.append(f"{text!r} is the beginning or end of {len(fitting)} ids")
        else:
            problems.append(f"no episode {text!r}")
    if problems:
        raise UsageError("; ".join(problems), where=dataset.path)
    return found


def matching_ids(dataset: "Dataset", condition: str) -> list[str]:
    """Return the ids of episodes of which a condition holds.

    Parameters
    ----------
    dataset : Dataset
    condition : str
        See `choose`. What the catalog does not know is not equal to anything, and neither less nor
        more.

    Raises
    ------
    UsageError
        It is no condition, or there is no such column.
    """
    parts = _CONDITION.fullmatch(condition)
    if parts is None:
        raise UsageError(
            f"{condition!r} is no condition", fix="Write COLUMN=VALUE, such as task=press."
        )
    column, relation, value = parts.groups()
    if column in ("stream", "kind", "quality"):
        if relation not in ("=", "!="):
            raise UsageError(f"a {column} is or is not there, and not {relation} something")
        with_it = _having(dataset, column, set(value.split("|")))
        return [one for one in dataset.ids if (one in with_it) == (relation == "=")]
    names = [name for name in dataset.catalog.schema.names if name not in _NESTED]
    if column not in names:
        raise UsageError(
            f"the catalog has no column {column!r}",
            where=dataset.path,
            fix=f"It has: {', '.join([*names, 'stream', 'kind', 'quality'])}.",
        )
    values = dataset.catalog.column(column).to_pylist()
    wanted = [_typed(text, dataset, column) for text in value.split("|")] if value else [None]
    return [
        one
        for one, there in zip(dataset.ids, values, strict=True)
        if _holds(there, relation, wanted)
    ]


def _having(dataset: "Dataset", column: str, wanted: set[str]) -> set[str]:
    """Return the ids of episodes that have a stream, a kind of stream or a note of quality."""
    if column != "quality":
        streams: dict[str, Any] = {column: wanted}
        return set(dataset.select(**streams).ids)
    codes = dataset.catalog.column("quality").to_pylist()
    return {one for one, said in zip(dataset.ids, codes, strict=True) if wanted & set(said)}


def _typed(text: str, dataset: "Dataset", column: str) -> Any:
    """Return a value as the column has it."""
    import pyarrow as pa

    kind = dataset.catalog.schema.field(column).type
    try:
        if pa.types.is_boolean(kind):
            return {"true": True, "yes": True, "false": False, "no": False}[text.lower()]
        if pa.types.is_integer(kind):
            return int(text)
        return float(text) if pa.types.is_floating(kind) else text
    except (KeyError, ValueError):
        raise UsageError(f"{column} is {kind}, and not {text!r}") from None


def _holds(there: Any, relation: str, wanted: list[Any]) -> bool:
    if relation == "=":
        return there in wanted
    if relation == "!=":
        return there not in wanted
    if there is None or len(wanted) != 1 or wanted[0] is None:
        return False
    return bool(_COMPARE[relation](there, wanted[0]))
