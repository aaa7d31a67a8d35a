"""Octopi-1.5's Guessing Game, played by an encoder alone: one of five was touched."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.retrieval.scoring import Share, clustered
from exumi_loaders.retrieval.space import Space, fit_space, unit

__all__ = ["GameResult", "guessing_game"]

_NEIGHBOURS = 5


@dataclass(frozen=True)
class GameResult:
    """How often the right candidate was named.

    Attributes
    ----------
    taught : int
        Clips of each candidate that were taught; 0: none.
    candidates, games, parts : int
        ``parts`` were the one to guess at least once.
    right : Share
        With an interval that draws the parts to guess with replacement.
    """

    taught: int
    candidates: int
    games: int
    parts: int
    right: Share

    def as_dict(self) -> dict[str, Any]:
        """Return what JSON can write."""
        return asdict(self)


def guessing_game(  # noqa: PLR0913  # keyword-only options, each with a default
    vectors: np.ndarray,
    parts: np.ndarray,
    *,
    whitening: int | None,
    taught: int = 1,
    labels: np.ndarray | None = None,
    candidates: int = 5,
    folds: int = 5,
    rounds: int = 10,
    seed: int = 0,
) -> GameResult:
    """Play games with parts that an index has not seen when it was built.

    The parts are divided into folds; the index is built from all other folds (its space is
    fitted to them alone). In each round each unseen part is to be guessed once for each of its
    clips, against other unseen parts drawn anew. Each candidate is taught by so many of its
    clips, never by the one that is asked with; the guess is the candidate whose averaged vector
    is most similar. Taught none, the guess is the candidate whose labels are nearest to the mean
    labels of the five most similar clips of the index.

    Parameters
    ----------
    vectors : (N, D) float32
        Clips, as the encoder gives them.
    parts : (N,) str
        Part of each clip.
    whitening : int or None
        Of the encoder.
    taught : int
        Clips of each candidate.
    labels : (N, P) float, optional
        Ratings of each clip, NaN where there are none; needed where nothing is taught.
    candidates : int
    folds, rounds : int
    seed : int

    Returns
    -------
    GameResult

    Raises
    ------
    UsageError
        There are not enough parts or clips.
    """
    if taught == 0 and labels is None:
        raise UsageError("without teaching, a guess goes by labels: give them")
    counts = {part: int((parts == part).sum()) for part in np.unique(parts)}
    usable = np.array([part for part, count in counts.items() if count > taught])
    if taught == 0 and labels is not None:
        rated = ~np.isnan(labels).any(axis=1)
        usable = np.array([part for part in usable if rated[parts == part].all()])
    if folds < 2 or candidates < 2 or len(usable) // max(1, folds) < candidates:
        raise UsageError(
            f"{len(usable)} parts with more than {taught} clips are too few for {folds} folds of "
            f"{candidates} candidates"
        )
    rng = np.random.default_rng(seed)
    right: list[bool] = []
    asked: list[str] = []
    for _ in range(rounds):
        shuffled = rng.permutation(usable)
        for fold in range(folds):
            unseen = shuffled[fold::folds]
            seen = ~np.isin(parts, unseen)
            placed = _placed(vectors, seen, whitening)
            table = _Table(placed, parts, seen, labels)
            for part in unseen:
                for clip in np.flatnonzero(parts == part).tolist():
                    others = rng.choice(unseen[unseen != part], candidates - 1, replace=False)
                    right.append(table.guess(clip, [part, *others], taught, rng) == 0)
                    asked.append(str(part))
    share = clustered(np.array(right), np.array(asked), seed=seed)
    return GameResult(taught, candidates, len(right), len(set(asked)), share)


def _placed(vectors: np.ndarray, seen: np.ndarray, whitening: int | None) -> np.ndarray:
    if whitening is None:
        return unit(vectors)
    space: Space = fit_space(vectors[seen], whitening)
    return space.place(vectors)


class _Table:
    """What lies on the table in one fold."""

    def __init__(
        self, placed: np.ndarray, parts: np.ndarray, seen: np.ndarray, labels: np.ndarray | None
    ) -> None:
        self._placed, self._parts, self._labels = placed, parts, labels
        known = seen if labels is None else seen & ~np.isnan(labels).any(axis=1)
        self._known = np.flatnonzero(known)

    def guess(self, clip: int, candidates: list[str], taught: int, rng: np.random.Generator) -> int:
        """Return which candidate felt like a clip."""
        if not taught:
            return self._guess_by_labels(clip, candidates)
        lessons = []
        for part in candidates:
            clips = np.flatnonzero(self._parts == part)
            lesson = rng.choice(clips[clips != clip], taught, replace=False)
            lessons.append(self._placed[lesson].mean(axis=0))
        return int(np.argmax(unit(np.stack(lessons)) @ self._placed[clip]))

    def _guess_by_labels(self, clip: int, candidates: list[str]) -> int:
        assert self._labels is not None  # noqa: S101  # asked for above
        similarity = self._placed[self._known] @ self._placed[clip]
        nearest = self._known[np.argsort(-similarity, kind="stable")[:_NEIGHBOURS]]
        felt = self._labels[nearest].mean(axis=0)
        rated = np.stack([self._labels[self._parts == part].mean(axis=0) for part in candidates])
        return int(np.argmin(((rated - felt) ** 2).sum(axis=1)))
