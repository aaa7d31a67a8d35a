"""Which clips meet in which contrastive batch: pure functions of (seed, epoch)."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from exumi_loaders.draws import words

__all__ = ["PairRules", "batch_count", "order", "pair_batches", "shuffled_batches"]

_CLIPS, _PARTS, _BATCHES = 20, 21, 22  # purposes of draws, see draws.py

Batch = TypeVar("Batch")


@dataclass(frozen=True)
class PairRules:
    """How large batches are.

    Attributes
    ----------
    most, least : int
        Parts of a batch.
    """

    most: int
    least: int


def order(seed: int, epoch: int, count: int, *, purpose: int) -> np.ndarray:
    """Shuffle, (count,) int64: a permutation that depends on nothing but its arguments."""
    return np.argsort(_keys(seed, epoch, np.arange(count), purpose), kind="stable")


def _keys(seed: int, epoch: int, indices: np.ndarray, purpose: int) -> np.ndarray:
    epochs = np.full(len(indices), epoch)
    return words(seed, epochs, indices, 1, purpose=purpose)[:, 0]


def batch_count(pairs: np.ndarray, rules: PairRules) -> int:
    """Return how many batches a group of parts fills in an epoch.

    A part is in each batch at most once, so parts with many pairs give no more pairs than there
    are batches. There are as many batches as it takes to hold all pairs, or fewer where batches
    would be too small: 0 where not even one can be filled.

    Parameters
    ----------
    pairs : (M,) int
        Pairs that each part of the group has.
    rules : PairRules
    """
    if len(pairs) < rules.least:
        return 0
    count = -(-int(pairs.sum()) // min(rules.most, len(pairs)))
    while int(np.minimum(pairs, count).sum()) < rules.least * count:
        count -= 1
    return count


def pair_batches(
    seed: int,
    epoch: int,
    clips: np.ndarray,
    part: np.ndarray,
    episode: np.ndarray,
    rules: PairRules,
) -> list[np.ndarray]:
    """Pair the clips of one group and put the pairs into batches.

    Each clip is used at most once an epoch, of an episode with several streams one clip. Which
    pairs are made, which clip is left over, and which parts meet changes with the epoch.

    Parameters
    ----------
    seed, epoch : int
    clips : (N,) int
        Positions in the table of clips.
    part, episode : (N,) int
        Of each clip.
    rules : PairRules

    Returns
    -------
    list of (n, 2) int64
        Clips of each batch: one row a part, two clips of different episodes.
    """
    first, second, owner = _pairs(_keys(seed, epoch, clips, _CLIPS), clips, part, episode)
    pairs_of = np.bincount(owner, minlength=int(part.max()) + 1)
    count = batch_count(pairs_of[pairs_of > 0], rules)
    if not count:
        return []
    # Parts in random order, of each as many pairs as there are batches; dealt out in turn, so no
    # part comes twice into a batch, and batches differ by at most one part in size.
    place = np.empty(len(pairs_of), dtype=np.int64)
    place[order(seed, epoch, len(pairs_of), purpose=_PARTS)] = np.arange(len(pairs_of))
    dealt = np.argsort(place[owner], kind="stable")
    within = _rank_within(owner[dealt])
    dealt = dealt[within < count][: count * rules.most]
    return [
        np.stack((first[dealt[slot::count]], second[dealt[slot::count]]), axis=1)
        for slot in range(count)
    ]


def shuffled_batches(seed: int, epoch: int, batches: list[Batch]) -> list[Batch]:
    """Return the batches of all groups in the order of an epoch."""
    return [batches[at] for at in order(seed, epoch, len(batches), purpose=_BATCHES)]


def _pairs(
    keys: np.ndarray, clips: np.ndarray, part: np.ndarray, episode: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return first and second clip, and part, of every pair of an epoch."""
    by_episode = np.lexsort((keys, episode, part))
    repeated = np.zeros(len(clips), dtype=bool)
    same = part[by_episode][1:] == part[by_episode][:-1]
    repeated[1:] = same & (episode[by_episode][1:] == episode[by_episode][:-1])
    one_each = by_episode[~repeated]
    shuffled = one_each[np.lexsort((keys[one_each], part[one_each]))]
    rank = _rank_within(part[shuffled])
    has_other = np.append(part[shuffled][1:] == part[shuffled][:-1], False)
    at = np.flatnonzero((rank % 2 == 0) & has_other)
    return clips[shuffled[at]], clips[shuffled[at + 1]], part[shuffled[at]]


def _rank_within(owner: np.ndarray) -> np.ndarray:
    """Count 0, 1, 2 ... within each run of equal values."""
    if not len(owner):
        return np.empty(0, dtype=np.int64)
    starts = np.flatnonzero(np.append(True, owner[1:] != owner[:-1]))
    return np.arange(len(owner)) - np.repeat(starts, np.diff(np.append(starts, len(owner))))
