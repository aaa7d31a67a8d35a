"""A 12-bit magnetic encoder on the gripper's width, whose counts wrap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["WidthEncoder"]


@dataclass(frozen=True, slots=True)
class WidthEncoder:
    """The linear relation between encoder counts and gripper width.

    As on exUMI's gripper, zero width is not count zero, and the counts run over the wrap within
    the gripper's travel: with these numbers at a width of 25 mm.

    Attributes
    ----------
    zero_count : int
        Count at zero width.
    counts_per_m : float
        Counts per metre of width.
    bits : int
        Resolution of the encoder; counts are modulo ``2**bits``.
    """

    zero_count: int = 3946
    counts_per_m: float = 6000.0
    bits: int = 12

    def counts(self, width_m: ArrayLike) -> NDArray[np.uint16]:
        """Return the wrapped counts for widths.

        Parameters
        ----------
        width_m : array_like, shape (N,)
            Widths, metres.

        Returns
        -------
        ndarray of uint16, shape (N,)
            Counts, less than ``2**bits``.
        """
        turned = np.round(np.asarray(width_m, dtype=np.float64) * self.counts_per_m)
        wrapped = (turned.astype(np.int64) + self.zero_count) % (1 << self.bits)
        return wrapped.astype(np.uint16)

    def width_m(self, counts: ArrayLike) -> NDArray[np.float32]:
        """Return the widths for wrapped counts.

        The travel is much shorter than one turn, so a count belongs to one width only; an eighth
        of a turn below zero width stands for slightly negative widths.

        Parameters
        ----------
        counts : array_like, shape (N,)
            Wrapped counts.

        Returns
        -------
        ndarray of float32, shape (N,)
            Widths, metres.
        """
        turn = 1 << self.bits
        below = turn // 8
        unwrapped = (np.asarray(counts, dtype=np.int64) - self.zero_count + below) % turn - below
        return (unwrapped / self.counts_per_m).astype(np.float32)
