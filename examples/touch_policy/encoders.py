"""Tactile encoders that are trained on play without labels, and frozen: TPP or BYOL."""

import copy
from pathlib import Path

import torch
from torch import Tensor, nn
from tpp.data import Samples
from tpp.predictor import Sizes
from tpp.training import make_predictor
from tpp.training import train as fit_predictor
from tpp.vae import TactileVAE

import exumi_data
from exumi_loaders import TactileRepresentation, TPPWindows, TwoViews
from exumi_loaders.device import Blur, ColourJitter, RandomCrop, Resize, ToFloat

__all__ = [
    "FrozenEncoder",
    "TactileEncoder",
    "load_tpp",
    "salient_images",
    "train_byol",
    "train_tpp",
    "untrained_encoder",
]

_SMALL = Sizes.small()
_BATCH = 32


class TactileEncoder(nn.Module):
    """The encoder of a tactile VAE: grey, convex and concave images to vectors.

    Parameters
    ----------
    vae : TactileVAE
        Of one finger's images. What decodes is neither used nor trained.
    """

    def __init__(self, vae: TactileVAE) -> None:
        super().__init__()
        self.vae = vae
        self.size = len(vae.shift)
        vae.decoder.requires_grad_(requires_grad=False)

    def forward(self, images: Tensor) -> Tensor:
        """Encode images (N, 3, side, side) into vectors (N, size)."""
        return self.vae.encode(images)[0]


class FrozenEncoder(nn.Module):
    """An encoder that does not learn any more; its features have zero mean and unit spread.

    Parameters
    ----------
    encoder : TactileEncoder
    images : Tensor
        (N, 3, side, side): what mean and spread are measured on.
    """

    mean: Tensor
    spread: Tensor

    def __init__(self, encoder: TactileEncoder, images: Tensor) -> None:
        super().__init__()
        self.encoder = copy.deepcopy(encoder).requires_grad_(requires_grad=False)
        self.size = encoder.size
        with torch.no_grad():
            features = self.encoder(images)
        self.register_buffer("mean", features.mean(0))
        self.register_buffer("spread", features.std(0).clamp_min(1e-4))

    def forward(self, images: Tensor) -> Tensor:
        """Encode images (N, 3, side, side) into vectors (N, size)."""
        return torch.as_tensor((self.encoder(images) - self.mean) / self.spread)


def load_tpp(file: Path, play: exumi_data.Dataset) -> FrozenEncoder:
    """Read the encoder from weights that ``train_tpp.py PLAY --small --save FILE`` wrote.

    Raises
    ------
    ValueError
        The weights are those of another model, or of images of another size.
    """
    weights = torch.load(file, map_location="cpu", weights_only=True)
    of_vae = {
        name.removeprefix("vae."): value
        for name, value in weights.items()
        if name.startswith("vae.")
    }
    images = salient_images(play)
    found = tuple(of_vae["average"].shape) if "average" in of_vae else None
    if found != images.shape[1:]:
        raise ValueError(
            f"{file} holds no encoder of images {tuple(images.shape[1:])}, but of {found}: "
            "train it by train_tpp.py --small, on the same play"
        )
    vae = _make_vae(of_vae["average"], of_vae["contrast"])
    vae.load_state_dict(of_vae)
    return FrozenEncoder(TactileEncoder(vae), images)


def train_tpp(play: exumi_data.Dataset, steps: int, seed: int) -> FrozenEncoder:
    """Train by predicting the touch to come, as ``train_tpp.py PLAY --small`` does.

    Parameters
    ----------
    play : Dataset
    steps, seed : int
    """
    windows = TPPWindows(play, split="train", split_ratio=(3, 1), grey_tactile=True)
    samples = Samples(windows, _SMALL.side, "cpu")
    model = make_predictor(_SMALL, samples, seed)
    fit_predictor(model, samples, steps=steps, batch_size=_BATCH, seed=seed)
    return FrozenEncoder(TactileEncoder(model.vae), salient_images(play))


def train_byol(play: exumi_data.Dataset, steps: int, seed: int) -> FrozenEncoder:
    """Train by making two views of a frame alike (Bootstrap Your Own Latent).

    Parameters
    ----------
    play : Dataset
    steps, seed : int
    """
    views = TwoViews(play, seed=seed)
    torch.manual_seed(seed)
    images = salient_images(play)
    encoder = untrained_encoder(images)
    online = nn.Sequential(encoder, _perceptron(encoder.size))
    target = copy.deepcopy(online).requires_grad_(requires_grad=False)
    guess = _perceptron(encoder.size)
    optimizer = torch.optim.AdamW([*online.parameters(), *guess.parameters()], lr=1e-3)
    side = images.shape[-1]
    change = nn.Sequential(
        ToFloat(),
        RandomCrop(side * 7 // 8, seed=seed),
        Resize(side),
        ColourJitter(seed=seed),
        Blur((0.1, 1.0), seed=seed),
    )
    represent = TactileRepresentation()

    def view(batch: dict[str, Tensor]) -> Tensor:
        """Return one view: frame and reference are changed alike, as another pad would look."""
        seen = {"tactile": batch["frames"][:, None], "tactile_reference": batch["reference"]}
        seen = change(seen)
        images = represent(255 * seen["tactile"], 255 * seen["tactile_reference"])
        return torch.as_tensor(images[:, 0])

    done = 0
    while done < steps:
        for batch in views.loader(min(_BATCH, len(views)), drop_last=True):
            one, other = view(batch), view(batch)
            loss = torch.zeros(())
            for here, there in ((one, other), (other, one)):
                with torch.no_grad():
                    wanted = target(there)
                loss = loss - nn.functional.cosine_similarity(guess(online(here)), wanted).mean()
            _descend(optimizer, loss)
            for kept, new in zip(target.parameters(), online.parameters(), strict=True):
                kept.data.lerp_(new.data, 0.01)
            done += 1
            if done == steps:
                break
    return FrozenEncoder(encoder, images)


def _perceptron(size: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(size, 128), nn.BatchNorm1d(128), nn.ReLU(), nn.Linear(128, size))


def _descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


def salient_images(dataset: exumi_data.Dataset) -> Tensor:
    """Return the representation of a dataset's salient frames, (N, 3, side, side)."""
    views = TwoViews(dataset)
    batch = views.__getitems__(range(len(views)))
    images = TactileRepresentation()(batch["frames"][:, None], batch["reference"])
    return torch.as_tensor(images[:, 0])


def untrained_encoder(images: Tensor) -> TactileEncoder:
    """Make an encoder whose inputs have about unit spread, given images to measure it by."""
    average = images.mean(0)
    return TactileEncoder(_make_vae(average, (images - average).std()))


def _make_vae(average: Tensor, contrast: Tensor) -> TactileVAE:
    return TactileVAE(average, contrast, _SMALL.latent, _SMALL.vae_width)
