"""Ratings of what was touched, and those that are missing."""

from typing import Any

import numpy as np
import pytest

from exumi_data.errors import UsageError
from exumi_data.model import Label
from exumi_loaders import PropertyWindows


@pytest.fixture
def some(make_touches: Any, touch: Any, rated: Any) -> Any:
    def model(value: float) -> Label:
        return Label(property="hardness", value=value, scale=[0.0, 10.0], provenance="model")

    return make_touches(
        touch("a", labels=rated(hardness=8.67, roughness=1.33), stored=2),
        touch("b", labels=rated(roughness=4), stored=2),
        touch("c", labels=[model(6.0)], stored=2),
        touch("d", labels=rated(bumpiness=2.0, hardness=0.0), stored=2),
    )


def test_missing_ratings_are_masked_and_not_made_up(some: Any) -> None:
    windows = PropertyWindows(some, frames=2)
    assert (len(windows), windows.left_out) == (3, 1)
    (batch,) = windows.loader(8, shuffle=False)
    assert batch["frames"].shape == (3, 2, 1, 8, 8)
    np.testing.assert_array_equal(
        batch["rating"], np.array([[8.67, 1.33], [0, 4], [0, 0]], np.float32)
    )
    assert batch["rating_valid"].tolist() == [[True, True], [False, True], [True, False]]
    assert batch["episode"].tolist() == [0, 1, 3]
    assert "2 of hardness, 2 of roughness" in repr(windows)


def test_unlabelled_clips_and_models_ratings_are_taken_if_asked_for(some: Any) -> None:
    every = PropertyWindows(some, frames=2, keep_unlabelled=True)
    assert every.rating_valid.tolist()[2] == [False, False]
    either = PropertyWindows(some, frames=2, provenance="any")
    assert either.rating[2].tolist() == [6.0, 0.0]


def test_other_properties_and_unknown_ones(some: Any) -> None:
    assert PropertyWindows(some, frames=2, properties=["bumpiness"]).rating.tolist() == [[2.0]]
    with pytest.raises(UsageError, match=r"'stickiness'.*there are: bumpiness, hardness, rou"):
        PropertyWindows(some, properties=["stickiness"])
    with pytest.raises(UsageError, match="no property"):
        PropertyWindows(some, properties=[])


def test_items_and_splits(some: Any) -> None:
    windows = PropertyWindows(some, frames=2, grey_tactile=True)
    item = windows[-1]
    assert item["rating"].tolist() == [0.0, 0.0]
    assert item["rating_valid"].tolist() == [True, False]
    rated_parts = some.select(part_id=["a", "d"])
    sides = [
        PropertyWindows(rated_parts, split=name, split_ratio=(1, 1), properties=["hardness"])
        for name in ("train", "val")
    ]
    parts = [{clip.part_id for clip in side.clips.table} for side in sides]
    assert [len(side) for side in sides] == [1, 1]
    assert not parts[0] & parts[1]
