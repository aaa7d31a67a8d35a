"""Tactile sorting: which of two parts is harder, or rougher, by touch alone (Octopi-1.5)."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.options import one_of
from exumi_loaders.retrieval.matches import Match
from exumi_loaders.retrieval.scoring import Share
from exumi_loaders.retrieval.space import fit_space, unit

__all__ = ["SortingResult", "felt_rating", "tactile_sorting"]

Method = Literal["neighbours", "ridge"]
Tested = Literal["seen", "unseen"]

_RESAMPLED = 2000
_MOST_WEIGHTS = 1 << 24  # of a resampling at once, in memory


@dataclass(frozen=True)
class SortingResult:
    """How often two parts were put in the right order.

    Attributes
    ----------
    method : {"neighbours", "ridge"}
    tested : {"seen", "unseen"}
        Other clips of parts that ratings are known of, or parts of which nothing is known.
    margin : float
        Pairs are of parts whose ratings differ by more.
    parts : int
        Those in any pair.
    pairs : int
        Pairs of parts; each was asked with many pairs of clips.
    right : Share
        A tie counts half; chance is 0.5. The interval draws parts with replacement.
    """

    method: Method
    tested: Tested
    margin: float
    parts: int
    pairs: int
    right: Share

    def as_dict(self) -> dict[str, Any]:
        """Return what JSON can write."""
        return asdict(self)


def felt_rating(matches: Sequence[Match], name: str) -> float | None:
    """Return how a clip is rated by what felt alike: the mean, weighted by similarity.

    Parameters
    ----------
    matches : sequence of Match
        Of ``TactileIndex.query(..., unique="clip")``, as many as are to count.
    name : str
        Of the property.

    Returns
    -------
    float or None
        From 0 to 10; None where no match has such a rating.
    """
    rated = [match for match in matches if name in match.entry.labels]
    if not rated:
        return None
    similarity = np.array([[match.similarity for match in rated]])
    ratings = np.array([[match.entry.labels[name] for match in rated]])
    return float(_weighted(similarity, ratings)[0])


def _weighted(similarity: np.ndarray, ratings: np.ndarray) -> np.ndarray:
    """Mean of ratings (B, k) weighted by similarity; what is not similar at all weighs nothing."""
    weights = np.maximum(similarity, 1e-6)
    return np.asarray((weights * ratings).sum(axis=1) / weights.sum(axis=1))


def tactile_sorting(  # noqa: PLR0913  # keyword-only options, each with a default
    vectors: np.ndarray,
    parts: np.ndarray,
    ratings: np.ndarray,
    *,
    whitening: int | None,
    tested: Tested = "unseen",
    method: Method = "neighbours",
    margin: float = 2.0,
    neighbours: int = 5,
    penalty: float = 1.0,
    folds: int = 5,
    rounds: int = 10,
    seed: int = 0,
) -> SortingResult:
    """Rate clips by what felt alike, and compare them in pairs.

    Some clips are rated by all the others, to which the space is fitted, too. Where parts are
    ``unseen``, these are all clips of some parts: one fold of them. Where parts are ``seen``, it is
    one clip of each part, drawn anew in each round, and its other clips are known. Then all pairs
    are compared whose parts differ clearly in their ratings; each pair of parts counts once.

    Parameters
    ----------
    vectors : (N, D) float32
        Clips, as the encoder gives them.
    parts : (N,) str
        Part of each clip.
    ratings : (N,) float
        Of one property, from 0 to 10, NaN where there is none. A part has the mean of its clips.
    whitening : int or None
        Of the encoder.
    tested : {"seen", "unseen"}
    method : {"neighbours", "ridge"}
        The mean rating of the nearest clips, weighted by their similarity; or a ridge regression
        on the vectors.
    margin : float
        Parts whose ratings differ by no more are not compared.
    neighbours : int
        Nearest clips that count.
    penalty : float
        Of the ridge regression, on vectors of length 1.
    folds : int
        Of ``unseen`` parts; drawn anew in each round.
    rounds : int
    seed : int

    Returns
    -------
    SortingResult

    Raises
    ------
    UsageError
        There are too few parts or clips with ratings, or none that differ enough.
    """
    one_of("method", method, ("neighbours", "ridge"))
    one_of("tested", tested, ("seen", "unseen"))
    if folds < 2 or rounds < 1 or neighbours < 1 or not penalty > 0 or margin < 0:
        raise UsageError(
            f"folds ({folds}, at least 2), rounds ({rounds}), neighbours ({neighbours}), penalty "
            f"({penalty}) must be positive, margin ({margin}) not negative"
        )
    rated = ~np.isnan(ratings)
    names, code = np.unique(parts[rated], return_inverse=True)
    vectors = vectors[rated]
    mean = np.bincount(code, weights=ratings[rated]) / np.bincount(code)
    right = np.zeros((len(names), len(names)))
    asked = np.zeros((len(names), len(names)))
    rng = np.random.default_rng(seed)
    for fold in _folds(code, tested, folds, rounds, rng):
        known = ~fold
        space = None if whitening is None else fit_space(vectors[known], whitening)
        placed = unit(vectors) if space is None else space.place(vectors)
        truth = mean[code[known]]
        if method == "ridge":
            felt = _ridge(placed[known], truth, placed[fold], penalty)
        else:
            felt = _by_neighbours(placed[known], truth, placed[fold], neighbours)
        _compare(felt, code[fold], mean, margin, right, asked)
    there = asked > 0
    if not there.any():
        raise UsageError(f"no two parts are rated more than {margin} apart, or ever met in a fold")
    # Each pair of parts counts once, however many clips it was asked with.
    share = np.divide(right, asked, out=np.zeros_like(right), where=there)
    return SortingResult(
        method=method,
        tested=tested,
        margin=margin,
        parts=int((there | there.T).any(axis=0).sum()),
        pairs=int(there.sum()),
        right=_share_of_pairs(share, there, seed),
    )


def _folds(
    code: np.ndarray, tested: Tested, folds: int, rounds: int, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Yield which clips are asked with, (N,) bool each."""
    count = np.bincount(code)
    if tested == "seen" and count.min(initial=2) < 2:
        raise UsageError("a part has a single clip with a rating: nothing else is known of it")
    if tested == "unseen" and len(count) < 2 * folds:
        raise UsageError(f"{len(count)} parts with ratings are too few for {folds} folds")
    for _ in range(rounds):
        if tested == "unseen":
            fold_of = np.empty(len(count), dtype=np.int64)
            fold_of[rng.permutation(len(count))] = np.arange(len(count)) % folds
            yield from (fold_of[code] == fold for fold in range(folds))
            continue
        # One clip of each part: all parts meet, and others of their clips are known.
        order = np.lexsort((rng.random(len(code)), code))
        first = np.concatenate(([0], np.cumsum(count)[:-1]))
        chosen = np.zeros(len(code), dtype=bool)
        chosen[order[first]] = True
        yield chosen


