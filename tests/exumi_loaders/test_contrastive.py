"""Contrastive batches: who is whose positive and negative."""

from typing import Any

import pytest
import torch

from exumi_data.errors import UsageError
from exumi_loaders import BatchOrder, ContrastiveBatches
from exumi_loaders.contrastive import BatchIndex


@pytest.fixture
def mixed(make_touches: Any, touch: Any) -> Any:
    """Five plain parts, three dotted ones, two of another sensor, and what cannot be used."""
    made = [touch(f"plain_{i}", stored=3, brightness=(i, 9, 50 + i)) for i in range(5)] * 4
    made += [touch(f"dotted_{i}", pad="dotted", stored=3) for i in range(3)] * 2
    made += [touch("plain_0", sensor="digit", pad=None, stored=3)] * 2
    made += [touch("lonely"), touch(None), touch("lid", sensor=None)]
    return make_touches(*made)


def test_batches_hold_one_kind_of_sensor_and_each_part_once(mixed: Any) -> None:
    batches = ContrastiveBatches(mixed, parts=4, frames=3)
    assert len(batches) == 4  # ten pairs of plain parts, four in a batch; one of dotted ones
    for epoch in range(5):
        batches.set_epoch(epoch)
        for number in range(len(batches)):
            batch = batches[number]
            clips = batches.labels(batch)
            group = batches.groups[int(batch["group"])]
            assert {c.kind for pair in clips for c in pair} == {group[:2]}
            names = [batches.parts[index] for index in batch["part"].tolist()]
            assert [(one.part_id, other.part_id) for one, other in clips] == [
                (name, name) for name in names
            ]
            assert len(set(names)) == len(names) <= 4
            assert all(one.id != other.id for one, other in clips)
            assert batch["episode"].tolist() == [[a.episode, b.episode] for a, b in clips]


def test_what_is_left_out_is_counted_and_small_groups_are_said(mixed: Any) -> None:
    batches = ContrastiveBatches(mixed, parts=4, frames=3)
    assert batches.left_out == {
        "without a part id": 1,
        "without a sensor model": 1,
        "of a part with one clip": 1,
        "of a group with too few parts": 2,
    }
    said = batches.describe()
    assert "digit, pad type not known: 1 part(s), too few for a batch" in said
    assert "gelsight-mini, plain: 5 part(s), 3 batch(es)" in said


def test_frames_are_those_of_the_clips(mixed: Any) -> None:
    batch = ContrastiveBatches(mixed, parts=4, frames=3)
    for number in range(len(batch)):
        item = batch[number]
        assert item["frames"].shape[1:] == (2, 3, 1, 8, 8)
        assert item["frames"].dtype == torch.uint8
        assert item["frames_valid"].all()
        assert (item["reference"] == 7).all()
        for row, pair in enumerate(batch.labels(item)):
            for column, clip in enumerate(pair):
                if clip.pad_type == "plain":
                    assert clip.part_id is not None
                    which = int(clip.part_id[-1])
                    shown = item["frames"][row, column, :, 0, 0, 0].tolist()
                    assert shown == [which, 9, 50 + which]


def test_two_streams_of_an_episode_are_no_positives(make_touches: Any, touch: Any) -> None:
    both = ("tactile_left", "tactile_right")
    dataset = make_touches(*[touch(name, streams=both, stored=2) for name in "abab"], touch("c"))
    batches = ContrastiveBatches(dataset, frames=2)
    streams = set()
    for epoch in range(8):
        ((_, pairs),) = batches.plan(epoch)
        for row in pairs.tolist():
            one, other = (batches.clips.table[index] for index in row)
            assert one.id != other.id
            streams |= {one.stream, other.stream}
    assert streams == set(both)
    alone = make_touches(touch("a", streams=both), touch("b", streams=both), name="alone")
    with pytest.raises(UsageError, match=r"4 clip\(s\) of a part with one clip"):
        ContrastiveBatches(alone)


