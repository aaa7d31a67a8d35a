"""The statistics that LeRobot keeps of every feature, of an episode and of all of them.

The same keys, shapes and sampled frames as ``lerobot.datasets.compute_stats``; quantiles are those
of the values themselves, not of a histogram of them.
"""

from typing import Any

import numpy as np

__all__ = ["ImageStatistics", "Statistics", "Totals", "sampled_frames", "vector_statistics"]

Statistics = dict[str, list[Any]]
"""min, max, mean, std, count and q01 to q99 of one feature, as lists."""

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_LEVELS = 256
_FEWEST, _MOST, _POWER = 100, 10_000, 0.75
_SMALL_SIDE, _TARGET_SIDE = 300, 150


def sampled_frames(count: int) -> np.ndarray:
    """Return which of an episode's frames are looked at, ascending.

    Parameters
    ----------
    count : int
        Its frames.
    """
    wanted = max(min(_FEWEST, count), min(int(count**_POWER), _MOST))
    return np.unique(np.round(np.linspace(0, count - 1, wanted)).astype(np.int64))


def vector_statistics(values: np.ndarray) -> Statistics:
    """Return the statistics of numbers.

    Parameters
    ----------
    values : (N,) or (N, C)
        N at least 1.
    """
    table = values.reshape(len(values), -1)
    numbers = table.astype(np.float64)
    found: Statistics = {
        "min": table.min(axis=0).tolist(),
        "max": table.max(axis=0).tolist(),
        "mean": numbers.mean(axis=0).tolist(),
        "std": numbers.std(axis=0).tolist(),
        "count": [len(values)],
    }
    quantiles = np.quantile(numbers, list(_QUANTILES.values()), axis=0, method="inverted_cdf")
    return {**found, **dict(zip(_QUANTILES, quantiles.tolist(), strict=True))}


class ImageStatistics:
    """Counts the grey levels of the frames that it is shown, and makes statistics of them."""

    def __init__(self) -> None:
        self._levels = np.zeros((3, _LEVELS), np.int64)
        self._frames = 0

    def add(self, frame: np.ndarray) -> None:
        """Look at a frame.

        Parameters
        ----------
        frame : (H, W, 3) uint8
        """
        height, width = frame.shape[:2]
        if max(height, width) >= _SMALL_SIDE:
            step = int(max(height, width) / _TARGET_SIDE)
            frame = frame[::step, ::step]
        for channel in range(3):
            self._levels[channel] += np.bincount(frame[..., channel].ravel(), minlength=_LEVELS)
        self._frames += 1

    def finish(self) -> Statistics:
        """Return the statistics: levels from 0 to 1, of the shape (3, 1, 1)."""
        counted = self._levels.cumsum(axis=1)
        total = counted[:, -1:]
        levels = np.arange(_LEVELS, dtype=np.float64)
        mean = (self._levels * levels).sum(axis=1, keepdims=True) / total
        spread = (self._levels * (levels - mean) ** 2).sum(axis=1, keepdims=True) / total
        seen = self._levels > 0
        found = {
            "min": seen.argmax(axis=1)[:, None],
            "max": _LEVELS - 1 - seen[:, ::-1].argmax(axis=1)[:, None],
            "mean": mean,
            "std": np.sqrt(spread),
        }
        for name, share in _QUANTILES.items():
            found[name] = (counted >= share * total).argmax(axis=1)[:, None]
        shaped = {name: (value / 255.0).reshape(3, 1, 1).tolist() for name, value in found.items()}
        return {**shaped, "count": [self._frames]}


class Totals:
    """The statistics of all episodes, put together from theirs one by one."""

    def __init__(self) -> None:
        self._count = 0
        self._found: dict[str, np.ndarray] = {}

    def add(self, statistics: Statistics) -> None:
        """Take those of the next episode.

        Parameters
        ----------
        statistics : dict
        """
        new = {key: np.asarray(value) for key, value in statistics.items() if key != "count"}
        count = int(statistics["count"][0])
        if not self._count:
            self._found, self._count = new, count
            return
        old, share = self._found, count / (self._count + count)
        step = new["mean"] - old["mean"]
        variance = old["std"] ** 2 + share * (new["std"] ** 2 - old["std"] ** 2)
        merged = {
            "min": np.minimum(old["min"], new["min"]),
            "max": np.maximum(old["max"], new["max"]),
            "std": np.sqrt(variance + share * (1 - share) * step**2),
        }
        # LeRobot weighs quantiles by counts, as it does means.
        weighed = {key: old[key] + share * (new[key] - old[key]) for key in ("mean", *_QUANTILES)}
        self._found, self._count = {**merged, **weighed}, self._count + count

    def finish(self) -> Statistics:
        """Return the statistics of all."""
        found = {key: value.tolist() for key, value in self._found.items()}
        return {**found, "count": [self._count]}
