"""The training loop."""

import math
from collections.abc import Callable

import torch

from tpp.data import Samples, measure
from tpp.predictor import Losses, Sizes, TactilePredictor

__all__ = ["make_predictor", "train"]


def make_predictor(sizes: Sizes, samples: Samples, seed: int) -> TactilePredictor:
    """Make an untrained predictor for the streams of some windows.

    Parameters
    ----------
    sizes : Sizes
    samples : Samples
        Of training windows without a mask: the scales of inputs are measured on them.
    seed : int
        Of the initial weights.
    """
    scales = measure(samples)
    torch.manual_seed(seed)
    steps = samples.windows.steps
    return TactilePredictor(
        sizes,
        history_frames=steps.history_frames,
        first_step=int(steps.first),
        last_step=int(steps.last),
        images=len(samples.windows.layout.rgb) * len(steps.rgb),
        scales=scales,
    )


def train(  # keyword-only
    model: TactilePredictor,
    samples: Samples,
    *,
    steps: int,
    batch_size: int,
    seed: int,
    rate: float = 3e-3,
    on_step: Callable[[int, Losses], None] | None = None,
) -> None:
    """Train for a number of steps: the VAE alone for a quarter of them, then all together.

    Windows, noise and hidden frames are a function of the seed alone: two runs that differ in
    their mask see the same ones.

    Parameters
    ----------
    model : TactilePredictor
    samples : Samples
    steps, batch_size : int
    seed : int
    rate : float
        Highest learning rate; it rises for a twentieth of the steps and falls to zero.
    on_step : callable, optional
        Called after each step with its number and losses.
    """
    optimizer = torch.optim.AdamW(model.parameters(), lr=rate, weight_decay=1e-4)
    warm, alone = max(1, steps // 20), steps // 4
    torch.manual_seed(seed)
    model.train()
    for step, sample in enumerate(samples.draw(batch_size, steps, seed)):
        share = min((step + 1) / warm, 0.5 + 0.5 * math.cos(math.pi * step / steps))
        for group in optimizer.param_groups:
            group["lr"] = rate * share
        losses = model.losses(sample, predict=step >= alone)
        optimizer.zero_grad()
        losses.total.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        if on_step is not None:
            on_step(step, losses)
