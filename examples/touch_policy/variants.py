"""The four policies that are compared, and how one of them is trained and judged."""

import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import torch

import exumi_data
from exumi_loaders import Normaliser, PolicyWindows
from touch_policy.demonstrations import write_demonstrations, write_play
from touch_policy.encoders import (
    FrozenEncoder,
    TactileEncoder,
    load_tpp,
    salient_images,
    train_byol,
    train_tpp,
    untrained_encoder,
)
from touch_policy.policy import DiffusionPolicy, train_policy
from touch_policy.rollouts import roll_out
from touch_policy.world import LATENCY_S, Outcome

__all__ = ["VARIANTS", "Data", "Sizes", "Variant", "make_data", "open_windows", "run", "wilson"]

Variant = Literal["vision", "direct", "byol", "tpp"]
VARIANTS: tuple[Variant, ...] = get_args(Variant)
Write = Callable[[Path, int, int], exumi_data.Dataset]


@dataclass(frozen=True)
class Sizes:
    """How much of everything: the defaults take minutes on one core.

    Attributes
    ----------
    demonstrations, play : int
        Episodes.
    encoder_steps, steps : int
        Of training an encoder, and a policy.
    attempts : int
        Balls to be sorted by each policy.
    """

    demonstrations: int = 100
    play: int = 60
    encoder_steps: int = 400
    steps: int = 2500
    attempts: int = 50


@dataclass(frozen=True)
class Data:
    """What all variants learn from."""

    demonstrations: exumi_data.Dataset
    play: exumi_data.Dataset


def make_data(folder: Path, sizes: Sizes, seed: int = 0) -> Data:
    """Write the episodes into a folder, or open those that are there."""
    return Data(
        _make("demonstrations", folder, write_demonstrations, sizes.demonstrations, seed),
        _make("play", folder, write_play, sizes.play, seed),
    )


def _make(name: str, folder: Path, write: Write, count: int, seed: int) -> exumi_data.Dataset:
    root, unfinished = folder / name, folder / f"{name}.unfinished"
    if not root.exists():  # it is there whole, or not at all
        shutil.rmtree(unfinished, ignore_errors=True)
        write(unfinished, count, seed)
        unfinished.rename(root)
    dataset = exumi_data.open(root)
    assert isinstance(dataset, exumi_data.Dataset)  # noqa: S101  # as it was written
    return dataset


def open_windows(demonstrations: exumi_data.Dataset) -> PolicyWindows:
    """Open what a policy is trained on: two observations, and eight actions over 0.8 s."""
    return PolicyWindows(
        demonstrations,
        latency_s=LATENCY_S,
        observation_steps=2,
        action_steps=8,
        tick_s=0.1,
        action="absolute",  # the bins are places in the world
    )


def run(
    variant: Variant, data: Data, sizes: Sizes, seed: int, weights: Path | None = None
) -> list[Outcome]:
    """Train one variant, and let it sort balls.

    Parameters
    ----------
    variant : {"vision", "direct", "byol", "tpp"}
        Without touch; with an encoder that learns with the policy; with a frozen one.
    data : Data
    sizes : Sizes
    seed : int
        Of weights, batches and the balls that are to be sorted.
    weights : Path, optional
        Of ``train_tpp.py``, in place of training an encoder (``tpp``).
    """
    windows = open_windows(data.demonstrations)
    normaliser = Normaliser.fit(windows, any_split=True)  # what is tested on are new balls
    touch = _encoder(variant, data.play, sizes.encoder_steps, seed, weights)
    torch.manual_seed(seed)
    policy = DiffusionPolicy(windows.policy_spec, normaliser, touch)
    policy = train_policy(policy, windows, sizes.steps, seed)
    return roll_out(policy, windows.policy_spec, data.demonstrations[0], sizes.attempts, seed)


def _encoder(
    variant: Variant, play: exumi_data.Dataset, steps: int, seed: int, weights: Path | None
) -> TactileEncoder | FrozenEncoder | None:
    if variant == "vision":
        return None
    if variant == "direct":
        torch.manual_seed(seed)
        return untrained_encoder(salient_images(play))
    if variant == "byol":
        return train_byol(play, steps, seed)
    if weights is not None:
        return load_tpp(weights, play)
    return train_tpp(play, steps, seed)


def wilson(successes: Sequence[bool], z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a rate."""
    count = len(successes)
    rate = sum(successes) / count
    middle = (rate + z * z / (2 * count)) / (1 + z * z / count)
    half = (
        z / (1 + z * z / count) * math.sqrt(rate * (1 - rate) / count + z * z / (4 * count * count))
    )
    return middle - half, middle + half
