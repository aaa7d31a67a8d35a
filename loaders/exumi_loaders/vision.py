"""Vision models as encoders of touch: CLIP-style towers with weights on this machine."""

import hashlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F  # noqa: N812  # as all of PyTorch calls it

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.store.digest import sha256_file
from exumi_loaders.encoder import Kind

__all__ = ["CLIP_STATISTICS", "OCTOPI_STATISTICS", "Statistics", "VisionEncoder"]

Statistics = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Mean and spread of red, green and blue, from 0 to 1."""

CLIP_STATISTICS: Statistics = (
    (0.48145466, 0.4578275, 0.40821073),
    (0.26862954, 0.26130258, 0.27577711),
)
"""Of the photographs that CLIP was trained with."""

OCTOPI_STATISTICS: dict[Kind, Statistics] = {
    ("gelsight", "plain"): ((0.46640, 0.44838, 0.45375), (0.08117, 0.07227, 0.085867)),
    ("gelsight-mini", "plain"): ((0.20954, 0.37124, 0.40463), (0.12138, 0.06335, 0.10677)),
    ("gelsight-mini", "dotted"): ((0.20251, 0.36450, 0.40409), (0.12902, 0.08006, 0.11987)),
    ("gelsight-2017", None): ((0.42487, 0.41575, 0.43780), (0.06776, 0.06513, 0.06871)),
    ("digit", None): ((0.41146, 0.42410, 0.39767), (0.15062, 0.08714, 0.08073)),
}
"""Of the sensors, by model and pad type, as Octopi-1.5's released code has them."""


