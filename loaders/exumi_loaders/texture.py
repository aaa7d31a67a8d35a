"""An encoder of touch that needs no weights: the statistics of what changed, over scales."""

from math import gcd

import numpy as np

from exumi_data.errors import UsageError
from exumi_loaders.encoder import Kind

__all__ = ["TextureEncoder"]

_LEVELS = 5
_SHARES = (0.90, 0.99)
_SAMPLE = 8192  # pixels of a band that percentiles are told from
_LOW_SCALE = 10.0  # levels of the coarsest image to numbers of the size of the others
_TINY = 1e-6


class TextureEncoder:
    """Statistics of reference-subtracted frames in the bands of a Laplacian pyramid.

    Of each frame and band: mean, 90th and 99th percentile of the magnitude in each channel, and
    the energy and direction of gradients; of the coarsest image its mean and spread. Of the
    clip: mean, largest and spread of all these over its frames. The vector's numbers have
    different scales: an index whitens them. Percentiles are told from 8192 pixels of a band at
    least, evenly spread.

    Parameters
    ----------
    channels : {1, 3}
        Of the frames. Grey and colour frames give vectors that cannot be compared.
    """

    name = "exumi-texture/1"
    whitening: int | None = 48

    def __init__(self, channels: int = 3) -> None:
        if channels not in (1, 3):
            raise UsageError(f"invalid channels ({channels}). Supported values are 1, 3")
        self.channels = channels

    @property
    def dimension(self) -> int:
        """Numbers of a vector: 234 of colour frames, 114 of grey ones."""
        per_band = (1 + len(_SHARES)) * self.channels + 3
        return 3 * ((_LEVELS + 1) * per_band + 2 * self.channels)

    @property
    def digest(self) -> str:
        """Name and version say it all, with the number of channels."""
        return f"{self.name}?channels={self.channels}"

    def encode(
        self, frames: np.ndarray, reference: np.ndarray | None, *, kind: Kind = (None, None)
    ) -> np.ndarray:
        """Describe a clip.

        Parameters
        ----------
        frames : (N, H, W, C) uint8
            Frames of touch, such as the salient ones of a clip.
        reference : (H, W, C) uint8
            The image without contact.
        kind : (str or None, str or None)
            Sensor model and pad type; plays no part.

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
                f"{reference.shape[2]}; this encoder was made for {self.channels}",
                fix="Give clips as those of the index are: exumi prepare, with or without --gray.",
            )
        if frames.shape[1:] != reference.shape:
            raise UsageError(f"frames of {frames.shape[1:]}, but a reference of {reference.shape}")
        described = np.stack([_describe(_change(frame, reference)) for frame in frames])
        pooled = (described.mean(0), described.max(0), described.std(0))
        return np.concatenate(pooled).astype(np.float32)


def _change(frame: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Subtract the reference, (H, W, C) float32. OpenCV drops an axis of length 1."""
    import cv2

    return cv2.subtract(frame, reference, dtype=cv2.CV_32F).reshape(frame.shape)


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
    """Return mean, 90th and 99th percentile of the magnitude, of each channel: (3 C,)."""
    import cv2

    channels = band.shape[2]
    pixels = band.reshape(-1, channels)
    mean = [cv2.norm(plane, cv2.NORM_L1) / len(pixels) for plane in cv2.split(band)]
    # Finding the percentiles of every pixel is most of the work of a clip.
    sample = np.abs(pixels[:: _step(len(pixels), band.shape[1])].T, order="C")
    places = [round(share * (sample.shape[1] - 1)) for share in _SHARES]
    sample.partition(places, axis=1)
    return np.log1p(np.concatenate((mean, *(sample[:, place] for place in places))))


def _step(pixels: int, width: int) -> int:
    """Return a distance of pixels that leaves enough of them, and is none of columns."""
    step = max(1, pixels // _SAMPLE)
    while step > 1 and gcd(step, width) > 1:
        step -= 1
    return step


def _directions(band: np.ndarray) -> np.ndarray:
    """Return the energy of gradients across and down, and how far they go together: (3,)."""
    import cv2

    channels = band.shape[2]
    grey = cv2.transform(band, np.full((1, channels), 1 / channels, np.float32))
    grey = grey.reshape(band.shape[:2])
    corner = grey[:-1, :-1]
    across, down = (grey[:-1, 1:] - corner).ravel(), (grey[1:, :-1] - corner).ravel()
    count = max(1, across.size)
    both, x, y = across @ down / count, across @ across / count, down @ down / count
    return np.array([np.log1p(x), np.log1p(y), both / (x + y + _TINY)])
