"""How good is retrieval: first place, in the first five, with intervals."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.encoder import Encoder
from exumi_loaders.retrieval.building import EncodedClips
from exumi_loaders.retrieval.entries import Entry
from exumi_loaders.retrieval.index import TactileIndex
from exumi_loaders.retrieval.matches import Ranking, rank
from exumi_loaders.retrieval.space import fit_space, unit

__all__ = ["Score", "Share", "clustered", "evaluate", "leave_one_out"]

By = Literal["part", "object"]
_WAYS: tuple[tuple[By, Ranking], ...] = (
    ("part", "similarity"),
    ("part", "matches"),
    ("object", "similarity"),
    ("object", "matches"),
)
_RESAMPLED = 2000
_PLACES = 5  # also the nearest clips that ranking by matches looks at, as in Octopi


@dataclass(frozen=True)
class Share:
    """A share of queries, with its 95 % interval.

    Attributes
    ----------
    value, low, high : float
        From 0 to 1. The interval comes from drawing parts with replacement 2000 times: clips of
        one part are alike, so that their count says less than the count of parts.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Score:
    """How often what was touched comes first, and among the first five.

    Attributes
    ----------
    by : {"part", "object"}
        What must be found: the part id, or the object's name.
    ranking : {"similarity", "matches"}
        ``matches`` looks at the five nearest clips.
    queries, groups : int
        Clips that were asked with, and the parts or objects that they are of.
    known : int
        Queries whose part or object the index has. The others cannot be found, and count as not
        found: with a split by part, nothing can.
    first, five : Share
    """

    by: By
    ranking: Ranking
    queries: int
    groups: int
    known: int
    first: Share
    five: Share

    def as_dict(self) -> dict[str, Any]:
        """Return what JSON can write."""
        return asdict(self)


def clustered(hits: np.ndarray, clusters: np.ndarray, *, seed: int = 0) -> Share:
    """Return the mean of hits, with an interval that draws whole clusters.

    Parameters
    ----------
    hits : (N,) bool
    clusters : (N,) int or str
        What each belongs to.
    seed : int

    Returns
    -------
    Share
    """
    _, codes = np.unique(clusters, return_inverse=True)
    count = np.bincount(codes).astype(float)
    right = np.bincount(codes, weights=hits.astype(float))
    drawn = np.random.default_rng(seed).integers(0, len(count), (_RESAMPLED, len(count)))
    means = right[drawn].sum(1) / count[drawn].sum(1)
    low, high = np.quantile(means, (0.025, 0.975))
    return Share(float(hits.mean()), float(low), float(high))


def evaluate(index: TactileIndex, clips: EncodedClips) -> list[Score]:
    """Score an index by clips that it does not hold.

    Parameters
    ----------
    index : TactileIndex
    clips : EncodedClips
        Queries, with known parts or objects: of `encode_clips`.

    Returns
    -------
    list of Score
        By part and by object, in both rankings, as far as is known what was touched. A part or
        object that the index does not have counts as not found.

    Raises
    ------
    UsageError
        The index holds one of the clips; they are of another encoder; nothing is known of what
        they touched.
    """
    placed = index.place([clips.embedding(number) for number in range(len(clips))])
    held = [entry.id for entry in clips.entries if index.holds(entry.origins)]
    if held:
        raise UsageError(
            f"the index holds {len(held)} of {len(clips)} queries, the first is {held[0]}: a query "
            "that finds itself says nothing",
            where=index.path,
            fix="Score with clips of another split, or each clip by an index without it: "
            "leave_one_out(), --leave-one-out.",
        )

    def found(number: int, by: By, ranking: Ranking) -> list[str]:
        matches = index.ranked(
            placed[number : number + 1],
            k=_PLACES,
            ranking=ranking,
            unique=by,
            samples=_PLACES if ranking == "matches" else None,
        )
        return [_label(match.entry, by) for match in matches]

    return _scores(clips.entries, index.entries(), found)


def leave_one_out(
    clips: EncodedClips,
    encoder: Encoder,
    *,
    on_done: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Score]:
    """Score each clip by an index of all the others, whose space has not seen it either.

    Parameters
    ----------
    clips : EncodedClips
    encoder : Encoder
        The one that made them.
    on_done : callable
        Told of the clips scored, and of all.

    Returns
    -------
    list of Score

    Raises
    ------
    UsageError
        The clips are of another encoder, or nothing is known of what they touched.
    """
    if encoder.digest != clips.encoder:
        raise UsageError(f"the clips were encoded by {clips.encoder}, not by {encoder.digest}")
    nearest = []
    for number in range(len(clips)):
        others = np.delete(np.arange(len(clips)), number)
        similarity = _similarity(clips.vectors, others, number, encoder.whitening)
        order = np.argsort(-similarity, kind="stable")
        nearest.append((others[order], similarity[order]))
        on_done(number + 1, len(clips))
    labels: dict[By, np.ndarray] = {
        by: np.unique([_label(e, by) for e in clips.entries], return_inverse=True)[1]
        for by in ("part", "object")
    }

    def found(number: int, by: By, ranking: Ranking) -> list[str]:
        rows, similarity = nearest[number]
        if ranking == "matches":
            rows, similarity = rows[:_PLACES], similarity[:_PLACES]
        first, _ = rank(labels[by][rows], similarity, ranking)
        return [_label(clips.entries[row], by) for row in rows[first[:_PLACES]]]

    return _scores(clips.entries, clips.entries, found)


def _similarity(
    vectors: np.ndarray, others: np.ndarray, number: int, whitening: int | None
) -> np.ndarray:
    known, query = vectors[others], vectors[number : number + 1]
    if whitening is None:
        return np.asarray((unit(known) @ unit(query).T)[:, 0])
    space = fit_space(known, whitening)
    return np.asarray((space.place(known) @ space.place(query).T)[:, 0])


def _label(entry: Entry, by: By) -> str:
    """Return the part or object, told apart as an index does."""
    return f"part/{entry.part_id}" if by == "part" and entry.part_id else entry.name


def _scores(
    entries: Sequence[Entry],
    held: Sequence[Entry],
    found: Callable[[int, By, Ranking], list[str]],
) -> list[Score]:
    """Score queries; `held` are the entries that they are looked for in.

    Where a query is looked for among its own kind, its own entry is none to find.
    """
    scores = []
    for by, ranking in _WAYS:
        asked = [n for n, entry in enumerate(entries) if _is_known(entry, by)]
        if not asked:
            continue
        truth = [_label(entries[n], by) for n in asked]
        places = [found(n, by, ranking) for n in asked]
        pairs = list(zip(truth, places, strict=True))
        clusters = np.array([_label(entries[n], "part") for n in asked])
        first = np.array([place[:1] == [label] for label, place in pairs])
        five = np.array([label in place for label, place in pairs])
        there = Counter(_label(entry, by) for entry in held)
        itself = 1 if held is entries else 0
        known = sum(there[label] > itself for label in truth)
        share = (clustered(first, clusters), clustered(five, clusters))
        scores.append(Score(by, ranking, len(asked), len(set(truth)), known, *share))
    if not scores:
        raise UsageError(
            "nothing is known of what the clips touched", fix="They need part or object ids."
        )
    return scores


def _is_known(entry: Entry, by: By) -> bool:
    return (entry.part_id if by == "part" else entry.object_id) is not None
