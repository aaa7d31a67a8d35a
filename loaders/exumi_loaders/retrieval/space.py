"""The space in which an index compares: its encoder's vectors, whitened, of length 1."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from exumi_data.errors import UsageError

__all__ = ["METHOD", "Space", "fit_space", "unit"]

METHOD: Final = "half-whitening/1"
_RANK = 1e-9  # eigenvalues below this share of the largest are rounding
_TINY = 1e-12


@dataclass(frozen=True)
class Space:
    """A linear map that makes vectors comparable by their angle.

    Attributes
    ----------
    mean : (D,) float32
        Taken from a vector first.
    matrix : (D, d) float32
        Then multiplied by it.
    """

    mean: np.ndarray
    matrix: np.ndarray

    def place(self, vectors: np.ndarray) -> np.ndarray:
        """Map vectors of an encoder into the space.

        Parameters
        ----------
        vectors : (B, D) float32

        Returns
        -------
        (B, d) float32
            Of length 1; zeros for a vector that is the mean.
        """
        return unit((vectors - self.mean) @ self.matrix)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scale vectors (..., d) to length 1, as float32; zeros stay zeros."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, _TINY), dtype=np.float32)


def fit_space(vectors: np.ndarray, dimensions: int) -> Space:
    """Fit a space to the clips that an index is made of. It asks for no label.

    Each number of a vector is brought to mean 0 and spread 1; then the directions of largest
    spread are kept, each divided by the square root of its spread. That is half-way to whitening:
    without it, a few directions decide everything; with all of it, noise decides as much as touch.

    Parameters
    ----------
    vectors : (N, D) float32
    dimensions : int
        Directions to keep. There are no more than clips less one.

    Returns
    -------
    Space

    Raises
    ------
    UsageError
        There are fewer than two different vectors.
    """
    values = vectors.astype(np.float64)
    mean = values.mean(0)
    spread = values.std(0)
    scale = np.where(spread > _TINY, 1 / np.maximum(spread, _TINY), 0)
    scaled = (values - mean) * scale
    power, directions = np.linalg.eigh(scaled.T @ scaled / max(1, len(values)))
    order = np.argsort(power)[::-1][: min(dimensions, max(0, len(values) - 1))]
    order = order[power[order] > _RANK * max(power[-1], _TINY)]
    if len(values) < 2 or power[-1] <= _TINY or not len(order):
        raise UsageError(
            "an index needs at least two clips that differ", fix="Build it from more clips."
        )
    # The square root of a spread: a fourth root of the power along a direction.
    matrix = scale[:, None] * directions[:, order] / power[order] ** 0.25
    # A direction has no sign of its own: this one is the same on all machines.
    matrix *= np.where(matrix[np.abs(matrix).argmax(0), np.arange(matrix.shape[1])] < 0, -1, 1)
    return Space(mean.astype(np.float32), matrix.astype(np.float32))
