"""What was seen in all episodes: contact maps, and the tiles of contact sheets."""

from dataclasses import dataclass, field

import numpy as np

from exumi_data.stats.html.looking import GRID, Looked, Tile, Touched
from exumi_data.stats.model import Unreadable

__all__ = ["ContactMap", "Pictures"]


@dataclass(slots=True)
class ContactMap:
    """Where one finger was touched, over all episodes; see `Touched`."""

    frames: int = 0
    counts: np.ndarray = field(default_factory=lambda: np.zeros((GRID, GRID), np.int64))
    shapes: dict[tuple[int, int], int] = field(default_factory=dict)

    def add(self, touched: Touched) -> None:
        """Add one episode."""
        self.frames += touched.frames
        self.counts += touched.counts
        self.shapes[touched.shape] = self.shapes.get(touched.shape, 0) + 1


@dataclass(slots=True)
class Pictures:
    """Pictures of a dataset.

    Attributes
    ----------
    decoded : int
        Frames of tactile streams.
    maps : dict
        By tactile stream.
    tiles : list of Tile
        In the order in which they are shown.
    damaged : list of Unreadable
        Episodes whose frames could not be read.
    """

    decoded: int = 0
    maps: dict[str, ContactMap] = field(default_factory=dict)
    tiles: list[Tile] = field(default_factory=list)
    damaged: list[Unreadable] = field(default_factory=list)

    def add(self, looked: Looked) -> None:
        """Add one episode; its tile is added elsewhere, in its place."""
        self.decoded += looked.decoded
        for touched in looked.touched:
            self.maps.setdefault(touched.stream, ContactMap()).add(touched)