def _by_neighbours(
    known: np.ndarray, ratings: np.ndarray, asked: np.ndarray, neighbours: int
) -> np.ndarray:
    similarity = asked @ known.T
    nearest = np.argsort(-similarity, axis=1, kind="stable")[:, :neighbours]
    return _weighted(np.take_along_axis(similarity, nearest, axis=1), ratings[nearest])


def _ridge(known: np.ndarray, ratings: np.ndarray, asked: np.ndarray, penalty: float) -> np.ndarray:
    """Hoerl and Kennard (1970); the mean rating is not penalised."""
    middle, offset = known.mean(axis=0), ratings.mean()
    centred = (known - middle).astype(np.float64)
    power = centred.T @ centred + penalty * np.eye(known.shape[1])
    weights = np.linalg.solve(power, centred.T @ (ratings - offset))
    return np.asarray((asked - middle) @ weights + offset)


def _compare(
    felt: np.ndarray,
    code: np.ndarray,
    mean: np.ndarray,
    margin: float,
    right: np.ndarray,
    asked: np.ndarray,
) -> None:
    """Count pairs of clips, at the pair of their parts: the one that is rated higher first."""
    higher, lower = np.nonzero(mean[code][:, None] - mean[code] > margin)
    difference = felt[higher] - felt[lower]
    at = (code[higher], code[lower])
    np.add.at(right, at, (difference > 0) + 0.5 * (difference == 0))
    np.add.at(asked, at, 1)


def _share_of_pairs(share: np.ndarray, there: np.ndarray, seed: int) -> Share:
    """Return the mean over pairs of parts, with an interval that draws parts."""
    count = len(there)
    rng = np.random.default_rng(seed)
    means = []
    block = max(1, _MOST_WEIGHTS // count)
    for start in range(0, _RESAMPLED, block):
        draws = min(block, _RESAMPLED - start)
        # How often each part was drawn; a pair counts as often as its two parts meet.
        weights = rng.multinomial(count, np.full(count, 1 / count), size=draws).astype(float)
        won = ((weights @ share) * weights).sum(axis=1)
        met = ((weights @ there) * weights).sum(axis=1)
        means.append(won[met > 0] / met[met > 0])
    low, high = np.quantile(np.concatenate(means), (0.025, 0.975))
    return Share(float(share[there].mean()), float(low), float(high))
