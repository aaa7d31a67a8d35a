"""Memory comes back when a batch is dropped, and never before."""

import pickle

import numpy as np

from exumi_loaders.buffers import BatchBuffers


def test_memory_is_used_again_once_dropped() -> None:
    buffers = BatchBuffers()
    first, filled = buffers.take((2, 3))
    filled[:] = 7
    address = first.data_ptr()
    second, _ = buffers.take((2, 3))
    assert second.data_ptr() != address
    assert (first == 7).all()
    del first
    third, _ = buffers.take((3, 2))
    assert third.data_ptr() == address


def test_views_and_arrays_keep_it() -> None:
    buffers = BatchBuffers()
    tensor, filled = buffers.take((4, 5))
    filled[:] = 3
    view = tensor.movedim(0, 1)[2:].numpy()
    row = tensor[1]
    del tensor
    others = [buffers.take((4, 5)) for _ in range(6)]
    for _, array in others:
        array[:] = 9
    assert (view == 3).all()
    assert (row == 3).all()


def test_many_dropped_batches_do_not_pile_up() -> None:
    buffers = BatchBuffers()
    held = [buffers.take((8,)) for _ in range(20)]
    held.clear()
    assert sum(len(free) for free in buffers._free.values()) <= 4  # what is kept


def test_a_copy_for_another_process_is_empty() -> None:
    buffers = BatchBuffers()
    buffers.take((8,))
    copied = pickle.loads(pickle.dumps(buffers))  # noqa: S301  # as a DataLoader worker gets it
    tensor, array = copied.take((8,))
    array[:] = np.arange(8)
    assert tensor.tolist() == list(range(8))
