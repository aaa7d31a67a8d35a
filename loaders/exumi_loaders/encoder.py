"""What turns the frames of a clip into a vector; an index is made with one."""

from typing import Protocol, runtime_checkable

import numpy as np

__all__ = ["Encoder", "Kind"]

Kind = tuple[str | None, str | None]
"""Sensor model and pad type, where they are known."""


@runtime_checkable
class Encoder(Protocol):
    """What an index asks of an encoder. One of your own needs no base class."""

    @property
    def name(self) -> str:
        """Name and version, such as ``exumi-texture/1``."""
        ...

    @property
    def digest(self) -> str:
        """What changes whenever the vectors do: name, settings, weights."""
        ...

    @property
    def dimension(self) -> int:
        """Numbers of a vector."""
        ...

    @property
    def whitening(self) -> int | None:
        """Dimensions that an index whitens the vectors to; None where it leaves them alone."""
        ...

    def encode(
        self, frames: np.ndarray, reference: np.ndarray | None, *, kind: Kind = (None, None)
    ) -> np.ndarray:
        """Turn frames (N, H, W, C) uint8 and a reference (H, W, C) uint8 into (D,) float32."""
        ...
