"""Floats are the bytes divided by 255, in the memory order that was asked for."""

import gc

import numpy as np
import pytest
import torch

from exumi_data.errors import UsageError
from exumi_loaders import ToFloat
from exumi_loaders.device import to_float


def frames(channels: int, windows: int = 2) -> torch.Tensor:
    """(B, K, C, H, W) as decoders write it: channels last in memory; all 256 values occur."""
    values = np.arange(windows * 4 * 16 * 8 * channels) * 7 % 256
    return torch.from_numpy(values.astype(np.uint8).reshape(windows, 4, 16, 8, channels)).movedim(
        -1, -3
    )


@pytest.mark.parametrize("memory", ["kept", "contiguous"])
@pytest.mark.parametrize("channels", [1, 3])
def test_equals_the_division(channels: int, memory: str) -> None:
    images = frames(channels)
    done = ToFloat(memory=memory)({"x": images, "x_reference": images[:, 0]})  # type: ignore[arg-type]  # one of the two words
    expected = images.numpy().astype(np.float32) / np.float32(255)
    for found, right in ((done["x"], expected), (done["x_reference"], expected[:, 0])):
        assert found.dtype == torch.float32
        np.testing.assert_array_equal(found.numpy(), right)
        last = found.movedim(-3, -1)
        assert (found if memory == "contiguous" else last).is_contiguous()


@pytest.mark.parametrize("memory", ["kept", "contiguous"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("windows", [0, 1, 5])
def test_a_batch_is_converted_piece_by_piece(
    windows: int, channels: int, memory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = frames(channels, windows)
    monkeypatch.setattr(to_float, "_AT_ONCE", 2 * images[:1].numel())  # pieces of two windows
    found = ToFloat(memory=memory).convert(images)  # type: ignore[arg-type]  # one of the two words
    np.testing.assert_array_equal(
        found.numpy(), images.numpy().astype(np.float32) / np.float32(255)
    )


def test_a_single_image_is_fine() -> None:
    image = frames(3)[0, 0]
    for memory in ("kept", "contiguous"):
        found = ToFloat(memory=memory).convert(image)
        np.testing.assert_array_equal(
            found.numpy(), image.numpy().astype(np.float32) / np.float32(255)
        )


def test_memory_that_is_no_decoders_is_fine() -> None:
    images = frames(3).contiguous()
    strided = frames(3)[..., ::2]
    for source in (images, strided):
        for module in (ToFloat(), ToFloat(memory="contiguous")):
            np.testing.assert_array_equal(
                module.convert(source).numpy(), source.numpy().astype(np.float32) / np.float32(255)
            )


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_floats(dtype: torch.dtype) -> None:
    images = frames(3)
    done = ToFloat(dtype=dtype).convert(images)
    assert done.dtype == dtype
    assert torch.allclose(done.double(), images.double() / 255, atol=4e-3)
    assert ToFloat().convert(done).dtype == torch.float32


def test_memory_is_used_again_but_never_under_a_batch_in_use() -> None:
    module = ToFloat()
    images = frames(1)
    first = module.convert(images)
    kept = first[0, 1]
    address = first.data_ptr()
    assert module.convert(images).data_ptr() != address
    expected = kept.clone()
    del first
    gc.collect()
    assert module.convert(images * 0).data_ptr() != address
    assert torch.equal(kept, expected)
    del kept
    gc.collect()
    addresses = {module.convert(images).data_ptr() for _ in range(3)}
    assert len(addresses) <= 2


@pytest.mark.parametrize("options", [{"dtype": torch.uint8}, {"memory": "last"}])
def test_nonsense_is_refused(options: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        ToFloat(**options)  # type: ignore[arg-type]  # wrong on purpose