def test_an_epoch_is_a_function_of_its_seed_with_any_workers(mixed: Any) -> None:
    def clips(num_workers: int, seed: int = 3) -> list[Any]:
        batches = ContrastiveBatches(mixed, parts=4, frames=3, seed=seed)
        return [batch["clip"].tolist() for batch in batches.loader(num_workers=num_workers)]

    assert clips(0) == clips(2)
    assert clips(0) != clips(0, seed=4)


def test_ranks_share_the_batches_and_go_on_where_they_stopped(mixed: Any) -> None:
    batches = ContrastiveBatches(mixed, parts=2, frames=3)
    for world in (1, 2, 3):
        ranks = [list(BatchOrder(batches, rank=r, world_size=world)) for r in range(world)]
        assert {len(rank) for rank in ranks} == {len(batches) // world}
        taken = [index for rank in ranks for index in rank]
        assert len(set(taken)) == len(taken) == world * (len(batches) // world)
    whole = [*(order := BatchOrder(batches, rank=1, world_size=2)), *order]
    resumed = BatchOrder(batches, rank=1, world_size=2)
    resumed.load_state_dict(BatchOrder(batches, rank=1, world_size=2).state_dict(2))
    assert [*resumed, *resumed] == whole[2:]
    state = BatchOrder(batches).state_dict(0)
    with pytest.raises(UsageError, match="batches 99"):
        BatchOrder(batches).load_state_dict({**state, "batches": 99})
    with pytest.raises(UsageError, match="world_size 1"):
        resumed.load_state_dict(state)
    other = ContrastiveBatches(mixed, parts=2, frames=3, seed=1)
    with pytest.raises(UsageError, match="seed 0"):
        BatchOrder(other).load_state_dict(state)
    last = BatchIndex(1, 0)
    assert batches[last]["clip"].tolist() == batches.plan(1)[0][1].tolist()


def test_parts_of_val_are_in_no_batch_of_train(mixed: Any) -> None:
    plain = mixed.select(pad_type="plain").select(
        part_id=["plain_0", "plain_1", "plain_2", "plain_3", "plain_4"], stream="tactile"
    )
    train, val = (
        ContrastiveBatches(plain, split=name, split_ratio=(1, 1), frames=3)
        for name in ("train", "val")
    )
    assert not set(train.parts) & set(val.parts)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"parts": 1}, "min_parts"),
        ({"min_parts": 1}, "min_parts"),
        ({"min_parts": 9}, "no batch of 9 parts"),
    ],
)
def test_wrong_options_are_refused(mixed: Any, options: Any, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        ContrastiveBatches(mixed, **options)


def test_wrong_ranks_are_refused(mixed: Any) -> None:
    batches = ContrastiveBatches(mixed, frames=3)
    for options in ({"rank": 2, "world_size": 2}, {"world_size": 99}):
        with pytest.raises(UsageError, match="rank"):
            BatchOrder(batches, **options)
    with pytest.raises(IndexError, match="batch 99"):
        batches[99]


def test_sizes_may_differ_between_groups_only(make_touches: Any, touch: Any) -> None:
    def pairs(name: str, **options: Any) -> list[Any]:
        return [touch(f"{name}_{i}", stored=2, **options) for i in range(2)] * 2

    apart = make_touches(*pairs("small"), *pairs("large", side=16, pad="dotted"))
    batches = ContrastiveBatches(apart, frames=2)
    assert {batches[i]["frames"].shape[-1] for i in range(len(batches))} == {8, 16}
    together = make_touches(*pairs("small"), *pairs("large", side=16), name="together")
    with pytest.raises(UsageError, match=r"\(16, 16, 1\).*exumi prepare"):
        ContrastiveBatches(together, frames=2)
    colour = make_touches(*pairs("grey"), *pairs("colour", channels=3), name="colour")
    grey = ContrastiveBatches(colour, frames=2, grey_tactile=True)
    assert grey[0]["frames"].shape[-3] == grey[0]["reference"].shape[-3] == 1
