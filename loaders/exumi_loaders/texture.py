"""An encoder of touch that needs no weights: the statistics of what changed, over scales."""

from typing import Protocol

import numpy as np

from exumi_data.errors import UsageError

__all__ = ["Encoder", "TextureEncoder"]

_LEVELS = 5
_PERCENTILES = (90, 99)
_LOW_SCALE = 10.0  # levels of the coarsest image to numbers of the size of the others
_TINY = 1e-6


class Encoder(Protocol):
    """What turns the frames of a clip into a vector; an index is made with one."""

    @property
    def name(self) -> str:
        """Name and version."""
        ...

    @property
    def digest(self) -> str:
        """What changes whenever the vectors do."""
        ...

    def encode(self, frames: np.ndarray, reference: np.ndarray | None) -> np.ndarray:
        """Turn frames (N, H, W, C) uint8 and a reference (H, W, C) uint8 into (D,) float32."""
        ...


class TextureEncoder:
    """Statistics of reference-subtracted frames in the bands of a Laplacian pyramid.

    Of each frame and band: mean, 90th and 99th percentile of the magnitude in each channel, and
    the energy and direction of gradients; of the coarsest image its mean and spread. Of the
    clip: mean, largest and spread of all these over its frames. The vector's numbers have
    different scales: an index whitens them.

    Parameters
    ----------
    channels : {1, 3}
        Of the frames. Grey and colour frames give vectors that cannot be compared.
    """

    name = "exumi-texture/1"

    def __init__(self, channels: int = 3) -> None:
        if channels not in (1, 3):
            raise UsageError(f"invalid channels ({channels}). Supported values are 1, 3")
        self.channels = channels

    @property
    def digest(self) -> str:
        """Name and version say it all, with the number of channels."""
        return f"{self.name}?channels={self.channels}"

    def encode(self, frames: np.ndarray, reference: np.ndarray | None) -> np.ndarray:
        """Describe a clip.

        Parameters
        ----------
        frames : (N, H, W, C) uint8
            Frames of touch, such as the salient ones of a clip.
        reference : (H, W, C) uint8
            The image without contact.

        Returns
        -------
        (D,) float32
            D is 234 of colour frames and 114 of grey ones.

        Raises
        ------
        UsageError
            No frames, no reference, or another number of channels.
        """
        if reference is None:
            raise UsageError(f"{self.name} needs the image without contact (reference)")
        if not len(frames):
            raise UsageError(f"{self.name} needs at least one frame")
        if frames.shape[3] != self.channels or reference.shape[2] != self.channels:
            raise UsageError(
                f"frames have {frames.shape[3]} channel(s) and the reference "
                f"{reference.shape[2]}; this encoder was made for {self.channels}"
            )
        rest = reference.astype(np.float32)
        described = np.stack([_describe(frame.astype(np.float32) - rest) for frame in frames])
        pooled = (described.mean(0), described.max(0), described.std(0))
        return np.concatenate(pooled).astype(np.float32)


def _describe(change: np.ndarray) -> np.ndarray:
    """Describe one frame's change (H, W, C) float32."""
    bands, low = _pyramid(change)
    found = [np.concatenate((_magnitudes(band), _directions(band))) for band in (*bands, low)]
    pixels = low.reshape(-1, low.shape[2])
    found += [pixels.mean(0) / _LOW_SCALE, pixels.std(0) / _LOW_SCALE]
    return np.concatenate(found)


def _pyramid(image: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    import cv2

    bands = []
    for _ in range(_LEVELS):
        low = cv2.pyrDown(image)
        wide = cv2.pyrUp(low, dstsize=(image.shape[1], image.shape[0]))
        bands.append(image - wide.reshape(image.shape))
        image = low.reshape((*low.shape[:2], image.shape[2]))
    return bands, image


def _magnitudes(band: np.ndarray) -> np.ndarray:
    size = np.abs(band).reshape(-1, band.shape[2])
    found = np.concatenate((size.mean(0), *np.percentile(size, _PERCENTILES, axis=0)))
    return np.asarray(np.log1p(found))


def _directions(band: np.ndarray) -> np.ndarray:
    grey = band.mean(2)
    across, down = np.diff(grey, axis=1)[:-1], np.diff(grey, axis=0)[:, :-1]
    both, x, y = (across * down).mean(), (across**2).mean(), (down**2).mean()
    return np.array([np.log1p(x), np.log1p(y), both / (x + y + _TINY)])
