"""A worker writes to memory again only when nobody, in any process, can see it any more."""

import copy
import gc
import os
import pickle
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from exumi_loaders import TPPWindows
from exumi_loaders.filled import FilledBatch
from exumi_loaders.shared_memory import SharedBlock, SharedBlocks, received


def lent(block: SharedBlock, value: int = 5) -> Tensor:
    memory = block.lend()
    memory[:12] = value
    return torch.from_numpy(memory[:12].reshape(3, 4))


def arrived(block: SharedBlock, tensor: Tensor) -> Tensor:
    """What the receiver makes of a tensor, in this process."""
    place = block.place(tensor)
    assert place is not None
    return received(block.send(), {"x": place})["x"]


def test_a_block_is_free_when_the_worker_and_the_receiver_have_dropped_it() -> None:
    block = SharedBlock(16)
    assert block.free
    sent = lent(block)
    row = sent[1]
    there = arrived(block, sent)
    assert torch.equal(there, torch.full((3, 4), 5, dtype=torch.uint8))
    view = there.T[2:].numpy()
    del sent, there
    states = [block.free]
    del view
    states.append(block.free)  # the worker itself still has a row
    del row
    states.append(block.free)
    kept = lent(block, 6)
    states.append(block.free)
    assert kept[0, 0] == 6
    del kept
    states.append(block.free)  # it was not sent
    assert states == [False, False, True, False, True]
    assert not block.gone


def test_what_is_sent_twice_is_not_used_again() -> None:
    block = SharedBlock(16)
    sent = lent(block)
    first, second = arrived(block, sent), arrived(block, sent)
    del sent, first
    assert not block.free
    assert block.gone
    assert (second == 5).all()


def test_what_a_forked_process_may_see_is_not_used_again() -> None:
    block = SharedBlock(16)
    sent = lent(block)
    there = arrived(block, sent)
    process = get_context("fork").Process(target=os.getpid)
    process.start()
    process.join()
    del sent, there
    assert not block.free
    assert block.gone
    other = SharedBlock(16)
    sent = lent(other)
    there = arrived(other, sent)
    del sent, there
    assert other.free


def test_places_are_of_the_blocks_own_bytes() -> None:
    block, other = SharedBlock(16), SharedBlock(16)
    tensor = lent(block)
    turned = tensor.T[1:, ::2]
    assert torch.equal(arrived(block, turned), turned)
    for stranger in (lent(other), tensor.clone(), tensor[:0], tensor.view(torch.int8), 5, None):
        assert block.place(stranger) is None


def test_there_are_no_more_blocks_than_are_in_use() -> None:
    blocks = SharedBlocks()
    held = [lent(blocks.take(16)) for _ in range(3)]
    assert len(blocks._blocks) == 3
    held.clear()
    assert blocks.take(12) in blocks._blocks
    assert len(blocks._blocks) == 3
    larger = blocks.take(32)
    assert blocks._blocks == [larger]
    tensor = lent(larger)
    arrived(larger, tensor)
    arrived(larger, tensor)  # twice
    del tensor
    other = blocks.take(16)
    assert blocks._blocks == [other]
    many = [lent(blocks.take(16)) for _ in range(40)]
    assert len(blocks._blocks) < len(many)


def test_messages_hold_one_handle_and_copies_none() -> None:
    block = SharedBlock(16)
    image = lent(block)
    values = {
        "before": "text",
        "image": image,
        "number": torch.arange(6).reshape(2, 3)[:, 1:],
        "half": torch.ones(2, dtype=torch.bfloat16),
        "weight": torch.ones(2, requires_grad=True),
        "array": np.arange(3),
        "other": torch.zeros(2, 2, dtype=torch.uint8),
    }
    batch = FilledBatch(values, block)
    message: Any = ForkingPickler._extra_reducers[FilledBatch](batch)  # type: ignore[attr-defined]  # the table is not public
    names, memory, places, arrays, others = message[1]
    assert names == tuple(values)
    assert memory is block._memory
    assert set(places) == {"image"}
    assert set(arrays) == {"number", "other"}
    assert set(others) == {"before", "half", "weight", "array"}
    copied = copy.copy(batch)
    assert copied.block is block
    stored = pickle.loads(pickle.dumps(batch))  # noqa: S301  # written here
    for one in (copied, stored, copy.deepcopy(batch)):
        assert type(one) is FilledBatch
        assert list(one) == list(values)
        assert torch.equal(one["image"], image)
    assert stored.block is None


