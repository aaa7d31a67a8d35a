"""The frames of a TACNIQ TAC-02, as the makers of Octopi's hand-held gripper read them.

A frame is one USB transfer of 102 bytes (at full speed a packet of 64 and one of 38): 68 words of
12 bits, the higher nibbles first. The first 64 words are cells; what the last four are is not
published. There is no header, no counter, no time and no check sum, so where a frame begins is
known from the transfer alone, or from the pause before it.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

__all__ = ["CELLS", "FRAME_BYTES", "GRID", "OFFSET", "VALID", "FrameCutter", "decode", "encode"]

FRAME_BYTES = 102
_WORDS = 68
OFFSET = 3500
"""A cell without contact; its value falls as the force grows."""

_NONE = -1
CELLS: NDArray[np.intp] = np.array(
    [
        [_NONE, 31, 22, 40, 2, _NONE],
        [63, 26, 24, 6, 4, 0],
        [51, 27, 49, 14, 41, 13],
        [16, 53, 17, 46, 42, 45],
        [23, 62, 57, 38, 33, 1],
        [29, 59, 19, 11, 5, 3],
        [28, 20, 56, 39, 10, 35],
        [21, 55, 54, 7, 8, 12],
        [30, 58, 18, 47, 36, 32],
        [61, 25, 48, 15, 37, 34],
        [60, 52, 50, 44, 43, 9],
    ]
)
"""Which word each cell is, from clear-nus/tacniq_ros (``scripts/tacniq.py``); -1 is no cell."""

GRID = (11, 6)
VALID: NDArray[np.bool_] = CELLS != _NONE
"""Which cells are alive: all but two corners."""


def decode(frames: bytes) -> NDArray[np.int16]:
    """Return the cells' values of whole frames, as the device gave them.

    Parameters
    ----------
    frames : bytes
        N frames of 102 bytes.

    Returns
    -------
    ndarray of int16, shape (N, 11, 6)
        Steps of the device's converter; where there is no cell, the value without contact.
    """
    three = np.frombuffer(frames, np.uint8).reshape(-1, _WORDS // 2, 3).astype(np.int16)
    words = np.empty((len(three), _WORDS), np.int16)
    words[:, 0::2] = three[:, :, 0] << 4 | three[:, :, 1] >> 4
    words[:, 1::2] = (three[:, :, 1] & 0x0F) << 8 | three[:, :, 2]
    values = words[:, CELLS]
    values[:, ~VALID] = OFFSET
    return values


def encode(values: NDArray[np.int16]) -> bytes:
    """Return the frames of some values: the reverse of `decode`; the last four words are 0.

    Parameters
    ----------
    values : ndarray of int16, shape (N, 11, 6)
        0 to 4095.
    """
    words = np.zeros((len(values), _WORDS), np.uint16)
    words[:, CELLS[VALID]] = values[:, VALID]
    first, second = words[:, 0::2], words[:, 1::2]
    three = np.stack([first >> 4, (first & 0x0F) << 4 | second >> 8, second & 0xFF], axis=-1)
    return three.astype(np.uint8).tobytes()


class FrameCutter:
    """Cuts what arrives into frames.

    Bytes that come without a pause between them are a burst, and a burst is some whole frames. One
    that is not is refused as a whole when the pause after it comes: where in it a byte is missing
    or too many cannot be known.

    Attributes
    ----------
    refused : int
        Frames that were refused; a part of one counts as one.
    """

    # A burst that does not end: the reader is so late that it sees no pause any more.
    _MOST_BYTES = 64 * FRAME_BYTES

    def __init__(self) -> None:
        self.refused = 0
        self._held = bytearray()
        self._ends: deque[tuple[int, int]] = deque()

    @property
    def is_within(self) -> bool:
        """Whether a burst has begun that is no whole number of frames yet."""
        return bool(self._held)

    @property
    def held_bytes(self) -> int:
        """How long that burst is by now."""
        return len(self._held)

    def feed(self, chunk: bytes, time_ns: int) -> list[tuple[int, bytes]]:
        """Take what arrived at a time; return whole frames, each with when its last byte came.

        Parameters
        ----------
        chunk : bytes
        time_ns : int

        Returns
        -------
        list of (int, bytes)
        """
        self._held += chunk
        self._ends.append((len(self._held), time_ns))
        if len(self._held) % FRAME_BYTES:
            if len(self._held) > self._MOST_BYTES:
                self.pause()
            return []
        frames = []
        for start in range(0, len(self._held), FRAME_BYTES):
            while self._ends[0][0] < start + FRAME_BYTES:
                self._ends.popleft()
            frames.append((self._ends[0][1], bytes(self._held[start : start + FRAME_BYTES])))
        self._clear()
        return frames

    def pause(self) -> None:
        """Take note of a pause: what is held by now is no whole number of frames."""
        self.refused += -(-len(self._held) // FRAME_BYTES)
        self._clear()

    def _clear(self) -> None:
        self._held.clear()
        self._ends.clear()
