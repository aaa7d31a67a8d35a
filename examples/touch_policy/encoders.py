"""Tactile encoders that are trained on play without labels, and frozen: TPP or BYOL."""

import copy
from pathlib import Path

import torch
from torch import Tensor, nn

import exumi_data
from exumi_loaders import ActiveWindowSampler, TactileRepresentation, TPPWindows, TwoViews
from exumi_loaders.device import Blur, ColourJitter, RandomCrop, Resize, ToFloat
from touch_policy.diffusion import Denoiser

__all__ = [
    "FrozenEncoder",
    "TactileEncoder",
    "load_tpp_encoder",
    "salient_images",
    "train_byol",
    "train_tpp",
    "untrained_encoder",
]

_PATCH = 16  # pixels that both convolutions reduce to one
_LATENT, _WIDTH = 48, 32
_BATCH = 32


class TactileEncoder(nn.Module):
    """Grey, convex and concave images to vectors: the encoder of a small VAE.

    Parameters
    ----------
    average : Tensor
        (3, side, side): the mean image; side is a multiple of 16.
    contrast : Tensor
        (): the spread of images about it.
    size, width : int
        Length of a vector; channels of the first convolution.
    """

    average: Tensor
    contrast: Tensor

    def __init__(
        self, average: Tensor, contrast: Tensor, size: int = _LATENT, width: int = _WIDTH
    ) -> None:
        super().__init__()
        rows = average.shape[-1] // _PATCH
        self.size = size
        self.register_buffer("average", average)
        self.register_buffer("contrast", contrast)
        self.encoder = nn.Sequential(
            nn.Conv2d(average.shape[0], width, 4, stride=4),
            nn.SiLU(),
            nn.Conv2d(width, 4 * width, 4, stride=4),
            nn.SiLU(),
            nn.Flatten(),
            nn.Linear(4 * width * rows * rows, 2 * size),
        )

    def encode(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Encode images (N, 3, side, side) into mean and log variance, (N, size) both."""
        mean, log_variance = self.encoder((images - self.average) / self.contrast).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12, 4)

    def forward(self, images: Tensor) -> Tensor:
        """Encode images (N, 3, side, side) into vectors (N, size)."""
        return self.encode(images)[0]


class FrozenEncoder(nn.Module):
    """An encoder that does not learn any more; its features have zero mean and unit spread."""

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


def load_tpp_encoder(file: Path) -> TactileEncoder:
    """Read the encoder of the VAE from weights that ``train_tpp.py --small --save`` wrote.

    Raises
    ------
    KeyError
        The file holds no such encoder.
    """
    weights = torch.load(file, map_location="cpu", weights_only=True)
    own = {
        name.removeprefix("vae."): value
        for name, value in weights.items()
        if name.startswith("vae.") and name.split(".")[1] in {"average", "contrast", "encoder"}
    }
    width, size = len(own["encoder.0.weight"]), len(own["encoder.5.weight"]) // 2
    encoder = TactileEncoder(own["average"], own["contrast"], size, width)
    encoder.load_state_dict(own)
    return encoder


class _Prediction(nn.Module):
    """A VAE, and a diffusion of the vectors to come, given those that were and the actions."""

    def __init__(self, encoder: TactileEncoder, frames: int, future: int, actions: int) -> None:
        super().__init__()
        self.encoder = encoder
        channels, side, _ = encoder.average.shape
        rows, deep = side // _PATCH, 4 * _WIDTH
        self.decoder = nn.Sequential(
            nn.Linear(encoder.size, deep * rows * rows),
            nn.Unflatten(1, (deep, rows, rows)),
            nn.SiLU(),
            nn.ConvTranspose2d(deep, _WIDTH, 4, stride=4),
            nn.SiLU(),
            nn.ConvTranspose2d(_WIDTH, channels, 4, stride=4),
        )
        self.future = future
        history = (frames - future) * encoder.size
        self.denoiser = Denoiser(future * encoder.size, history + actions)

    def loss(self, images: Tensor, action: Tensor) -> Tensor:
        """Sum up diffusion and reconstruction; images (B, K, 3, side, side), history first."""
        flat = images.flatten(0, 1)
        mean, log_variance = self.encoder.encode(flat)
        drawn = mean + torch.randn_like(mean) * (0.5 * log_variance).exp()
        error = self.decoder(drawn) - (flat - self.encoder.average) / self.encoder.contrast
        divergence = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).mean()
        past, later = mean.unflatten(0, images.shape[:2]).tensor_split([-self.future], dim=1)
        hidden = torch.rand(past.shape[:2]) < 0.25  # of the history, as TPP masks it
        past = past * ~hidden[..., None]
        context = torch.cat((past.flatten(1), action.flatten(1)), dim=1)
        # What is to be predicted is no way to learn: it would be made easy.
        diffusion = self.denoiser.error(later.flatten(1).detach(), context).mean()
        return torch.as_tensor(error.square().mean() + 1e-3 * divergence + diffusion)


def train_tpp(play: exumi_data.Dataset, steps: int, seed: int) -> FrozenEncoder:
    """Train by predicting the touch to come, in small (see ``train_tpp.py``).

    Parameters
    ----------
    play : Dataset
    steps, seed : int
    """
    windows = TPPWindows(play, rgb=[])
    torch.manual_seed(seed)
    images = salient_images(play)
    encoder = untrained_encoder(images)
    action = windows.spec["action"].shape
    tactile = windows.spec["tactile_left"].shape
    model = _Prediction(encoder, tactile[0], tactile[0] // 2, action[0] * action[1])
    represent = TactileRepresentation()
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3)
    some = torch.linspace(0, len(windows) - 1, 256).long().tolist()
    actions = windows.__getitems__(some)["action"]
    middle, spread = actions.mean((0, 1)), actions.std((0, 1)).clamp_min(1e-4)
    sampler = ActiveWindowSampler(windows, count=steps * _BATCH, seed=seed)
    for batch in windows.loader(_BATCH, sampler=sampler):
        seen = represent(batch["tactile_left"], batch["tactile_left_reference"])
        _descend(optimizer, model.loss(seen, (batch["action"] - middle) / spread))
    return FrozenEncoder(encoder, images)


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
    side = encoder.average.shape[-1]
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
    return TactileEncoder(average, (images - average).std())