# ------------------------------------------------------------------------------- through a loader


@pytest.fixture
def windows(make_dataset: Callable[..., Any], recipe: Any) -> TPPWindows:
    seconds = np.arange(120) / 30
    dataset = make_dataset(
        recipe(tactile_s=seconds, rgb_s=seconds, pose_s=seconds, encoded=True, channels=3)
    )
    return TPPWindows(dataset, cache=False, random_history=False)


def same(one: dict[str, Tensor], other: dict[str, Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[k], other[k]) for k in one)


def test_batches_that_are_held_stay_as_they_are(windows: TPPWindows) -> None:
    options: dict[str, Any] = {"shuffle": False, "drop_last": True}
    expected = list(windows.loader(4, **options))
    loader = windows.loader(4, num_workers=2, persistent_workers=True, **options)
    held, views = [], []
    for _ in range(3):
        for number, batch in enumerate(loader):
            assert list(batch) == list(expected[number])
            assert same(batch, expected[number])
            assert batch["tactile"].stride() == expected[number]["tactile"].stride()
            if number % 5 == 0:
                held.append((number, batch))
            if number % 7 == 0:
                views.append((number, batch["rgb"].numpy()[1:]))
    del batch
    gc.collect()
    for number, batch in held:
        assert same(batch, expected[number])
    for number, view in views:
        np.testing.assert_array_equal(view, expected[number]["rgb"][1:])


def shared_files(process: int) -> int:
    maps = Path(f"/proc/{process}/maps").read_text(encoding="utf-8").splitlines()
    return len({line.split()[5] for line in maps if "/torch_" in line})


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs Linux")
def test_memory_is_used_again(windows: TPPWindows) -> None:
    loader = windows.loader(4, num_workers=1, persistent_workers=True)
    worker: Any = iter(loader)
    process = worker._workers[0].pid
    used = [shared_files(process) for _ in range(2) for _ in loader]
    assert len(used) > 30
    assert 0 < max(used) <= 6  # two on their way, one being filled, two here


def changed(batch: Any) -> FilledBatch:
    batch["tactile"] = batch["tactile"][1:, :, :, ::2]
    batch["rgb"] = batch["rgb"].float()
    batch["name"] = "mine"
    assert isinstance(batch, FilledBatch)
    return batch


def plain(batch: Any) -> dict[str, Tensor]:
    return dict(batch)


def test_what_a_collate_function_changes_arrives(windows: TPPWindows) -> None:
    sampler = list(range(40))
    expected = list(windows.loader(4, sampler=sampler))  # type: ignore[arg-type]  # as PyTorch has it
    options: dict[str, Any] = {"batch_size": 4, "sampler": sampler, "num_workers": 1}
    held = list(DataLoader(windows, collate_fn=changed, **options))
    for batch, right in zip(held, expected, strict=True):
        assert torch.equal(batch["tactile"], right["tactile"][1:, :, :, ::2])
        assert torch.equal(batch["rgb"], right["rgb"].float())
        assert batch["name"] == "mine"
    held = list(DataLoader(windows, collate_fn=plain, **options))
    assert all(same(*pair) for pair in zip(held, expected, strict=True))


def test_single_items_arrive(windows: TPPWindows) -> None:
    loader = DataLoader(windows, batch_size=None, sampler=range(12), num_workers=1)
    held = list(loader)
    assert all(same(item, windows[index]) for index, item in enumerate(held))


def test_processes_that_are_not_forked(windows: TPPWindows) -> None:
    options: dict[str, Any] = {"num_workers": 1, "multiprocessing_context": "spawn"}
    held = list(windows.loader(40, shuffle=False, **options))
    expected = list(windows.loader(40, shuffle=False))
    assert all(same(*pair) for pair in zip(held, expected, strict=True))
