"""A minimal diffusion policy that feels: sort balls by their hardness, which no camera sees.

Writes demonstrations and play of a simulated task into a folder (or takes those that are there),
trains a policy, and lets it sort new balls in closed loop, through the path of live streams. On one
CPU core in minutes::

    python examples/train_policy.py FOLDER --variant tpp [--seed 0] [--steps 2500]

Variants: ``vision`` does not feel; ``direct`` learns its tactile encoder with the policy; ``byol``
and ``tpp`` have a frozen one, trained on play without labels. That of ``tpp`` comes from the
predictor of ``train_tpp.py``: it is trained here, or ``--encoder`` takes what
``train_tpp.py FOLDER/play --small --save FILE`` wrote. `examples/touch_policy` holds the parts, and
``benchmarks/policy_tasks.py`` compares the four.
"""

import argparse
from pathlib import Path

import torch
from touch_policy.variants import VARIANTS, Sizes, make_data, run, wilson


def main() -> None:
    """Train one policy, and print how often it succeeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--variant", choices=VARIANTS, default="tpp")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--demonstrations", type=int, default=Sizes.demonstrations)
    parser.add_argument("--play", type=int, default=Sizes.play, help="episodes of play")
    parser.add_argument("--encoder-steps", type=int, default=Sizes.encoder_steps)
    parser.add_argument("--steps", type=int, default=Sizes.steps)
    parser.add_argument("--attempts", type=int, default=Sizes.attempts)
    parser.add_argument("--encoder", type=Path, help="weights of train_tpp.py")
    arguments = parser.parse_args()
    if arguments.encoder is not None and arguments.variant != "tpp":
        parser.error("--encoder is for --variant tpp")
    torch.set_num_threads(1)  # the networks are too small for more

    sizes = Sizes(
        arguments.demonstrations,
        arguments.play,
        arguments.encoder_steps,
        arguments.steps,
        arguments.attempts,
    )
    data = make_data(arguments.folder, sizes)
    print(f"{data.demonstrations}\n{data.play}")
    outcomes = run(arguments.variant, data, sizes, arguments.seed, arguments.encoder)
    for name in ("gripped", "sorted", "success"):
        done = [getattr(outcome, name) for outcome in outcomes]
        low, high = wilson(done)
        print(f"{name:8s} {sum(done):3d} of {len(done)} ({low:.0%} to {high:.0%})")


if __name__ == "__main__":
    main()
