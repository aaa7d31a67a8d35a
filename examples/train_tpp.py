"""Tactile Prediction Pretraining in small: predict the touch to come.

A tactile VAE, and a diffusion transformer over its latents that is given the history of touch
(some of its frames hidden), actions and an image. On a CPU in minutes::

    exumi demo --direct --out play --seconds 120
    exumi prepare play/dataset training --size 64 --gray
    python examples/train_tpp.py training --small [--steps 400] [--mask action] [--save FILE]

Without ``--small`` the model is of a size for a GPU. `examples/tpp` holds its parts.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from tpp.data import Samples
from tpp.evaluation import baselines, evaluate
from tpp.predictor import Losses, Sizes
from tpp.training import make_predictor, train

import exumi_data
from exumi_data.errors import ExumiError
from exumi_loaders import TPPWindows
from exumi_loaders.masks import MASKS, Mask


def main() -> None:
    """Train, then compare predictions with two guesses on windows that were held out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument(
        "--mask", choices=list(MASKS), default="none", help="inputs that are left out"
    )
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--batch-size", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="a model that a CPU trains in minutes")
    parser.add_argument("--held-out", type=int, default=256, help="windows to predict, at most")
    parser.add_argument("--save", type=Path, help="write the weights to this file")
    arguments = parser.parse_args()
    device = "cuda" if torch.cuda.is_available() else "cpu"

    dataset = exumi_data.open(arguments.dataset)
    if not isinstance(dataset, exumi_data.Dataset):
        parser.error("give a dataset, not one episode")
    sizes = Sizes.small() if arguments.small else Sizes()

    def samples(split: str, mask: Mask) -> Samples:
        windows = TPPWindows(
            dataset,
            split=split,
            split_ratio=(3, 1),
            grey_tactile=True,
            random_history=split == "train",
            mask=mask,
        )
        return Samples(windows, sizes.side, device)

    try:
        training, held_out = samples("train", arguments.mask), samples("val", arguments.mask)
    except ExumiError as error:
        sys.exit(f"error: {error}\nA quarter of the episodes is held out: there may be too few.")
    print(training.windows, f"- {training.windows.active.mean():.0%} of them active")
    model = make_predictor(sizes, samples("train", "none"), arguments.seed).to(device)

    def say(step: int, losses: Losses) -> None:
        if step % 20 == 0:
            print(
                f"step {step:4d}  loss {losses.total.item():.4f} = diffusion "
                f"{losses.diffusion.item():.4f} + reconstruction {losses.reconstruction.item():.4f}"
            )

    train(
        model,
        training,
        steps=arguments.steps,
        batch_size=arguments.batch_size,
        seed=arguments.seed,
        on_step=say,
    )
    if arguments.save is not None:
        torch.save(model.state_dict(), arguments.save)

    active = np.flatnonzero(held_out.windows.active)
    indices = active[:: -(-len(active) // arguments.held_out)].tolist()
    errors = evaluate(model, held_out, indices)
    guesses = baselines(samples("val", "none"), indices, model.vae.average)
    print(f"mean squared error of {len(indices)} held-out windows")
    print(f"  predicted, one draw      {errors.sample.mean():.5f}")
    print(f"  predicted, mean of four  {errors.mean.mean():.5f}")
    print(f"  the last frame again     {guesses['copy'].mean():.5f}")
    print(f"  the mean image           {guesses['mean'].mean():.5f}")
    print(f"  the VAE alone            {errors.floor.mean():.5f}")


if __name__ == "__main__":
    main()
