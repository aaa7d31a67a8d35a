"""Images as Octopi-1.5's tactile encoder takes them."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from exumi_data.errors import UsageError
from exumi_loaders.device.image_module import ImageModule
from exumi_loaders.device.size import PadToSquare, Resize
from exumi_loaders.device.to_float import need_floats

__all__ = ["OCTOPI_SENSORS", "NormaliseSensor", "OctopiImages", "octopi_sensor"]

OCTOPI_SENSORS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "gelsight": ((0.46640, 0.44838, 0.45375), (0.08117, 0.07227, 0.085867)),
    "gelsightmini": ((0.20954, 0.37124, 0.40463), (0.12138, 0.06335, 0.10677)),
    "gelsightminidotted": ((0.20251, 0.36450, 0.40409), (0.12902, 0.08006, 0.11987)),
    "gelsight17": ((0.42487, 0.41575, 0.43780), (0.06776, 0.06513, 0.06871)),
    "digit": ((0.41146, 0.42410, 0.39767), (0.15062, 0.08714, 0.08073)),
}
"""Mean and standard deviation of red, green and blue in [0, 1], by Octopi-1.5's sensor names."""

_MODELS = {
    ("gelsight-mini", "plain"): "gelsightmini",
    ("gelsight-mini", "dotted"): "gelsightminidotted",
    ("gelsight-1-7", "dotted"): "gelsight17",
    ("gelsight-1-7", "plain"): "gelsight",
    ("digit", "plain"): "digit",
}


def octopi_sensor(model: str, pad_type: str = "plain") -> str:
    """Return Octopi-1.5's name of a sensor.

    Its ``gelsight`` is that of ObjectFolder and ``gelsight17`` that of the hardness collection,
    which has dots.

    Parameters
    ----------
    model : str
        Registered name, such as ``gelsight-mini``.
    pad_type : str
        ``plain`` or ``dotted``.

    Returns
    -------
    str
        A key of `OCTOPI_SENSORS`.

    Raises
    ------
    UsageError
        Octopi-1.5 has no figures for it.
    """
    try:
        return _MODELS[model, pad_type]
    except KeyError:
        known = ", ".join(f"{name} ({pad})" for name, pad in _MODELS)
        raise UsageError(
            f"Octopi-1.5 has no mean and deviation for {model!r} with a {pad_type} pad",
            fix=f"It has them for {known}.",
        ) from None


class NormaliseSensor(nn.Module):
    """Subtract the mean of a sensor's images and divide by their standard deviation.

    Parameters
    ----------
    table : dict, optional
        Mean and standard deviation of red, green and blue in [0, 1] by sensor; default
        `OCTOPI_SENSORS`.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(
        self,
        table: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]]
        | None = None,
    ) -> None:
        super().__init__()
        table = OCTOPI_SENSORS if table is None else table
        self.sensors = tuple(table)
        means, deviations = zip(*table.values(), strict=True)
        self.register_buffer("mean", torch.tensor(means), persistent=False)
        self.register_buffer("deviation", torch.tensor(deviations), persistent=False)

    def forward(self, images: Tensor, sensor: str | Sequence[str]) -> Tensor:
        """Normalise images.

        Parameters
        ----------
        images : Tensor
            (B, ..., 3, H, W), floats in [0, 1].
        sensor : str or sequence of str
            One for all, or one for each of the B.

        Returns
        -------
        Tensor

        Raises
        ------
        UsageError
            Images are no floats in colour, or a sensor is not known.
        """
        need_floats(images, "NormaliseSensor")
        if images.shape[-3] != 3:
            raise UsageError(f"images have {images.shape[-3]} channel(s); the figures are of three")
        names = [sensor] * len(images) if isinstance(sensor, str) else list(sensor)
        if len(names) != len(images):
            raise UsageError(f"{len(names)} sensors for {len(images)} windows or clips")
        shape = (len(images), *[1] * (images.ndim - 4), 3, 1, 1)
        rows = [self._row(name) for name in names]
        mean, deviation = self.mean[rows].view(shape), self.deviation[rows].view(shape)
        return ((images - mean) / deviation).to(images.dtype)

    def _row(self, name: str) -> int:
        if name not in self.sensors:
            raise UsageError(
                f"no mean and deviation for sensor {name!r}",
                fix=f"There are some for {', '.join(self.sensors)}.",
            )
        return self.sensors.index(name)


class OctopiImages(ImageModule):
    """Octopi-1.5's input: normalised by sensor, padded to a square (with the mean), 224², bicubic.

    Parameters
    ----------
    sensor : str
        A key of `OCTOPI_SENSORS`; see `octopi_sensor`.
    size : int
        224 in Octopi-1.5.
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(
        self, sensor: str, *, size: int = 224, streams: Sequence[str] | None = None
    ) -> None:
        super().__init__(streams)
        self.sensor = sensor
        self.normalise = NormaliseSensor()
        self.square = PadToSquare()
        self.resize = Resize(size, mode="bicubic")

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        frames = self.normalise(frames, self.sensor)
        still = None if reference is None else self.normalise(reference, self.sensor)
        return self.resize.transform(*self.square.transform(frames, still))
