"""Range, mean and deviation of the channels of windows, gathered in one pass."""

from collections.abc import Iterable

import numpy as np

__all__ = ["ChannelStatistics"]


class ChannelStatistics:
    """Statistics of C channels, gathered block by block.

    Parameters
    ----------
    channels : int

    Attributes
    ----------
    count : int
    minimum, maximum, mean : (C,) float64
    """

    def __init__(self, channels: int) -> None:
        self.count = 0
        self.minimum = np.full(channels, np.inf)
        self.maximum = np.full(channels, -np.inf)
        self.mean = np.zeros(channels)
        self._squares = np.zeros(channels)

    @property
    def deviation(self) -> np.ndarray:
        """(C,) float64: standard deviation of the population."""
        return np.asarray(np.sqrt(self._squares / max(self.count, 1)))

    def add(self, values: np.ndarray) -> None:
        """Take in a block.

        Parameters
        ----------
        values : (N, C)
        """
        if not len(values):
            return
        block = values.astype(np.float64)
        total = self.count + len(block)
        mean = block.mean(axis=0)
        shift = mean - self.mean
        # Chan et al. (1983): exact for blocks of any size, without the loss of a sum of squares.
        self._squares += ((block - mean) ** 2).sum(axis=0)
        self._squares += shift**2 * (self.count * len(block) / total)
        self.mean += shift * (len(block) / total)
        self.minimum = np.minimum(self.minimum, block.min(axis=0))
        self.maximum = np.maximum(self.maximum, block.max(axis=0))
        self.count = total

    @staticmethod
    def of(blocks: Iterable[np.ndarray], channels: int) -> "ChannelStatistics":
        """Gather the statistics of all blocks.

        Parameters
        ----------
        blocks : iterable of (N, C) arrays
        channels : int
        """
        statistics = ChannelStatistics(channels)
        for block in blocks:
            statistics.add(block)
        return statistics
