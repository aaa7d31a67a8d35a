"""Streams whose samples are rows of an array."""

from typing import Any

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.model.images import ArrayImages
from exumi_data.model.streams import (
    PoseStream,
    StreamModel,
    TaxelsStream,
    WidthStream,
    WrenchStream,
)
from exumi_data.store.shards import ArrayWriter
from exumi_data.store.stream_writer.base import StreamWriter, as_array

__all__ = ["DataStreamWriter"]

_DATA_LAYOUT: dict[type[StreamModel], tuple[Any, tuple[str, ...]]] = {
    PoseStream: (np.float64, ("component",)),
    WidthStream: (np.float32, ()),
    WrenchStream: (np.float32, ("component",)),
    TaxelsStream: (None, ("row", "column")),
}


class DataStreamWriter(StreamWriter):
    """A stream whose `data` is an array: low-dimensional kinds, and frames stored as ``array``."""

    def append(
        self,
        time: Any,
        data: Any,
        *,
        raw: Any = None,
        time_host: Any = None,
        time_device: Any = None,
        sequence: Any = None,
        flags: Any = None,
    ) -> None:
        """Append one sample or several.

        Parameters
        ----------
        time : int or (n,) int64
            Nanoseconds since the episode's start, strictly increasing.
        data : array-like
            One sample, or (n, ...). Pose: x y z qx qy qz qw, metres. Width: metres.
            Frames: (H, W, C) uint8.
        raw : array-like, optional
            The device's own values.
        time_host, time_device, sequence, flags : int or (n,), optional
            See the standard, section Time.

        Raises
        ------
        UsageError
            Times do not increase, or shapes do not match. Nothing was appended.
        """
        scalar = np.ndim(time) == 0
        values = self._typed(self._samples(data, "data", scalar=scalar))
        columns = self._checked(
            time,
            {
                "raw": None if raw is None else self._samples(raw, "raw", scalar=scalar),
                "time_host": time_host,
                "time_device": time_device,
                "sequence": sequence,
                "flags": flags,
            },
            count=len(values),
            what="samples",
        )
        with self._appending({**columns, "data": values}):
            pass

    def _samples(self, value: Any, what: str, *, scalar: bool) -> np.ndarray:
        samples = as_array(value, what, self.name)
        if scalar:
            return samples[None]
        if not samples.ndim:
            raise UsageError(f"{what} is one number, time has an axis", where=self.name)
        return samples

    def _column(self, name: str, values: np.ndarray) -> ArrayWriter:
        return self._data_array(values) if name == "data" else super()._column(name, values)

    def _images(self) -> ArrayImages | None:
        images = getattr(self.model, "images", None)
        return images if isinstance(images, ArrayImages) else None

    def _row_shape(self) -> tuple[int, ...] | None:
        model = self.model
        images = self._images()
        if images is not None:
            return (images.height, images.width, images.channels)
        if isinstance(model, PoseStream):
            return (7,)
        if isinstance(model, WidthStream):
            return ()
        if isinstance(model, WrenchStream):
            return (len(model.components),)
        if isinstance(model, TaxelsStream):
            return tuple(model.grid)
        return None

    def _typed(self, values: np.ndarray) -> np.ndarray:
        """Check samples against the kind's shape and type; cast numbers to that type."""
        row_shape = self._row_shape()
        if row_shape is not None and values.shape[1:] != row_shape:
            raise UsageError(
                f"a sample has shape {values.shape[1:]}, expected {row_shape}", where=self.name
            )
        if self._images() is not None and values.dtype != np.uint8:
            raise UsageError(f"frames are uint8, not {values.dtype}", where=self.name)
        if isinstance(self.model, TaxelsStream) and values.dtype not in (np.int16, np.float32):
            raise UsageError(f"taxels are int16 or float32, not {values.dtype}", where=self.name)
        known = _DATA_LAYOUT.get(type(self.model), (None, ()))[0]
        return values if known is None else values.astype(known, copy=False)

    def _data_array(self, values: np.ndarray) -> ArrayWriter:
        images = self._images()
        if images is not None:
            return self._array("data", np.uint8, values.shape[1:], ("y", "x", "c"), rows=1)
        names = _DATA_LAYOUT.get(type(self.model), (None, None))[1]
        if names is None:
            names = tuple(f"axis_{i}" for i in range(values.ndim - 1))
        return self._array("data", values.dtype, values.shape[1:], names)

    def set_valid(self, valid: np.ndarray) -> None:
        """Store which taxels are alive, (R, C) bool.

        Raises
        ------
        UsageError
            The mask is not of that kind, or there is one already.
        """
        if not isinstance(self.model, TaxelsStream):
            raise UsageError("only taxel streams have a valid mask", where=self.name)
        if valid.dtype != np.bool_ or valid.shape != tuple(self.model.grid):
            raise UsageError(
                f"the mask is {valid.shape} {valid.dtype}, the grid {tuple(self.model.grid)} bool",
                where=self.name,
            )
        self._put_whole("valid", valid, ("row", "column"))

    def _complete(self) -> None:
        super()._complete()
        if "data" not in self._arrays:
            shape = self._row_shape() or ()
            dtype = np.uint8 if self._images() else _DATA_LAYOUT.get(type(self.model), (None,))[0]
            self._data_array(np.empty((0, *shape), dtype or np.float32))
