"""Which clips meet in which batch."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_loaders.pairing import PairRules, batch_count, order, pair_batches, shuffled_batches

SIZES = st.lists(st.integers(2, 9), min_size=1, max_size=12)


def clips_of(sizes: list[int], streams: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of so many episodes, of so many streams each: clip, part and episode."""
    part = np.repeat(np.arange(len(sizes)), np.array(sizes) * streams)
    episode = np.repeat(np.arange(sum(sizes)), streams)
    return 100 + np.arange(len(part)), part, episode


@given(SIZES, st.integers(2, 6), st.integers(0, 5), st.integers(1, 2), st.integers(0, 3))
def test_every_batch_keeps_the_rules(
    sizes: list[int], most: int, epoch: int, streams: int, seed: int
) -> None:
    clips, part, episode = clips_of(sizes, streams)
    rules = PairRules(most, 2)
    batches = pair_batches(seed, epoch, clips, part, episode, rules)
    assert len(batches) == batch_count(np.array(sizes) // 2, rules)
    used = [clip for batch in batches for clip in batch.ravel().tolist()]
    assert len(set(used)) == len(used)
    for batch in batches:
        of = part[batch - 100]
        assert (of[:, 0] == of[:, 1]).all()
        assert len(set(of[:, 0])) == len(of)
        assert (episode[batch - 100][:, 0] != episode[batch - 100][:, 1]).all()
        assert 2 <= len(batch) <= most
    lengths = [len(batch) for batch in batches]
    assert not lengths or max(lengths) - min(lengths) <= 1


@pytest.mark.parametrize(
    ("pairs", "most", "least", "count"),
    [
        ([2] * 66, 32, 2, 5),  # 132 pairs, at most 32 in a batch
        ([1] * 32, 32, 2, 1),
        ([1] * 33, 32, 2, 2),
        ([1], 32, 2, 0),
        ([1, 1, 1], 2, 2, 1),  # two batches would leave one part alone
        ([10, 1], 32, 2, 1),  # the large part alone has no negatives
        ([10] * 3, 2, 2, 15),
        ([10] * 4 + [1] * 4, 32, 8, 1),
        ([10] * 4 + [1] * 4, 32, 4, 6),  # 44 pairs in 6 batches, 28 of them at most 6 a part
    ],
)
def test_how_many_batches(pairs: list[int], most: int, least: int, count: int) -> None:
    assert batch_count(np.array(pairs), PairRules(most, least)) == count


def test_all_pairs_are_used_where_parts_are_alike() -> None:
    clips, part, episode = clips_of([4] * 66)
    batches = pair_batches(0, 0, clips, part, episode, PairRules(32, 2))
    assert sorted(len(batch) for batch in batches) == [26, 26, 26, 27, 27]


def test_clips_meet_others_in_the_next_epoch() -> None:
    clips, part, episode = clips_of([4] * 10)

    def pairs(seed: int, epoch: int) -> list[list[list[int]]]:
        return [
            b.tolist() for b in pair_batches(seed, epoch, clips, part, episode, PairRules(8, 2))
        ]

    assert pairs(1, 0) == pairs(1, 0)
    assert pairs(1, 0) != pairs(1, 1)
    assert pairs(1, 0) != pairs(2, 0)


def test_each_other_clip_is_the_positive_equally_often() -> None:
    clips, part, episode = clips_of([4, 4])
    partner = []
    for epoch in range(600):
        batches = pair_batches(0, epoch, clips, part, episode, PairRules(2, 2))
        pairs = [set(row.tolist()) for batch in batches for row in batch]
        partner += [next(iter(pair - {100})) for pair in pairs if 100 in pair]
    counts = np.bincount(np.array(partner) - 101, minlength=3)
    # Of 600 epochs a third each; the standard deviation is 11.5.
    assert counts.sum() == 600
    assert (abs(counts - 200) < 50).all()


def test_the_order_is_a_permutation_that_depends_on_seed_and_epoch() -> None:
    assert sorted(order(0, 0, 50, purpose=1)) == list(range(50))
    assert order(0, 0, 50, purpose=1).tolist() != order(0, 1, 50, purpose=1).tolist()
    assert sorted(shuffled_batches(0, 0, list("abcdef"))) == list("abcdef")
