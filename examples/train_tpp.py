"""Tactile Prediction Pretraining in small: predict the touch to come.

A tactile VAE, and a diffusion transformer over its latents that is given the history of touch
(some of its frames hidden), actions and an image. On a CPU in minutes::

    python examples/train_tpp.py DATASET --small [--steps 500] [--mask action] [--save FILE]

Without ``--small`` the model is made for a GPU. `examples/tpp` holds the parts.
"""

import argparse
from pathlib import Path

import torch
from tpp.data import Samples
from tpp.evaluation import baselines, evaluate, mean_touch
from tpp.predictor import Losses, Sizes
from tpp.training import make_predictor, train

import exumi_data
from exumi_loaders import TPPWindows

MASKS = ("none", "action", "rgb", "action+rgb", "tactile_history")


def main() -> None:
    """Train, print the losses, and compare with two guesses on windows that were held out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("--mask", choices=MASKS, default="none", help="inputs that are left out")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--batch-size", type=int, default=32)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="sizes for a CPU")
    parser.add_argument("--windows", type=int, default=256, help="held-out windows to predict")
    parser.add_argument("--save", type=Path, help="where to write the weights")
    arguments = parser.parse_args()
    device = "cuda" if torch.cuda.is_available() else "cpu"

    dataset = exumi_data.open(arguments.dataset)
    if not isinstance(dataset, exumi_data.Dataset):
        parser.error("give a dataset, not one episode")
    sizes = Sizes.small() if arguments.small else Sizes()
    ratio = (4, 1)
    complete = TPPWindows(dataset, split="train", split_ratio=ratio, grey_tactile=True)
    training = TPPWindows(
        dataset, split="train", split_ratio=ratio, grey_tactile=True, mask=arguments.mask
    )
    print(training, f"- {training.active.mean():.0%} of them active")
    model = make_predictor(sizes, complete, arguments.seed).to(device)

    def say(step: int, losses: Losses) -> None:
        if step % 10 == 0:
            print(
                f"step {step:4d}  loss {losses.total.item():.4f} = diffusion "
                f"{losses.diffusion.item():.4f} + reconstruction {losses.reconstruction.item():.4f}"
            )

    train(
        model,
        Samples(training, sizes.side, device),
        steps=arguments.steps,
        batch_size=arguments.batch_size,
        seed=arguments.seed,
        on_step=say,
    )
    if arguments.save is not None:
        torch.save(model.state_dict(), arguments.save)


if __name__ == "__main__":
    main()
