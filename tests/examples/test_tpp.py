"""The parts of the example: diffusion, masks, and what is the same for all masks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from tpp.data import Sample, Samples
from tpp.diffusion import add_noise, denoise
from tpp.evaluation import baselines, evaluate
from tpp.predictor import Losses, Sizes, TactilePredictor
from tpp.training import make_predictor, train

from exumi_data.dataset import Dataset, open_dataset
from exumi_loaders import TPPWindows
from exumi_loaders.masks import MASKS, Mask


@pytest.fixture(scope="module")
def dataset(play: Path) -> Dataset:
    return open_dataset(play)


def make_samples(dataset: Dataset, mask: Mask = "none") -> Samples:
    windows = TPPWindows(dataset, grey_tactile=True, mask=mask, cache=False)
    return Samples(windows, Sizes.small().side, "cpu")


@pytest.fixture(scope="module")
def model(dataset: Dataset) -> TactilePredictor:
    """Shaken, so that its gates, which begin closed, let all inputs through."""
    model = make_predictor(Sizes.small(), make_samples(dataset), seed=1)
    with torch.no_grad():
        for weights in model.parameters():
            weights.add_(0.1 * torch.randn(weights.shape))
    return model.eval()


def test_noise_has_the_share_that_the_time_says() -> None:
    clean, noise = torch.ones(3, 2), torch.full((3, 2), 10.0)
    mixed = add_noise(clean, noise, torch.tensor([0.0, 0.5, 1.0]))
    torch.testing.assert_close(mixed[0], clean[0])
    torch.testing.assert_close(mixed[2], noise[2])
    torch.testing.assert_close(mixed[1], (clean[1] + noise[1]) * 0.5**0.5)


def test_denoising_ends_where_a_perfect_estimate_says() -> None:
    true = torch.tensor([[1.0, -2.0, 0.5]])
    times = []

    def estimate(noisy: Tensor, time: Tensor) -> Tensor:
        times.append(float(time))
        assert noisy.shape == true.shape
        return true

    drawn = denoise(estimate, torch.randn(1, 3), steps=4)
    torch.testing.assert_close(drawn, true)
    assert times == [1.0, 0.75, 0.5, 0.25]


def test_denoising_follows_a_gaussian() -> None:
    # Of data N(m, s²) the best estimate is known; the draws are then of that distribution.
    mean, spread = 3.0, 0.5

    def estimate(noisy: Tensor, time: Tensor) -> Tensor:
        signal, rest = (time * torch.pi / 2).cos(), (time * torch.pi / 2).sin()
        gain = signal * spread**2 / ((signal * spread) ** 2 + rest**2)
        return mean + gain * (noisy - signal * mean)

    generator = torch.Generator().manual_seed(0)
    drawn = denoise(estimate, torch.randn(4000, generator=generator), steps=50)
    assert float(drawn.mean()) == pytest.approx(mean, abs=0.03)
    assert float(drawn.std()) == pytest.approx(spread, rel=0.1)


@pytest.mark.parametrize("mask", MASKS)
def test_a_mask_hides_its_inputs_and_nothing_else(
    dataset: Dataset, model: TactilePredictor, mask: Mask
) -> None:
    whole = next(make_samples(dataset).draw(4, 1, seed=3))
    masked = next(make_samples(dataset, mask).draw(4, 1, seed=3))
    hides = {
        "touch": mask == "tactile_history",
        "image": "rgb" in mask,
        "action": "action" in mask,
    }
    assert bool(masked.touch_seen[:, :4].any()) is not hides["touch"]
    assert bool(masked.image_seen.any()) is not hides["image"]
    assert bool(masked.action_seen.any()) is not hides["action"]
    torch.testing.assert_close(masked.touch[:, 4:], whole.touch[:, 4:])  # the same windows
    assert masked.touch_seen[:, 4:].equal(whole.touch_seen[:, 4:])

    noise = torch.randn(4, 4, Sizes.small().latent)
    expected, _ = model.predict(masked, noise)
    for name, hidden in hides.items():
        found, _ = model.predict(other_values(masked, name), noise)
        assert torch.allclose(found, expected, atol=1e-6) is hidden, name


def other_values(sample: Sample, name: str) -> Sample:
    """Change one input, but neither what is seen nor the future."""
    values: Tensor = getattr(sample, name).clone()
    changed = values[:, :4] if name == "touch" else values
    changed += torch.rand(changed.shape)
    return replace(sample, **{name: values})


def test_the_future_is_not_an_input(dataset: Dataset, model: TactilePredictor) -> None:
    sample = next(make_samples(dataset).draw(4, 1, seed=3))
    touch = sample.touch.clone()
    touch[:, 4:] = 0
    noise = torch.randn(4, 4, Sizes.small().latent)
    expected, _ = model.predict(sample, noise)
    found, _ = model.predict(replace(sample, touch=touch), noise)
    torch.testing.assert_close(found, expected)


def test_masks_of_a_seed_start_alike_and_see_the_same(dataset: Dataset) -> None:
    runs: dict[str, list[tuple[float, float]]] = {"none": [], "action+rgb": []}
    for mask, seen in runs.items():
        model = make_predictor(Sizes.small(), make_samples(dataset), seed=2)

        def keep(_: int, losses: Losses, seen: list[tuple[float, float]] = seen) -> None:
            seen.append((losses.diffusion.item(), losses.reconstruction.item()))

        samples = make_samples(dataset, "none" if mask == "none" else "action+rgb")
        train(model, samples, steps=4, batch_size=4, seed=2, on_step=keep)
    # The VAE's first step, and the first one with noise: actions and images have no way in yet.
    assert runs["none"][:2] == runs["action+rgb"][:2]
    assert runs["none"][0][0] == 0
    assert runs["none"][3] != runs["action+rgb"][3]


def test_errors_are_of_the_future_of_each_window(dataset: Dataset, model: TactilePredictor) -> None:
    samples = make_samples(dataset)
    indices = [30, 60, 90]
    errors = evaluate(model, samples, indices, draws=2, steps=2, batch_size=2)
    sample = samples.read(indices)
    true = sample.touch[:, 4:]
    last = sample.touch[:, 3:4]
    copy = baselines(samples, indices, model.vae.average)["copy"]
    assert copy == pytest.approx((last - true).square().mean(dim=(1, 2, 3, 4)).numpy(), rel=1e-4)
    floor, _ = model.reconstruct(sample)
    expected = (floor - true).square().mean(dim=(1, 2, 3, 4)).numpy()
    assert errors.floor == pytest.approx(expected, rel=1e-4)
    # The mean of two draws is nearer than they are by a quarter of their squared distance.
    assert (errors.mean < errors.sample).all()
    assert errors.latent.shape == errors.sample.shape == (3,)
    assert np.isfinite(errors.latent).all()
