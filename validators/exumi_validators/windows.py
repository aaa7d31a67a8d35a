"""Reading a stream in windows of a fixed number of samples.

What is judged by medians (a period, a usual step) must not depend on how arrays are chunked or on
how much a program reads at once. So the windows are part of the standard: see
``spec/1.0/quality.md``.
"""

from collections.abc import Iterator

import numpy as np

from exumi_validators.context import EpisodeContext

__all__ = ["carried_samples", "windows"]

# The limits of the windows of all rules stand with this one.
_RULE = "TIME-005"


def carried_samples(episode: EpisodeContext) -> int:
    """Return how many samples of the window before are judged with a window.

    So that none is too short.
    """
    return max(1, int(episode.limit(_RULE, "carried_samples")))


def windows(episode: EpisodeContext, *paths: str) -> Iterator[tuple[int, tuple[np.ndarray, ...]]]:
    """Read arrays of equal length side by side, always so many samples at a time.

    Parameters
    ----------
    episode : EpisodeContext
    *paths : str

    Yields
    ------
    start : int
    rows : tuple of ndarray
        One window of each array.
    """
    samples = max(1, int(episode.limit(_RULE, "window_samples")))
    first, held = 0, 0
    parts: list[tuple[np.ndarray, ...]] = []
    for _, block in episode.blocks(*paths):
        at, count = 0, len(block[0])
        while held + count - at >= samples:
            take = samples - held
            yield first, _joined([*parts, tuple(rows[at : at + take] for rows in block)])
            first, at, held = first + samples, at + take, 0
            parts.clear()
        if at < count:
            parts.append(tuple(rows[at:] for rows in block))
            held += count - at
    if held:
        yield first, _joined(parts)


def _joined(parts: list[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Return blocks of several arrays as one."""
    if len(parts) == 1:
        return parts[0]
    return tuple(np.concatenate(rows) for rows in zip(*parts, strict=True))
