"""Images of an episode: handed over some at a time, and read again for what is derived."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from exumi_converters.zarr2_files.notes import note_damaged
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import to_grey

__all__ = ["Pass", "Reader"]

_BATCH_BYTES = 8 << 20


@dataclass(slots=True)
class Pass:
    """A pass over the rows of an array of images, and which of them can be decoded.

    Attributes
    ----------
    rows : Rows
    good : list of int
        Those that can, so far.
    lost : list of (int, str)
        Those that cannot, and why.
    """

    rows: Rows
    good: list[int] = field(default_factory=list)
    lost: list[tuple[int, str]] = field(default_factory=list)

    def __iter__(self) -> Iterator[tuple[list[int], list[np.ndarray]]]:
        """Yield which rows, and their values, some at a time."""
        places: list[int] = []
        values: list[np.ndarray] = []
        for block in self.rows.blocks():
            if block.values is None:
                self.lost += [(block.first + i, block.reason) for i in range(block.rows)]
                continue
            for offset, value in enumerate(block.values):
                places.append(block.first + offset)
                values.append(value)
                if len(values) * value.nbytes >= _BATCH_BYTES:
                    self.good += places
                    yield places, values
                    places, values = [], []
        if values:
            self.good += places
            yield places, values

    def note(self, writer: EpisodeWriter, streams: Sequence[str]) -> None:
        """Say which were left out.

        Raises
        ------
        SourceError
            Not one can be decoded.
        """
        note_damaged(writer, streams, self.lost, len(self.good), self.rows.meta)


class Reader:
    """The images that can be decoded, again.

    Parameters
    ----------
    rows : Rows
    good : sequence of int
        As a `Pass` found them.
    picture_of : callable
        Takes a row, returns (H, W, C) uint8.
    channel : int, optional
        The only one that is taken of a row: then others need not be decoded.
    """

    def __init__(
        self,
        rows: Rows,
        good: Sequence[int],
        picture_of: Callable[[np.ndarray], np.ndarray],
        channel: int | None = None,
    ) -> None:
        self._rows = rows
        self._good = good
        self._picture_of = picture_of
        self._channel = channel

    def _read(self, rows: Rows) -> Iterator[np.ndarray | None]:
        for block in rows.blocks(channel=self._channel):
            for offset in range(block.rows):
                picture = None if block.values is None else self._picture_of(block.values[offset])
                yield None if picture is None else np.ascontiguousarray(picture)

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every frame, (H, W) uint8."""
        good = set(self._good)
        for place, picture in enumerate(self._read(self._rows)):
            if place in good and picture is not None:
                yield to_grey(picture)

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Return some frames, ascending."""
        places = (self._good[index] for index in sorted(set(indices)))
        found = (next(self._read(self._rows.slice(place, place + 1))) for place in places)
        return [picture for picture in found if picture is not None]
