"""Going through a stream's numbers in blocks, so that memory does not grow with its length."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from exumi_data.episode import StreamView
from exumi_data.standard import flags

__all__ = ["STEPS", "step_of", "valid_blocks"]

STEPS = 40
"""Equal parts of an episode in which what happens over time is counted."""

_BLOCK_BYTES = 4 << 20
_BLOCK_ROWS = 65_536


def valid_blocks(
    stream: StreamView, row_bytes: int = 64
) -> Iterator[tuple[slice, npt.NDArray[np.float64], npt.NDArray[np.bool_]]]:
    """Yield the data in bounded blocks.

    Parameters
    ----------
    stream : StreamView
    row_bytes : int
        Of a sample, as float64.

    Yields
    ------
    slice
        Which samples.
    (n, ...) float64
        Their data.
    (n,) bool
        Which of them are not flagged as invalid.
    """
    invalid = np.uint32(1 << flags()["invalid"].bit)
    flagged = "flags" in stream.metadata.arrays
    rows = max(1, min(_BLOCK_ROWS, _BLOCK_BYTES // row_bytes))
    for begin in range(0, len(stream), rows):
        end = min(begin + rows, len(stream))
        data = np.asarray(stream.rows("data", begin, end), np.float64)
        valid = np.ones(len(data), np.bool_)
        if flagged:
            valid = (stream.rows("flags", begin, end) & invalid) == 0
        yield slice(begin, end), data, valid


def step_of(
    time: npt.NDArray[np.int64], span: tuple[int, int], steps: int
) -> npt.NDArray[np.int64]:
    """Return in which of equal parts of an episode times lie, (N,) int64.

    Parameters
    ----------
    time : (N,) int64
    span : (int, int)
        First and last time of the episode, ns.
    steps : int
    """
    share = (time - span[0]) / max(span[1] - span[0], 1)
    return np.clip((share * steps).astype(np.int64), 0, steps - 1)
