"""Images that are differences computed in uint8: 252 stands near 3 where they wrapped."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

__all__ = ["Jumps"]

_JUMP = 128
_STEP = 64

UInt8Array = npt.NDArray[np.uint8]


@dataclass(slots=True)
class Jumps:
    """Steps of grey level between near pixels of a row, channel by channel.

    Attributes
    ----------
    rows : int
        How many rows of a frame are looked through, about.
    apart_px : int
        How far apart the pixels are: chroma that was stored at half the resolution spreads an
        edge over two.
    pairs : int
        Pairs of pixels in one channel.
    steps, jumps : ndarray of int64, shape (C,)
        Pairs that differ by 65 to 128 levels, and by more.
    """

    rows: int
    apart_px: int
    pairs: int = 0
    steps: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    jumps: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))

    def add(self, frame: UInt8Array) -> None:
        """Look through a frame, (H, W, C)."""
        import cv2

        every = max(1, frame.shape[0] // self.rows)
        rows = np.ascontiguousarray(frame[every // 2 :: every])
        if rows.shape[1] <= self.apart_px:
            return
        apart = self.apart_px
        step = np.asarray(cv2.absdiff(rows[:, apart:], rows[:, :-apart]), np.uint8)
        step = step.reshape(-1, frame.shape[2])
        self.pairs += len(step)
        if step.max() <= _STEP:  # as in most frames
            return
        for channel in range(step.shape[1]):
            jumps = np.count_nonzero(step[:, channel] > _JUMP)
            self.jumps[channel] += jumps
            self.steps[channel] += np.count_nonzero(step[:, channel] > _STEP) - jumps

    def rates(self) -> tuple[float, float]:
        """Return jumps of 10,000 pairs of pixels, and jumps a step, in the channel with most."""
        channel = int(self.jumps.argmax())
        jumps, steps = int(self.jumps[channel]), int(self.steps[channel])
        return jumps * 1e4 / max(self.pairs, 1), jumps / max(steps, 1)
