"""One affine map of colours for each window."""

import colorsys

import pytest
import torch

from exumi_data.errors import UsageError
from exumi_loaders import ColourJitter, TactileRepresentation

ZERO = {"brightness": 0.0, "contrast": 0.0, "saturation": 0.0, "hue": 0.0}
LUMA = torch.tensor([0.299, 0.587, 0.114]).view(3, 1, 1)


def images(channels: int = 3, windows: int = 3) -> torch.Tensor:
    generator = torch.Generator().manual_seed(5)
    return torch.rand((windows, 2, channels, 12, 10), generator=generator) * 0.3 + 0.35


@pytest.mark.parametrize("channels", [1, 3])
def test_nothing_to_change(channels: int) -> None:
    batch = {"x": images(channels)}
    assert torch.allclose(ColourJitter(**ZERO)(batch)["x"], batch["x"], atol=1e-6)  # type: ignore[arg-type]


def test_brightness_is_a_factor() -> None:
    before = images()
    after = ColourJitter(**{**ZERO, "brightness": 0.3})({"x": before})["x"]  # type: ignore[arg-type]
    factor = after / before
    assert torch.allclose(factor, factor[:, :1, :1, :1, :1].expand_as(factor), atol=1e-4)
    assert len(set(factor[:, 0, 0, 0, 0].tolist())) == 3
    assert ((factor > 0.7) & (factor < 1.3)).all()


@pytest.mark.parametrize("channels", [1, 3])
def test_contrast_keeps_the_mean_of_the_window(channels: int) -> None:
    before = images(channels)
    after = ColourJitter(**{**ZERO, "contrast": 0.3})({"x": before})["x"]  # type: ignore[arg-type]
    weights = LUMA if channels == 3 else 1

    def mean(x: torch.Tensor) -> torch.Tensor:
        return (x * weights).sum(2).mean(dim=(1, 2, 3))

    assert torch.allclose(mean(after), mean(before), atol=1e-5)
    assert not torch.allclose(after, before, atol=1e-2)


def test_saturation_and_hue_leave_luma() -> None:
    before = images()
    jitter = ColourJitter(**{**ZERO, "saturation": 0.5, "hue": 0.1})  # type: ignore[arg-type]
    after = jitter({"x": before})["x"]
    assert torch.allclose((after * LUMA).sum(2), (before * LUMA).sum(2), atol=1e-5)
    assert not torch.allclose(after, before, atol=1e-2)
    grey = before.mean(2, keepdim=True).expand_as(before)
    assert torch.allclose(jitter({"x": grey})["x"], grey, atol=1e-5)


def test_hue_turns_by_about_as_much_as_it_says() -> None:
    before = torch.tensor([0.6, 0.45, 0.4]).view(1, 1, 3, 1, 1).expand(50, -1, -1, -1, -1)
    after = ColourJitter(**{**ZERO, "hue": 0.1})({"x": before})["x"]  # type: ignore[arg-type]
    start = colorsys.rgb_to_hsv(0.6, 0.45, 0.4)[0]
    turned = [colorsys.rgb_to_hsv(*pixel.tolist())[0] - start for pixel in after[:, 0, :, 0, 0]]
    turned = [(turn + 0.5) % 1 - 0.5 for turn in turned]
    assert 0.06 < max(turned) < 0.15
    assert -0.15 < min(turned) < -0.06


def test_a_turn_of_hue_keeps_the_strength_of_colour() -> None:
    yiq = torch.tensor([[0.595716, -0.274453, -0.321263], [0.211456, -0.522591, 0.311135]])

    def strength(x: torch.Tensor) -> torch.Tensor:
        return torch.einsum("ij,bkjhw->bkihw", yiq, x).square().sum(dim=2)

    before = images()
    after = ColourJitter(**{**ZERO, "hue": 0.2})({"x": before})["x"]  # type: ignore[arg-type]
    assert torch.allclose(strength(after), strength(before), atol=1e-4)
    assert not torch.allclose(after, before, atol=1e-2)


def test_what_touches_is_scaled_and_not_shifted() -> None:
    """Frame minus reference keeps its shape: the representation of touch only changes its gain."""
    reference = images(1)[:, 0]
    frames = reference[:, None] + torch.tensor([0.0, 0.02]).view(1, 2, 1, 1, 1)
    done = ColourJitter(seed=2)({"x": frames, "x_reference": reference})
    difference = done["x"] - done["x_reference"][:, None]
    assert torch.allclose(difference[:, 0], torch.zeros(()), atol=1e-6)
    gain = difference[:, 1] / 0.02
    assert torch.allclose(gain, gain[:, :, :1, :1].expand_as(gain), atol=1e-3)
    # The representation takes bytes: back to them, no contact stays no contact.
    still = TactileRepresentation()(
        (done["x"][:, :1] * 255).round().byte(), (done["x_reference"] * 255).round().byte()
    )
    assert (still[:, :, 1:] == 0).all()


def test_values_stay_between_0_and_1() -> None:
    done = ColourJitter(brightness=1.0, contrast=1.0)({"x": torch.rand(8, 1, 3, 9, 9)})["x"]
    assert done.min() >= 0
    assert done.max() <= 1


def test_nonsense_is_refused() -> None:
    with pytest.raises(UsageError, match="ToFloat"):
        ColourJitter()({"x": torch.zeros(1, 1, 3, 4, 4, dtype=torch.uint8)})
    with pytest.raises(UsageError, match="hue"):
        ColourJitter(hue=0.6)
    with pytest.raises(UsageError, match="contrast"):
        ColourJitter(contrast=-0.1)
