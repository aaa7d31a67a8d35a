"""Frames for self-supervised learning: one copy, two views."""

from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Subset

from exumi_data.errors import UsageError
from exumi_loaders import TwoViews, WindowSampler


@pytest.fixture
def three(make_touches: Any, touch: Any) -> Any:
    return make_touches(
        touch(brightness=(10, 11, 12), stored=3),
        touch(brightness=(20, 21, 22), stored=3),
        touch(brightness=(30, 31), stored=3),
    )


def test_items_are_the_salient_frames_of_all_clips(three: Any) -> None:
    views = TwoViews(three, frames=3)
    assert len(views) == 9
    batch = next(iter(views.loader(9, shuffle=False)))
    assert batch["frames"].shape == (9, 1, 8, 8)
    assert batch["frames"][:, 0, 0, 0].tolist() == [10, 11, 12, 20, 21, 22, 30, 31, 31]
    assert batch["valid"].tolist() == [True] * 8 + [False]
    assert batch["clip"].tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert (batch["reference"] == 7).all()
    assert int(views[-1]["frames"][0, 0, 0]) == 31
    with pytest.raises(IndexError):
        views[9]


def test_both_views_are_of_the_same_frames_and_drawn_anew(three: Any) -> None:
    views = TwoViews(three, frames=3)
    seen: list[Tensor] = []
    draws = iter(range(100))

    def augment(frames: Tensor) -> Tensor:
        seen.append(frames)
        return frames.float() + next(draws)

    for number, (one, other, batch) in enumerate(views.pairs(views.loader(4), augment)):
        assert seen[-1] is seen[-2] is batch["frames"]
        torch.testing.assert_close(one, batch["frames"].float() + 2 * number)
        torch.testing.assert_close(other, one + 1)
    views_of = views.pairs(views.loader(4), augment, torch.zeros_like, device="cpu")
    assert not next(iter(views_of))[1].any()


def test_the_order_is_that_of_the_seed_and_resumable(three: Any) -> None:
    def order(**options: Any) -> list[int]:
        views = TwoViews(three, frames=3, seed=5)
        loader = views.loader(2, **options)
        return [int(v) for batch in loader for v in batch["frames"][:, 0, 0, 0]]

    whole = order()
    assert order(num_workers=2) == whole
    assert sorted(whole) == [10, 11, 12, 20, 21, 22, 30, 31, 31]
    views = TwoViews(three, frames=3, seed=5)
    sampler = WindowSampler(views, seed=5)  # type: ignore[arg-type]  # it needs no activity
    sampler.load_state_dict(sampler.state_dict(4))
    assert order(sampler=sampler) == whole[4:]


def test_frames_of_two_sizes_are_refused(make_touches: Any, touch: Any) -> None:
    with pytest.raises(UsageError, match="exumi prepare"):
        TwoViews(make_touches(touch(), touch(side=16)))


def test_a_batch_that_is_filled_is_not_collated(three: Any) -> None:
    """What a DataLoader of one's own does, unless it is told."""
    views = TwoViews(three, frames=3)
    part = Subset(views, [0, 4])
    with pytest.raises(UsageError, match="collate_fn"):
        next(iter(DataLoader(part, batch_size=2)))
    batch = next(iter(DataLoader(part, batch_size=2, collate_fn=lambda batch: batch)))
    assert batch["clip"].tolist() == [0, 1]
    with pytest.raises(KeyError, match="tactile"):
        batch["tactile"]
