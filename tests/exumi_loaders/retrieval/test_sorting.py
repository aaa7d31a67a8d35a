"""Tactile sorting: what is felt is sorted, what is not felt is not, and intervals draw parts."""

from typing import Any

import numpy as np
import pytest

from exumi_data.errors import UsageError
from exumi_loaders import Entry, Match, felt_rating, tactile_sorting

PARTS, CLIPS = 24, 4


def _clips(noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vectors that turn with the rating of their part, parts, and ratings."""
    random = np.random.default_rng(3)
    rating = np.repeat(random.permutation(np.linspace(0, 10, PARTS)), CLIPS)
    angle = rating / 10 * np.pi
    vectors = np.stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)), axis=1)
    vectors += noise * random.normal(size=vectors.shape)
    return vectors.astype(np.float32), np.repeat([f"p{n}" for n in range(PARTS)], CLIPS), rating


@pytest.mark.parametrize("method", ["neighbours", "ridge"])
@pytest.mark.parametrize("tested", ["seen", "unseen"])
def test_what_is_felt_is_sorted(method: Any, tested: Any) -> None:
    vectors, parts, rating = _clips(0.01)
    result = tactile_sorting(vectors, parts, rating, whitening=None, method=method, tested=tested)
    assert result.parts == PARTS
    assert result.right.value > 0.97
    assert (result.method, result.tested, result.margin) == (method, tested, 2.0)
    assert result.as_dict()["right"]["value"] == result.right.value
    again = tactile_sorting(vectors, parts, rating, whitening=None, method=method, tested=tested)
    assert again == result


@pytest.mark.parametrize("method", ["neighbours", "ridge"])
def test_what_is_not_felt_is_not_sorted(method: Any) -> None:
    _, parts, rating = _clips(0)
    # Each part has a look of its own that says nothing of its rating.
    own = np.random.default_rng(0).normal(size=(PARTS, 30)).astype(np.float32)
    vectors = np.repeat(own, CLIPS, axis=0)
    vectors += 0.01 * np.random.default_rng(1).normal(size=vectors.shape).astype(np.float32)
    unseen = tactile_sorting(vectors, parts, rating, whitening=None, method=method, rounds=20)
    assert unseen.right.low < 0.5 < unseen.right.high
    # A part that was met before is known again, and so is its rating.
    seen = tactile_sorting(vectors, parts, rating, whitening=None, method=method, tested="seen")
    assert seen.right.value > 0.9


def test_all_pairs_of_seen_parts_count_once_if_they_differ_by_more_than_the_margin() -> None:
    vectors, parts, rating = _clips(0.01)
    ratings = rating[::CLIPS]
    for margin in (0.0, 2.0, 9.0):
        result = tactile_sorting(
            vectors, parts, rating, whitening=None, tested="seen", margin=margin, rounds=2
        )
        assert result.pairs == (ratings[:, None] - ratings > margin).sum()
    with pytest.raises(UsageError, match="more than 10"):
        tactile_sorting(vectors, parts, rating, whitening=None, margin=10.0)


def test_equal_ratings_are_a_tie_and_count_half() -> None:
    vectors, parts, rating = _clips(0.01)
    blind = np.ones_like(vectors)
    result = tactile_sorting(blind, parts, rating, whitening=None, neighbours=200)
    assert (result.right.value, result.right.low, result.right.high) == (0.5, 0.5, 0.5)


def test_clips_without_a_rating_are_left_out() -> None:
    vectors, parts, rating = _clips(0.01)
    rated = rating.copy()
    rated[parts == "p3"] = np.nan
    vectors[parts == "p3"] = np.nan  # nothing of it is read
    result = tactile_sorting(vectors, parts, rated, whitening=None, tested="seen")
    assert result.parts == PARTS - 1


def test_the_interval_is_as_wide_as_parts_are_few() -> None:
    vectors, parts, rating = _clips(0.5)
    many = tactile_sorting(vectors, parts, rating, whitening=None, tested="seen")
    few = np.isin(parts, [f"p{n}" for n in range(8)])
    less = tactile_sorting(vectors[few], parts[few], rating[few], whitening=None, tested="seen")
    assert many.right.low < many.right.value < many.right.high
    assert less.right.high - less.right.low > many.right.high - many.right.low


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "guess"}, "'ridge'"),
        ({"tested": "known"}, "'unseen'"),
        ({"folds": 1}, "folds"),
        ({"rounds": 0}, "rounds"),
        ({"penalty": 0.0}, "penalty"),
        ({"penalty": float("nan")}, "penalty"),
        ({"margin": -1.0}, "margin"),
        ({"folds": 13}, "too few for 13 folds"),
    ],
)
def test_options_are_checked(options: Any, said: str) -> None:
    vectors, parts, rating = _clips(0.1)
    with pytest.raises(UsageError, match=said):
        tactile_sorting(vectors, parts, rating, whitening=None, **options)


def test_a_single_clip_of_a_part_is_not_seen() -> None:
    vectors, parts, rating = _clips(0.1)
    with pytest.raises(UsageError, match="single clip"):
        tactile_sorting(vectors[:-3], parts[:-3], rating[:-3], whitening=None, tested="seen")


def test_a_rating_is_felt_from_what_is_alike() -> None:
    def match(similarity: float, **labels: float) -> Match:
        return Match(Entry("id", "name", labels=labels), similarity, 1)

    matches = [match(0.9, hardness=8), match(0.3, hardness=4), match(0.8), match(-0.9, hardness=0)]
    assert felt_rating(matches, "hardness") == pytest.approx((0.9 * 8 + 0.3 * 4) / 1.2, rel=1e-4)
    assert felt_rating(matches, "roughness") is None
    assert felt_rating([], "hardness") is None
    assert felt_rating([match(0.0, hardness=7)], "hardness") == 7
