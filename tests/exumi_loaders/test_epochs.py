"""Epochs that are left early, and ranks that share one out: the same for all samplers."""

import multiprocessing
import queue
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch.distributed
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader, Dataset

from exumi_data.errors import UsageError
from exumi_loaders import ActiveWindowSampler, WindowIndex, WindowSampler

COUNT = 24


class Windows(Dataset[tuple[int, int]]):
    """As many windows as wanted, every third active; an item is its epoch and its number."""

    def __init__(self, count: int = COUNT) -> None:
        self.count = count

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: WindowIndex) -> tuple[int, int]:
        return index.epoch, index.window

    @property
    def active(self) -> np.ndarray:
        return np.asarray(np.arange(self.count) % 3 == 0)


Make = Callable[..., Any]


def load(sampler: Any, workers: int) -> DataLoader[Any]:
    return DataLoader(
        Windows(), batch_size=4, sampler=sampler, num_workers=workers, collate_fn=list
    )


def first_batches(loader: DataLoader[Any], batches: int) -> list[WindowIndex]:
    """Take some batches and leave."""
    taken = []
    for number, batch in enumerate(loader, start=1):
        taken += [WindowIndex(*item) for item in batch]
        if number == batches:
            break
    return taken


# Two workers prefetch four batches: of the six of an epoch they see the end from the third on.
@pytest.mark.parametrize("make", [WindowSampler, ActiveWindowSampler])
@pytest.mark.parametrize("batches", [1, 4, 6])
@pytest.mark.parametrize("workers", [0, 2])
def test_an_epoch_that_is_left_early_is_over(make: Make, batches: int, workers: int) -> None:
    whole = [*(sampler := make(Windows(), seed=4)), *sampler, *sampler]
    assert len(whole) == 3 * COUNT
    sampler = make(Windows(), seed=4)
    loader = load(sampler, workers)
    for epoch in range(3):
        assert sampler.epoch == epoch
        begin = epoch * COUNT
        assert first_batches(loader, batches) == whole[begin : begin + 4 * batches]
    assert sampler.epoch == 3


@pytest.mark.parametrize("make", [WindowSampler, ActiveWindowSampler])
@pytest.mark.parametrize("workers", [0, 2])
def test_what_was_left_can_be_resumed_or_be_left_for_good(make: Make, workers: int) -> None:
    whole = [*(sampler := make(Windows(), seed=4)), *sampler]
    left = make(Windows(), seed=4)
    assert first_batches(load(left, workers), 4) == whole[:16]
    resumed = make(Windows(), seed=4)
    resumed.load_state_dict(left.state_dict(16))
    assert [*resumed, *resumed] == whole[16:]
    left.set_epoch(1)  # as trainers do before an epoch
    resumed = make(Windows(), seed=4)
    resumed.load_state_dict(left.state_dict(0))
    assert list(resumed) == whole[COUNT:]


def test_between_two_epochs_nothing_is_used_of_the_next() -> None:
    sampler = WindowSampler(Windows())
    assert len(list(sampler)) == COUNT
    assert sampler.state_dict(0)["epoch"] == sampler.state_dict(COUNT)["epoch"] == 1


@given(st.integers(1, 5), st.integers(0, 40), st.booleans(), st.integers(0, 2))
def test_ranks_share_an_epoch_out(world: int, count: int, shuffle: bool, epoch: int) -> None:
    options: dict[str, Any] = {"shuffle": shuffle, "seed": 1, "reject_inactive": 0.5}
    whole = WindowSampler(Windows(count), **options).order(epoch)
    ranks = [
        WindowSampler(Windows(count), rank=rank, world_size=world, **options)
        for rank in range(world)
    ]
    orders = [rank.order(epoch) for rank in ranks]
    assert {len(order) for order in orders} == {-(-len(whole) // world)}
    in_turn = np.stack(orders, axis=1).ravel()
    np.testing.assert_array_equal(in_turn[: len(whole)], whole)
    np.testing.assert_array_equal(
        in_turn[len(whole) :], np.resize(whole, len(in_turn))[len(whole) :]
    )


def test_training_goes_on_with_other_ranks() -> None:
    whole = list(WindowSampler(Windows()))
    state = WindowSampler(Windows(), rank=1, world_size=3).state_dict(4)
    for rank in range(2):
        resumed = WindowSampler(Windows(), rank=rank, world_size=2)
        resumed.load_state_dict(state)
        assert list(resumed) == whole[12 + rank :: 2]
    with pytest.raises(UsageError, match="12 were consumed, which is no multiple of 5 ranks"):
        WindowSampler(Windows(), world_size=5).load_state_dict(state)


@pytest.mark.parametrize("make", [WindowSampler, ActiveWindowSampler])
def test_a_rank_that_is_none_is_refused(make: Make) -> None:
    with pytest.raises(UsageError, match="rank is 2, not one of 2"):
        make(Windows(), rank=2, world_size=2)
    with pytest.raises(UsageError, match="rank is 1, not one of 1"):
        make(Windows(), rank=1)


def _train(rank: int, meeting: Path, results: Any) -> None:
    """Be one of two ranks of a process group."""
    torch.distributed.init_process_group(
        "gloo", init_method=f"file://{meeting}", rank=rank, world_size=2
    )
    try:
        list(WindowSampler(Windows()))
        said = ""
    except UsageError as error:
        said = str(error)
    mine = [index.window for index in WindowSampler(Windows(), rank=rank, world_size=2)]
    # Another library that shares out what a sampler yields says so.
    everything = [index.window for index in WindowSampler(Windows(), world_size=1)]
    results.put((said, mine, len(everything)))
    torch.distributed.destroy_process_group()


def _of_two_ranks(meeting: Path) -> list[Any]:
    """Return what two ranks found; nothing where Gloo could not connect them, as happens."""
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    ranks = [context.Process(target=_train, args=(rank, meeting, results)) for rank in range(2)]
    for process in ranks:
        process.start()
    try:
        return [results.get(timeout=30) for _ in ranks]
    except queue.Empty:
        return []
    finally:
        for process in ranks:
            process.join(10)
            process.kill()
            process.join()


def test_in_a_process_group_a_sampler_without_ranks_is_refused(tmp_path: Path) -> None:
    found = _of_two_ranks(tmp_path / "one") or _of_two_ranks(tmp_path / "other")
    assert len(found) == 2
    for said, _, everything in found:
        assert "one of 2 ranks" in said
        assert "world_size=torch.distributed.get_world_size()" in said
        assert everything == COUNT
    assert sorted(found[0][1] + found[1][1]) == list(range(COUNT))
