"""What a simulated finger and camera show. Every picture bears its number, for tests to read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from exumi_data.clips.markers import MarkerSettings
from exumi_data.simulation.sweep import SimulatedSweep
from exumi_data.simulation.sweep_recording import CAMERA, sweep_frames

__all__ = ["CalibrationPictures", "FingerPictures", "ScenePictures", "read_number"]

UInt8Array = NDArray[np.uint8]
Float64Array = NDArray[np.float64]

BITS = 16
_CELL_PX = 8
# Five levels apart is less than what counts as touched.
_LOW, _HIGH = 126, 131
_FULL_M = 1.5e-3
_PRESS = 70.0
_NOISE = 0.8


def draw_number(picture: UInt8Array, number: int) -> None:
    """Write a number into the first rows of a picture, so faintly that no touch is seen in it.

    Parameters
    ----------
    picture : (H, W, 3) uint8
    number : int
        Below 65,536.
    """
    cells = list(_cells(picture.shape[1]))
    # The last two say what low and high look like once compressed.
    for bit, (top, left) in enumerate(cells):
        is_high = number >> bit & 1 if bit < BITS else bit > BITS
        picture[top : top + _CELL_PX, left : left + _CELL_PX] = _HIGH if is_high else _LOW


def read_number(picture: UInt8Array) -> int:
    """Read the number of a picture, also after it was compressed.

    Parameters
    ----------
    picture : (H, W) or (H, W, C) uint8
    """
    grey = picture.astype(np.float64).reshape(*picture.shape[:2], -1).mean(axis=2)
    levels = [
        float(grey[top + 2 : top + _CELL_PX - 2, left + 2 : left + _CELL_PX - 2].mean())
        for top, left in _cells(picture.shape[1])
    ]
    middle = 0.5 * (levels[BITS] + levels[BITS + 1])
    return sum(int(level > middle) << bit for bit, level in enumerate(levels[:BITS]))


def _cells(width: int) -> Iterator[tuple[int, int]]:
    columns = width // _CELL_PX
    for bit in range(BITS + 2):
        row, column = divmod(bit, columns)
        yield row * _CELL_PX, column * _CELL_PX


class FingerPictures:
    """Draws a gel that is pressed in.

    Parameters
    ----------
    size : (int, int)
        Height and width.
    seed : int
    """

    def __init__(self, size: tuple[int, int], seed: int) -> None:
        rng = np.random.default_rng((seed, 81))
        height, width = size
        y, x = np.mgrid[:height, :width].astype(np.float32)
        x, y = x / width, y / height
        base = np.stack([95 + 40 * x, 115 + 20 * y, 130 - 30 * x], axis=-1)
        self._base = base.astype(np.float32)
        blob = np.exp(-((x - 0.5) ** 2 + (y - 0.6) ** 2) / 0.03)
        self._blob = (blob * np.sin(45 * x) * np.cos(38 * y)).astype(np.float32)[..., None]
        self._noise = _NOISE * rng.standard_normal((height + 64, width + 64, 3), np.float32)
        self._rng = rng

    def draw(self, number: int, depth_m: float) -> UInt8Array:
        """Return a picture, (H, W, 3) uint8 RGB.

        Parameters
        ----------
        number : int
        depth_m : float
            How deep something is pressed in.
        """
        top, left = self._rng.integers(0, 64, 2)
        height, width = self._base.shape[:2]
        level = _PRESS * min(depth_m / _FULL_M, 1.5)
        frame = self._base + self._noise[top : top + height, left : left + width]
        frame += level * self._blob
        picture = frame.clip(0, 255).astype(np.uint8)
        draw_number(picture, number)
        return picture


class ScenePictures:
    """Draws what the camera sees in a demonstration that nobody looks at.

    Parameters
    ----------
    size : (int, int)
        Height and width.
    textured : bool
        Whether a scene goes by, as costly to encode and decode as a real one; else all is grey.
    seed : int
    """

    def __init__(self, size: tuple[int, int], *, textured: bool, seed: int) -> None:
        self._size = size
        self._scene: UInt8Array | None = None
        if textured:
            rng = np.random.default_rng((seed, 85))
            coarse = rng.integers(0, 255, (size[0] // 4, size[1] // 4, 3), np.uint8)
            smooth = cv2.GaussianBlur(coarse, (0, 0), 3)
            stretched = cv2.normalize(smooth, None, 0, 243, cv2.NORM_MINMAX)  # type: ignore[call-overload]  # it makes its own array
            large = cv2.resize(stretched, size[::-1], interpolation=cv2.INTER_CUBIC)
            self._scene = np.asarray(large, np.uint8) + rng.integers(0, 12, (*size, 3), np.uint8)

    def __call__(self, number: int) -> UInt8Array:
        """Return a frame, (H, W, 3) uint8."""
        if self._scene is None:
            picture = np.full((*self._size, 3), 40 + number % 150, np.uint8)
        else:
            picture = np.roll(self._scene, (2 * number, 3 * number), (0, 1))
        draw_number(picture, number)
        return picture


@dataclass
class CalibrationPictures:
    """Draws the latency clip: the marker as the hand sweeps, and the fingers at the lower edge.

    Attributes
    ----------
    sweep : SimulatedSweep
        Its frames come at the clip's rate.
    widths_m : (N,) float64
        The gripper's opening at each frame.
    seed : int
    """

    sweep: SimulatedSweep
    widths_m: Float64Array
    seed: int

    def __post_init__(self) -> None:
        self._frames = sweep_frames(self.sweep, seed=self.seed, marker=MarkerSettings())
        self._last: UInt8Array | None = None
        self._rng = np.random.default_rng((self.seed, 83))

    def __call__(self, number: int) -> UInt8Array:
        """Return a frame, (H, W, 3) uint8; they are asked for in order."""
        _, frame = next(self._frames, (0.0, None))
        if frame is None:
            assert self._last is not None  # noqa: S101  # a sweep has frames
            noise = self._rng.integers(-2, 3, self._last.shape, dtype=np.int16)
            frame = (self._last.astype(np.int16) + noise).clip(0, 255).astype(np.uint8)
        else:
            self._last = frame.copy()
        half = 0.5 * float(self.widths_m[number]) * _FINGER_PX_PER_M
        middle, top = (CAMERA.width - 1) / 2, CAMERA.height - _FINGER_PX
        for side in (-1, 1):
            centre = middle + side * (half + 0.5 * _FINGER_PX)
            corners = np.array([[centre - 20, top], [centre + 20, CAMERA.height]])
            (left, above), (right, below) = np.round(corners * 16).astype(int).tolist()
            cv2.rectangle(
                frame, (left, above), (right, below), (30, 30, 30), -1, cv2.LINE_AA, shift=4
            )
        return frame


_FINGER_PX, _FINGER_PX_PER_M = 60, 3000.0
