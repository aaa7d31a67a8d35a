"""What may be private, and the gate: every kind that is found is kept or removed explicitly."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

from exumi_data.errors import UsageError

__all__ = [
    "KINDS",
    "Kind",
    "PrivateItem",
    "Take",
    "check_kinds",
    "counted",
    "shortened",
    "unresolved",
]

Kind = Literal["operator", "site", "serial", "host", "user", "path", "email", "gps"]

KINDS: dict[Kind, str] = {
    "operator": "who collected it",
    "site": "where it was collected, in words",
    "serial": "serial numbers and other ids of single devices",
    "host": "names and addresses of computers",
    "user": "names of accounts",
    "path": "absolute paths, also of home folders",
    "email": "e-mail addresses",
    "gps": "positions on earth, in the metadata and in what cameras wrote into their files",
}
"""Kinds of what may be private, and what each is."""

_SHOWN = 48


@dataclass(frozen=True, slots=True)
class PrivateItem:
    """Something that may be private.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    episode : str
        Path of the episode below the dataset; empty for the dataset's own documents.
    where : str
        Document and JSON pointer, such as ``zarr.json#/attributes/exumi/operator``, or stream and
        file, such as ``streams/rgb: GX010001.MP4``.
    value : str
        What is there, shortened.
    why : str
        Why it is listed.
    removable : bool
        Whether it can be taken out and the rest left as it is.
    """

    kind: Kind
    episode: str
    where: str
    value: str
    why: str
    removable: bool = True


class Take(Protocol):
    """Told of each find; says whether it is to be taken out."""

    def __call__(
        self, kind: Kind, where: str, value: str, why: str, *, removable: bool = True
    ) -> bool:
        """Return whether it is to be taken out."""
        ...


def shortened(value: object) -> str:
    """Return a value as one short line."""
    text = "".join(c if c.isprintable() else " " for c in str(value)).strip()
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 17]}…{text[-16:]}"


def check_kinds(kinds: Iterable[str]) -> frozenset[Kind]:
    """Return kinds as they were named.

    Parameters
    ----------
    kinds : iterable of str

    Raises
    ------
    UsageError
        One is none of `KINDS`.
    """
    named = set(kinds)
    unknown = sorted(named - set(KINDS))
    if unknown:
        raise UsageError(
            f"invalid kind ({', '.join(unknown)}). Supported values are {', '.join(KINDS)}"
        )
    return frozenset(kind for kind in KINDS if kind in named)


def unresolved(
    items: Iterable[PrivateItem], keep: Collection[str], remove: Collection[str]
) -> list[PrivateItem]:
    """Return what nobody decided about: its kind is neither kept nor removed, or cannot be removed.

    Parameters
    ----------
    items : iterable of PrivateItem
    keep, remove : collection of str
        Kinds.

    Returns
    -------
    list of PrivateItem

    Raises
    ------
    UsageError
        A kind is unknown, or both kept and removed.
    """
    kept, removed = check_kinds(keep), check_kinds(remove)
    if kept & removed:
        raise UsageError(f"both kept and removed: {', '.join(sorted(kept & removed))}")
    return [
        item
        for item in items
        if item.kind not in kept and (item.kind not in removed or not item.removable)
    ]


def counted(items: Iterable[PrivateItem]) -> dict[tuple[Kind, str, str], list[PrivateItem]]:
    """Group what says the same: by kind, value and reason, the most frequent first.

    Parameters
    ----------
    items : iterable of PrivateItem

    Returns
    -------
    dict
        Keys are (kind, value, why).
    """
    groups: dict[tuple[Kind, str, str], list[PrivateItem]] = {}
    for item in items:
        groups.setdefault((item.kind, item.value, item.why), []).append(item)
    return dict(sorted(groups.items(), key=lambda group: (-len(group[1]), group[0])))
