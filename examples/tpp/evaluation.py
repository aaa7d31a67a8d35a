"""How well the touch to come is predicted, on windows that were not trained on."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from tpp.data import Sample, Samples
from tpp.predictor import TactilePredictor

__all__ = ["Errors", "baselines", "evaluate"]


@dataclass(frozen=True)
class Errors:
    """Mean squared errors of each held-out window, (W,) each.

    Attributes
    ----------
    sample : ndarray
        Of one drawn future, on average over those drawn: grey, convex and concave in [0, 1].
    mean : ndarray
        Of the mean of the futures drawn.
    latent : ndarray
        Of one drawn future, in the normalised latents of this model's VAE.
    floor : ndarray
        Of the true future, encoded and decoded: what the VAE loses.
    """

    sample: np.ndarray
    mean: np.ndarray
    latent: np.ndarray
    floor: np.ndarray


def evaluate(
    model: TactilePredictor,
    samples: Samples,
    indices: list[int],
    *,
    draws: int = 4,
    steps: int = 8,
    batch_size: int = 128,
) -> Errors:
    """Draw futures of windows and compare them with the truth.

    Parameters
    ----------
    model : TactilePredictor
    samples : Samples
        Of held-out windows.
    indices : list of int
        Which windows.
    draws, steps : int
        Futures drawn a window; steps of the diffusion.
    batch_size : int
    """
    model.eval()
    rows: dict[str, list[Tensor]] = {"sample": [], "mean": [], "latent": [], "floor": []}
    generator = torch.Generator().manual_seed(0)  # the same noise for all models
    for first in range(0, len(indices), batch_size):
        sample = samples.read(indices[first : first + batch_size])
        true, seen = _future(sample)
        floor, latents = model.reconstruct(sample)
        drawn, latent_errors = [], []
        for _ in range(draws):
            noise = torch.randn(latents.shape, generator=generator).to(latents.device)
            images, guess = model.predict(sample, noise, steps)
            drawn.append(images)
            error = (guess - latents).square().mean(-1)
            latent_errors.append(_mean_seen(error, seen))
        futures = torch.stack(drawn)
        singles = [_window_errors(images, true, seen) for images in drawn]
        rows["sample"].append(torch.stack(singles).mean(0))
        rows["mean"].append(_window_errors(futures.mean(0), true, seen))
        rows["latent"].append(torch.stack(latent_errors).mean(0))
        rows["floor"].append(_window_errors(floor, true, seen))
    return Errors(**{name: torch.cat(values).cpu().numpy() for name, values in rows.items()})


def baselines(samples: Samples, indices: list[int], mean: Tensor) -> dict[str, np.ndarray]:
    """Return the errors of two guesses that need no training, (W,) each.

    ``copy`` is the last frame of the history, ``mean`` the mean image of the training windows.

    Parameters
    ----------
    samples : Samples
        Of held-out windows, nothing masked.
    indices : list of int
    mean : Tensor
        (3F, side, side): the mean image of training windows, as in `Scales`.
    """
    copy, average = [], []
    for first in range(0, len(indices), 128):
        sample = samples.read(indices[first : first + 128])
        true, seen = _future(sample)
        frames = true.shape[1]
        last = sample.touch[:, -frames - 1 : -frames]
        copy.append(_window_errors(last.expand_as(true), true, seen))
        average.append(_window_errors(mean.expand_as(true), true, seen))
    return {"copy": torch.cat(copy).cpu().numpy(), "mean": torch.cat(average).cpu().numpy()}


def _future(sample: Sample) -> tuple[Tensor, Tensor]:
    """Return the true images of the future and which are there."""
    later = sample.steps[0] > 0
    return sample.touch[:, later], sample.touch_seen[:, later]


def _window_errors(images: Tensor, true: Tensor, seen: Tensor) -> Tensor:
    return _mean_seen((images - true).square().mean(dim=(-3, -2, -1)), seen)


def _mean_seen(errors: Tensor, seen: Tensor) -> Tensor:
    """Average errors (B, k) over what is there, (B,)."""
    return (errors * seen).sum(dim=1) / seen.sum(dim=1).clamp_min(1)
