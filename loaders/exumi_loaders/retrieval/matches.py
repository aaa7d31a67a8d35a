"""From the nearest clips to the most similar objects."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.retrieval.entries import Entry

__all__ = [
    "RANKINGS",
    "UNIQUE",
    "Match",
    "Ranking",
    "Unique",
    "check_choice",
    "look",
    "rank",
    "similar_line",
]

Ranking = Literal["similarity", "matches"]
Unique = Literal["object", "part", "clip"]
RANKINGS: tuple[Ranking, ...] = ("similarity", "matches")
UNIQUE: tuple[Unique, ...] = ("object", "part", "clip")

_ORDER = {
    "similarity": "decreasing similarity",
    "matches": "decreasing number of matches, then of similarity",
}
_WHAT = {"object": "objects", "part": "parts", "clip": "clips"}


@dataclass(frozen=True)
class Match:
    """An object, part or clip that feels like the query.

    Attributes
    ----------
    entry : Entry
        Its entry that is most similar.
    similarity : float
        Cosine of that entry and the query, −1 to 1.
    matches : int
        How many of the nearest entries that were looked at are of it.
    """

    entry: Entry
    similarity: float
    matches: int

    @property
    def name(self) -> str:
        """Name of the object."""
        return self.entry.name

    @property
    def adjectives(self) -> tuple[str, ...]:
        """How the most similar entry feels."""
        return self.entry.adjectives

    def as_dict(self) -> dict[str, Any]:
        """Return what JSON can write."""
        entry = asdict(self.entry)
        entry["adjectives"] = list(self.entry.adjectives)
        del entry["origins"]
        return {"similarity": self.similarity, "matches": self.matches, **entry}


def check_choice(name: str, value: str, supported: Sequence[str]) -> None:
    """Raise `UsageError` for a value that is not supported."""
    if value not in supported:
        raise UsageError(
            f"invalid {name} ({value!r}). Supported values are {', '.join(map(repr, supported))}"
        )


def look(
    nearest: Callable[[int], tuple[np.ndarray, np.ndarray]],
    codes: np.ndarray,
    k: int,
    samples: int | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Look at the nearest rows: at so many, or at as many as it takes to find k groups.

    Parameters
    ----------
    nearest : callable
        Returns similarity and row, each (1, n), of at most so many rows; −1 is no row.
    codes : (R,) int
        Group of each row.
    k : int
        How many groups are looked for.
    samples : int or None
        How many rows are looked at.

    Returns
    -------
    similarity : (M,) float32
        Falling.
    row : (M,) int64
    group : (M,) int
    """
    wanted = samples or 4 * k
    while True:
        similarity, rows = (found[0] for found in nearest(wanted))
        similarity, rows = similarity[rows >= 0], rows[rows >= 0]
        groups = codes[rows]
        if samples is not None:
            return similarity, rows, groups
        _, first = np.unique(groups, return_index=True)
        if len(first) >= k:
            end = int(np.sort(first)[k - 1]) + 1
            return similarity[:end], rows[:end], groups[:end]
        if len(rows) < wanted:
            return similarity, rows, groups
        wanted *= 4


def rank(
    groups: np.ndarray, similarity: np.ndarray, ranking: Ranking
) -> tuple[np.ndarray, np.ndarray]:
    """Order groups of the nearest rows.

    Parameters
    ----------
    groups : (M,) int
        Group of each of the nearest rows.
    similarity : (M,) float
        Falling.
    ranking : {"similarity", "matches"}

    Returns
    -------
    first : (G,) int64
        Place of the most similar row of each group, best group first.
    matches : (G,) int64
        Rows of each group.
    """
    _, first, matches = np.unique(groups, return_index=True, return_counts=True)
    if ranking == "matches":
        order = np.lexsort((first, -similarity[first], -matches))
    else:
        order = np.argsort(first)
    return first[order], matches[order]


def similar_line(matches: Sequence[Match], *, ranking: Ranking, unique: Unique = "object") -> str:
    """Write the line that a tactile-language model reads.

    Parameters
    ----------
    matches : sequence of Match
        In that ranking.
    ranking : {"similarity", "matches"}
        The line names it.
    unique : {"object", "part", "clip"}

    Returns
    -------
    str

    Examples
    --------
    >>> similar_line([], ranking="similarity")
    'Most similar objects (in order of decreasing similarity): none.'
    """
    described = "; ".join(map(_described, matches)) or "none"
    return f"Most similar {_WHAT[unique]} (in order of {_ORDER[ranking]}): {described}."


def _described(match: Match) -> str:
    words = ", ".join(match.adjectives)
    return f"{match.name} ({words})" if words else match.name
