"""What the one pass over the frames of a tactile stream leaves behind for the rules of touch.

Frames are decoded once, by the checks of images and of video. They hand every frame on to here,
where the pixels of a grid are looked at: that must cost little against decoding. Memory does not
grow with the number of frames.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from exumi_data.tactile import thumbnail, to_grey
from exumi_data.tactile.wrapping import Jumps
from exumi_validators.touch_measures import median_image, nearest_to

__all__ = ["FrameStatistics", "GlanceLimits", "Tally"]

UInt8Array = npt.NDArray[np.uint8]

_BATCH = 64
_FEWEST = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class GlanceLimits:
    """What a frame is called dark or saturated by.

    Attributes
    ----------
    dark_level : float
        Mean grey level below which a frame is dark.
    saturated_level : float
        Grey level from which a pixel is saturated.
    saturated_share : float
        Share of saturated pixels above which a frame is saturated.
    pixels : int
        How many pixels of a frame the grid has that it is judged by, about.
    thumbnail_pixels : int
        How many pixels a thumbnail has, about.
    jump_rows : int
        How many rows of a frame are searched for jumps, about.
    jump_apart_px : int
        How far apart the pixels of a row are whose levels are compared.
    """

    dark_level: float
    saturated_level: float
    saturated_share: float
    pixels: int
    thumbnail_pixels: int
    jump_rows: int
    jump_apart_px: int

    def grid(self, height: int, width: int) -> tuple[slice, slice]:
        """Return the rows and the columns of a frame that it is judged by."""
        step = max(1, math.isqrt(height * width // max(1, self.pixels)))
        first = step // 2
        return slice(min(first, height - 1), None, step), slice(min(first, width - 1), None, step)


@dataclass(slots=True)
class Tally:
    """Frames of which something is true: how many, the first, and its value."""

    count: int = 0
    first: int = -1
    value: float = 0.0

    def add(self, frames: npt.NDArray[np.int64], values: npt.NDArray[np.float32]) -> None:
        """Count frames, ascending."""
        if frames.size and not self.count:
            self.first, self.value = int(frames[0]), float(values[0])
        self.count += int(frames.size)


class FrameStatistics:
    """Statistics of the frames of one tactile stream.

    Parameters
    ----------
    size : (int, int)
        Height and width of a frame.
    limits : GlanceLimits
    kept : iterable of int
        Frames that thumbnails are kept of.
    searched : iterable of int
        Frames that are searched for jumps.
    ignored : ndarray of bool, shape (N,), optional
        Frames that are not judged.
    reference : (h, w) uint8, optional
        Grey thumbnail of the stream's reference.
    coloured : (H, W, C) uint8, optional
        The reference itself, of which the pixels of a grid are kept.

    Attributes
    ----------
    reference : ndarray or None
        As it was given.
    colours_of_reference : (h, w, 3) uint8 or None
        Its pixels on the grid; None where it has no colours, or another size than the frames.
    glanced : int
        Frames whose level was judged.
    dark, saturated : Tally
        Those that are too dark, or saturated.
    thumbnails : dict
        Frame to its (h, w) uint8 grey thumbnail.
    jumps : Jumps
    """

    def __init__(
        self,
        size: tuple[int, int],
        limits: GlanceLimits,
        *,
        kept: Iterable[int],
        searched: Iterable[int],
        ignored: npt.NDArray[np.bool_] | None = None,
        reference: UInt8Array | None = None,
        coloured: UInt8Array | None = None,
    ) -> None:
        self.glanced = 0
        self.reference = reference
        self.dark, self.saturated = Tally(), Tally()
        self.jumps = Jumps(limits.jump_rows, limits.jump_apart_px)
        self.thumbnails: dict[int, UInt8Array] = {}
        self._limits = limits
        self._kept, self._searched = frozenset(kept), frozenset(searched)
        self._ignored = ignored
        self._grid = limits.grid(*size)
        self.colours_of_reference: UInt8Array | None = None
        if coloured is not None and coloured.shape == (*size, 3):
            self.colours_of_reference = coloured[self._grid].copy()
        self._colours: list[UInt8Array] = []
        self._pixels: UInt8Array | None = None
        self._frames: list[int] = []
        self._levels: UInt8Array | None = None

    @cached_property
    def quiet(self) -> UInt8Array | None:
        """The median of the kept frames that resemble the reference most, (h, w) grey.

        None where there is nothing to compare: no reference, or too few frames.
        """
        reference, images = self.reference, list(self.thumbnails.values())
        if reference is None or len(images) < _FEWEST:
            return None
        if any(image.shape != reference.shape for image in images):
            return None
        return median_image(nearest_to(reference, images))

    @cached_property
    def colours(self) -> UInt8Array | None:
        """The median of the searched frames that resemble the reference most, on the grid.

        (h, w, 3); None where it or the frames have no colours.
        """
        reference, images = self.colours_of_reference, self._colours
        if reference is None or not images:
            return None
        return median_image(nearest_to(reference, images))

    def searches(self, index: int) -> bool:
        """Whether a frame is searched for jumps, for which its colours are needed."""
        return index in self._searched

    def add(self, index: int, frame: UInt8Array, *, levels: UInt8Array | None = None) -> None:
        """Take a frame.

        Parameters
        ----------
        index : int
        frame : (H, W), (H, W, 1) or (H, W, 3) uint8
            It may be used again by the caller.
        levels : (256,) uint8, optional
            The grey level that each stored level stands for; the same for all frames.
        """
        if levels is not self._levels or len(self._frames) == _BATCH:
            self.end()
            self._levels = levels
        pixels = frame[self._grid]
        if self._pixels is None:
            self._pixels = np.empty((_BATCH, *pixels.shape), np.uint8)
        self._pixels[len(self._frames)] = pixels
        self._frames.append(index)
        if index in self._kept:
            small = thumbnail(to_grey(frame), self._limits.thumbnail_pixels)
            # A small frame is its own thumbnail, in memory that the caller uses again.
            self.thumbnails[index] = small.copy() if levels is None else levels[small]

    def search(self, index: int, frame: UInt8Array) -> None:
        """Search a frame, (H, W, C) uint8, for jumps; others than those asked for are ignored.

        Its colours are kept: to decode quieter frames with theirs would cost too much.
        """
        if index in self._searched:
            self.jumps.add(frame)
            if frame.shape[2] == 3:
                self._colours.append(frame[self._grid].copy())

    def end(self) -> None:
        """Judge what was collected since the last time."""
        if not self._frames or self._pixels is None:
            return
        frames, grey = np.array(self._frames, np.int64), self._grey(self._pixels)
        self._frames.clear()
        if self._ignored is not None:
            judged = ~self._ignored[frames]
            frames, grey = frames[judged], grey[judged]
        limits = self._limits
        self.glanced += len(frames)
        mean = grey.mean(axis=1, dtype=np.float32)
        share = (grey >= limits.saturated_level).mean(axis=1, dtype=np.float32)
        dark, saturated = mean < limits.dark_level, share > limits.saturated_share
        self.dark.add(frames[dark], mean[dark])
        self.saturated.add(frames[saturated], share[saturated])

    def _grey(self, pixels: UInt8Array) -> UInt8Array:
        """Grey levels of what was collected, (n, pixels)."""
        taken = pixels[: len(self._frames)]
        if taken.ndim == 4:
            taken = to_grey(taken.reshape(len(taken), -1, taken.shape[3]))
        if self._levels is not None:
            taken = self._levels[taken]
        return taken.reshape(len(taken), -1)