class VisionEncoder:
    """Describe a clip by a vision model: the mean of its frames' vectors, of length 1.

    Frames are brought to what Octopi-1.5 feeds its encoder with: normalised by the statistics of
    their sensor, padded with zeros to a square, resized to `size` (bicubic, antialiased). Grey
    frames are taken as three equal channels. The reference plays no part.

    Parameters
    ----------
    model : torch.nn.Module or path-like
        A module that turns (N, 3, S, S) float32 into (N, D), or a TorchScript file of one. Only
        open TorchScript files that you trust: they are programs.
    weights : path-like, optional
        A state dict for `model`, read with ``weights_only=True``.
    name : str
        Name and version, part of the digest.
    output : str, optional
        Attribute of what the model returns that holds the vectors, such as ``image_embeds``.
    statistics : mapping of (sensor model, pad type) to Statistics
        ``(model, None)`` stands for any pad type, ``(None, None)`` for any sensor.
    size : int
        Pixels of a side.
    batch : int
        Frames at a time.
    device : str
        Where the model runs.

    Raises
    ------
    UsageError
        The weights do not fit the model, or it does not give (N, D).
    DamagedDataError
        A file cannot be read.

    Examples
    --------
    >>> encoder = VisionEncoder(tower, weights="octopi-tower.pt")  # doctest: +SKIP
    >>> index = TactileIndex.build(dataset, encoder, path="my-index")  # doctest: +SKIP
    """

    whitening: int | None = None

    def __init__(
        self,
        model: torch.nn.Module | str | Path,
        *,
        weights: str | Path | None = None,
        name: str = "vision/1",
        output: str | None = None,
        statistics: Mapping[Kind, Statistics] | None = None,
        size: int = 224,
        batch: int = 64,
        device: str = "cpu",
    ) -> None:
        if size < 1 or batch < 1:
            raise UsageError(f"size is {size} and batch {batch}; both must be positive")
        self.name = name
        self._output = output
        self._size, self._batch, self._device = size, batch, device
        default = {**OCTOPI_STATISTICS, (None, None): CLIP_STATISTICS}
        self._statistics = dict(default if statistics is None else statistics)
        self._module, weighed = _loaded(model, weights)
        self._module = self._module.eval().to(device)
        self._digest = self._settings(weighed)
        self._dimension = self._forward(torch.zeros(1, 3, size, size)).shape[1]

    def _settings(self, weighed: str) -> str:
        kinds = sorted(self._statistics.items(), key=repr)
        settings = hashlib.sha256(repr((kinds, self._size, self._output)).encode()).hexdigest()
        return f"{self.name}?weights={weighed[:32]}&settings={settings[:16]}"

    @property
    def digest(self) -> str:
        """Name, digest of the weights, and of the settings."""
        return self._digest

    @property
    def dimension(self) -> int:
        """Numbers of a vector."""
        return self._dimension

    def encode(
        self,
        frames: np.ndarray,
        reference: np.ndarray | None = None,
        *,
        kind: Kind = (None, None),
    ) -> np.ndarray:
        """Describe a clip.

        Parameters
        ----------
        frames : (N, H, W, C) uint8
            C is 1 or 3.
        reference : (H, W, C) uint8, optional
            Plays no part.
        kind : (str or None, str or None)
            Sensor model and pad type: decides the statistics.

        Returns
        -------
        (D,) float32
            Of length 1.

        Raises
        ------
        UsageError
            No frames, another number of channels, or no statistics for the sensor.
        """
        if not len(frames) or frames.shape[3] not in (1, 3):
            raise UsageError(f"frames are {frames.shape}, expected (N, H, W, 1 or 3)")
        total = torch.zeros(self._dimension, dtype=torch.float64)
        for start in range(0, len(frames), self._batch):
            batch = self.prepare(frames[start : start + self._batch], kind=kind)
            total += self._forward(batch).double().sum(0)
        vector = total / max(float(total.norm()), 1e-12)
        return vector.float().numpy()

    def prepare(self, frames: np.ndarray, *, kind: Kind = (None, None)) -> torch.Tensor:
        """Bring frames to what the model takes.

        Parameters
        ----------
        frames : (N, H, W, C) uint8
        kind : (str or None, str or None)

        Returns
        -------
        (N, 3, S, S) float32
        """
        mean, spread = self._statistics_of(kind)
        images = torch.from_numpy(np.array(frames)).movedim(-1, 1).float() / 255
        if images.shape[1] == 1:
            images = images.expand(-1, 3, -1, -1)
        images = (images - torch.tensor(mean)[:, None, None]) / torch.tensor(spread)[:, None, None]
        high, wide = images.shape[-2:]
        down, right = max(0, wide - high), max(0, high - wide)
        padding = (right // 2, right - right // 2, down // 2, down - down // 2)
        images = F.pad(images, padding)
        size = (self._size, self._size)
        return F.interpolate(images, size, mode="bicubic", antialias=True)

    def _statistics_of(self, kind: Kind) -> Statistics:
        for known in (kind, (kind[0], None), (None, None)):
            if known in self._statistics:
                return self._statistics[known]
        raise UsageError(
            f"no statistics for sensor {kind[0]!r} with pad type {kind[1]!r}",
            fix="Give them, or those of any sensor under (None, None).",
        )

    @torch.inference_mode()
    def _forward(self, images: torch.Tensor) -> torch.Tensor:
        found: Any = self._module(images.to(self._device))
        if self._output is not None:
            found = found[self._output] if isinstance(found, dict) else getattr(found, self._output)
        if not isinstance(found, torch.Tensor) or found.ndim != 2 or len(found) != len(images):
            given = tuple(found.shape) if isinstance(found, torch.Tensor) else type(found).__name__
            raise UsageError(
                f"the model gives {given}, expected ({len(images)}, D)",
                fix="Name the part that holds the vectors with output=.",
            )
        return found.float().cpu()


def _loaded(
    model: torch.nn.Module | str | Path, weights: str | Path | None
) -> tuple[torch.nn.Module, str]:
    """Return a module, and the digest of its weights."""
    if not isinstance(model, torch.nn.Module):
        if weights is not None:
            raise UsageError("weights belong to a module; a TorchScript file has its own")
        try:
            digest = sha256_file(Path(model))
            with warnings.catch_warnings():
                # PyTorch would rather have other formats; these files are there.
                warnings.simplefilter("ignore", DeprecationWarning)
                script: torch.nn.Module = torch.jit.load(str(model), map_location="cpu")  # type: ignore[no-untyped-call]  # PyTorch does not say
            return script, digest
        except (RuntimeError, ValueError) as error:
            raise DamagedDataError(f"no TorchScript file ({_first(error)})", where=model) from None
    if weights is not None:
        _load_weights(model, Path(weights))
    state = hashlib.sha256(type(model).__qualname__.encode())
    for key, value in sorted(model.state_dict().items()):
        state.update(f"\n{key} {tuple(value.shape)} {value.dtype}\n".encode())
        state.update(value.detach().cpu().contiguous().flatten().view(torch.uint8).numpy())
    return model, state.hexdigest()


def _load_weights(model: torch.nn.Module, path: Path) -> None:
    try:
        values = torch.load(path, map_location="cpu", weights_only=True)
        model.load_state_dict(values)
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001  # whatever the reader of a stranger's file raises
        raise UsageError(f"the weights do not fit ({_first(error)})", where=path) from None


def _first(error: Exception) -> str:
    return str(error).strip().partition("\n")[0][:200]
