"""How good is retrieval: first place, in the first five, with intervals."""

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
_SAMPLES = 5  # nearest clips that ranking by matches looks at, as in Octopi


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
    first, five : Share
    """

    by: By
    ranking: Ranking
    queries: int
    groups: int
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
        By part and by object, in both rankings; those for which something is known. A part or
        object that the index does not have counts as not found.

    Raises
    ------
    UsageError
        The index holds one of the clips, or they are of another encoder, or nothing is known of
        what they touched.
    """
    for number, entry in enumerate(clips.entries):
        if index.holds(entry.origins):
            raise UsageError(
                f"the index holds {entry.id}: a query that finds itself says nothing "
                f"({_held(index, clips)} of {len(clips)} queries are in it)",
                where=index.path,
                fix="Score with clips of another split, or with leave_one_out (--leave-one-out).",
            )
        index.place([clips.embedding(number)])  # refuses another encoder before anything is scored
    placed = index.place([clips.embedding(number) for number in range(len(clips))])
    wanted = min(len(index), 64)
    known = index.entries()
    truth = _Truth(known, clips.entries)
    vectors = np.concatenate([block for s in index.segments for block in s.living()])
    return truth.scores([np.argsort(-(vectors @ query), kind="stable") for query in placed[:, :]])


def _held(index: TactileIndex, clips: EncodedClips) -> int:
    return sum(index.holds(entry.origins) for entry in clips.entries)
