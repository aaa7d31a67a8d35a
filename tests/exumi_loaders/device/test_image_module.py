"""Which tensors of a batch are changed, and what all modules have in common."""

from collections.abc import Callable

import pytest
import torch
from torch import nn

from exumi_data.errors import UsageError
from exumi_loaders.device import (
    Blur,
    CentreCrop,
    ColourJitter,
    ImageModule,
    JpegFrames,
    RandomCrop,
    Resize,
    ToFloat,
)
from exumi_loaders.device.image_module import Batch

RANDOM: tuple[Callable[[int], ImageModule], ...] = (
    lambda seed: RandomCrop(12, seed=seed),
    lambda seed: ColourJitter(seed=seed),
    lambda seed: Blur((0.5, 2.0), p=0.7, seed=seed),
)


def make_batch(channels: int = 3, windows: int = 4, frames: int = 3, side: int = 20) -> Batch:
    """All frames of a window are the same image, and so is its reference."""
    generator = torch.Generator().manual_seed(0)
    image = torch.rand((windows, 1, channels, side, side), generator=generator)
    return {
        "tactile": image.expand(-1, frames, -1, -1, -1).clone(),
        "tactile_reference": image[:, 0].clone(),
        "rgb": torch.rand((windows, 1, channels, side, side), generator=generator),
        "action": torch.rand((windows, 32, 10), generator=generator),
        "valid": torch.ones(windows, dtype=torch.bool),
    }


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("make", RANDOM)
def test_a_window_and_its_reference_are_changed_alike(
    make: Callable[[int], ImageModule], channels: int
) -> None:
    batch = make_batch(channels)
    done = make(0)(batch)
    frames = done["tactile"]
    assert (frames == frames[:, :1]).all()
    assert torch.allclose(frames[:, 0], done["tactile_reference"], atol=1e-6)
    assert not torch.equal(frames, batch["tactile"][..., : frames.shape[-2], : frames.shape[-1]])
    assert done["action"] is batch["action"]


@pytest.mark.parametrize("make", RANDOM)
def test_windows_and_streams_are_changed_differently(make: Callable[[int], ImageModule]) -> None:
    image = torch.rand((1, 1, 3, 20, 20)).expand(16, -1, -1, -1, -1)
    done = make(0)({"a": image, "b": image})
    assert len({tuple(window.flatten().tolist()) for window in done["a"]}) > 4
    assert not torch.equal(done["a"], done["b"])


@pytest.mark.parametrize("make", RANDOM)
def test_a_seed_gives_the_same_images_and_a_checkpoint_goes_on(
    make: Callable[[int], ImageModule],
) -> None:
    batch = make_batch()
    module, again, other = make(3), make(3), make(4)
    first = module(batch)["tactile"]
    assert torch.equal(again(batch)["tactile"], first)
    assert not torch.equal(other(batch)["tactile"], first)
    state = module.state_dict()
    second = module(batch)["tactile"]
    assert not torch.equal(second, first)
    other.load_state_dict(state)
    assert torch.equal(other(batch)["tactile"], second)


def test_a_batch_is_not_changed_in_place() -> None:
    batch = make_batch()
    kept = {name: value.clone() for name, value in batch.items()}
    nn.Sequential(RandomCrop(12), ColourJitter(), Blur(), Resize(8))(batch)
    assert all(torch.equal(batch[name], kept[name]) for name in kept)


def test_named_streams_only() -> None:
    batch = make_batch()
    done = CentreCrop(8, streams=["tactile"])(batch)
    assert done["tactile"].shape[-2:] == (8, 8)
    assert done["tactile_reference"].shape[-2:] == (8, 8)
    assert done["rgb"] is batch["rgb"]
    with pytest.raises(UsageError, match="'tactile', 'rgb'"):
        CentreCrop(8, streams=["touch"])(batch)


def test_files_have_to_be_decoded_first() -> None:
    files = JpegFrames(torch.zeros(0, dtype=torch.uint8), torch.zeros((1, 1, 2)).long(), (4, 4, 1))
    with pytest.raises(UsageError, match="DecodeJpeg first"):
        ToFloat()({"tactile": files})


def test_a_module_has_to_say_what_it_does() -> None:
    with pytest.raises(TypeError, match="_change"):
        ImageModule()  # type: ignore[abstract]  # the point of the test
