"""Batches come through whole, in order, and stop when asked to."""

import multiprocessing
from collections import namedtuple
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from exumi_data.errors import DamagedDataError
from exumi_loaders import ToFloat, TPPWindows, prefetch_to_device

Pair = namedtuple("Pair", ["a", "b"])  # as torch's own collate makes them


class Counted:
    """A loader that says how many batches were asked for."""

    def __init__(self, batches: list[Any]) -> None:
        self.batches = batches
        self.asked = 0

    def __len__(self) -> int:
        return len(self.batches)

    def __iter__(self) -> Any:
        for batch in self.batches:
            self.asked += 1
            yield batch


def nested(number: int) -> dict[str, Any]:
    values = torch.full((2, 3), float(number))
    return {
        "x": values,
        "inner": {"y": values + 1, "names": ["a", "b"]},
        "list": [values + 2, (values + 3, None)],
        "pair": Pair(values + 4, number),
    }


def test_on_the_cpu_batches_pass_through() -> None:
    batches = [nested(number) for number in range(3)]
    loader = prefetch_to_device(Counted(batches), "cpu")
    assert len(loader) == 3
    for _ in range(2):  # as often as the loader
        found = list(loader)
        for batch, expected in zip(found, batches, strict=True):
            assert batch["x"] is expected["x"]
            assert batch["inner"]["y"] is expected["inner"]["y"]
            assert batch["inner"]["names"] == ["a", "b"]
            assert batch["list"][1][0] is expected["list"][1][0]
            assert batch["pair"].a is expected["pair"].a
            assert isinstance(batch["pair"], Pair)


def test_the_transform_is_applied() -> None:
    images = torch.full((2, 1, 1, 4, 4), 255, dtype=torch.uint8)
    done = list(prefetch_to_device([{"x": images}], "cpu", transform=nn.Sequential(ToFloat())))
    assert (done[0]["x"] == 1).all()


def test_an_iterable_without_a_length() -> None:
    loader = prefetch_to_device(iter([1]), "cpu")
    with pytest.raises(TypeError):
        len(loader)
    assert list(loader) == [1]


def windows_of(make_dataset: Any, recipe: Any) -> TPPWindows:
    dataset = make_dataset(recipe(tactile_s=np.arange(0, 6, 1 / 30), encoded=True, channels=3))
    return TPPWindows(dataset, cache=False)


def test_workers_go_when_an_epoch_is_left_in_the_middle(make_dataset: Any, recipe: Any) -> None:
    windows = windows_of(make_dataset, recipe)
    batches = iter(prefetch_to_device(windows.loader(4, num_workers=1), "cpu"))
    next(batches)
    assert multiprocessing.active_children()
    batches.close()  # type: ignore[attr-defined]  # a generator
    assert not multiprocessing.active_children()


def test_errors_of_the_loader_come_through() -> None:
    def broken() -> Any:
        yield {"x": torch.ones(1)}
        raise DamagedDataError("frame 3 is damaged")

    found: list[Any] = []
    with pytest.raises(DamagedDataError, match="frame 3"):
        found.extend(prefetch_to_device(broken(), "cpu"))


def test_other_devices_get_copies() -> None:
    done = list(prefetch_to_device([nested(1)], "meta"))
    assert done[0]["inner"]["y"].device.type == "meta"
    assert done[0]["inner"]["names"] == ["a", "b"]


needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")


@needs_cuda
def test_on_cuda_every_batch_arrives_unchanged() -> None:
    generator = torch.Generator().manual_seed(0)
    batches = [
        {"x": torch.randint(0, 256, (64, 8, 1, 224, 224), generator=generator, dtype=torch.uint8)}
        for _ in range(12)
    ]
    sums = [int(batch["x"].sum(dtype=torch.int64)) for batch in batches]
    loader = prefetch_to_device(Counted(batches), "cuda", transform=nn.Sequential(ToFloat()))
    weights = torch.rand(2048, 2048, device="cuda")
    found = []
    for batch in loader:
        assert batch["x"].is_cuda
        for _ in range(20):  # the device is busy while the next batch is copied
            weights = torch.tanh(weights @ weights)
        found.append((batch["x"].double().sum() * 255).round())
        del batch
    assert [int(value) for value in found] == pytest.approx(sums, rel=1e-6)


@needs_cuda
def test_on_cuda_one_batch_is_ahead_and_an_epoch_can_be_left() -> None:
    loader = Counted([nested(number) for number in range(10)])
    batches = iter(prefetch_to_device(loader, "cuda"))
    first = next(batches)
    assert loader.asked == 2
    assert first["inner"]["y"].is_cuda
    batches.close()  # type: ignore[attr-defined]  # a generator
    assert loader.asked == 2
    torch.cuda.synchronize()
