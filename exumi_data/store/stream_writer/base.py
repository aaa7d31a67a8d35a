"""What the writers of all kinds of streams share."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.model.documents import group_document
from exumi_data.model.streams import Reference, StreamModel, TactileStream
from exumi_data.store.shards import ArrayWriter

__all__ = ["BESIDE", "StreamWriter", "as_array", "whole_numbers"]

_LOW_DIM_ROWS = 8192
_LOW_DIM_CHUNK_BYTES = 1 << 20
BESIDE: dict[str, Any] = {
    "time_host": np.int64,
    "time_device": np.int64,
    "sequence": np.uint64,
    "flags": np.uint32,
}
"""The arrays that any stream may have beside `time`, with their types."""


def whole_numbers(value: Any, dtype: Any, what: str, where: str) -> np.ndarray:
    """Cast times, counters or flags; a plain int may become unsigned, a negative one may not.

    Raises
    ------
    UsageError
        They do not fit.
    """
    column = np.atleast_1d(as_array(value, what, where))
    limits = np.iinfo(dtype)
    whole = column.ndim == 1 and (column.dtype.kind in "iu" or not column.size)
    if not whole or (
        column.size and not limits.min <= int(column.min()) <= int(column.max()) <= limits.max
    ):
        raise UsageError(
            f"{what} must be whole numbers that fit into {limits.dtype}, one or one axis",
            where=where,
        )
    return column.astype(dtype)


def as_array(value: Any, what: str, where: str) -> np.ndarray:
    """Make an array of numbers of what was given.

    Raises
    ------
    UsageError
        It is none.
    """
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise UsageError(f"{what} is no array ({error})", where=where) from None
    if array.dtype.kind not in "biuf":
        raise UsageError(f"{what} holds {array.dtype}, not numbers", where=where)
    return array


def _row_bytes(dtype: Any, row_shape: tuple[int, ...]) -> int:
    return max(1, math.prod(row_shape) * int(np.dtype(dtype).itemsize))


class StreamWriter:
    """What all streams have: `time`, the optional arrays beside it, and the metadata.

    Parameters
    ----------
    folder : pathlib.Path
        ``streams/<name>`` of the episode that is being written.
    name : str
    model : StreamModel
        The stream's metadata; `arrays` and what only the data knows are filled in at the end.
    """

    def __init__(self, folder: Path, name: str, model: StreamModel) -> None:
        self.folder = folder
        self.name = name
        self.model = model
        self.count = 0
        self._last_time: int | None = None
        self._arrays: dict[str, ArrayWriter] = {}
        self._extra: frozenset[str] | None = None
        self._usable = True
        folder.mkdir(parents=True)

    def _array(
        self,
        name: str,
        dtype: Any,
        row_shape: tuple[int, ...] = (),
        names: tuple[str, ...] = (),
        *,
        rows: int = _LOW_DIM_ROWS,
        zstd: bool = True,
        axis: str = "time",
    ) -> ArrayWriter:
        writer = self._arrays.get(name)
        if writer is None:
            writer = ArrayWriter(
                self.folder / name,
                dtype,
                row_shape,
                chunk_rows=min(rows, max(1, _LOW_DIM_CHUNK_BYTES // _row_bytes(dtype, row_shape))),
                zstd=zstd,
                dimension_names=(axis, *names),
            )
            self._arrays[name] = writer
        return writer

    def _checked(
        self, time: Any, given: dict[str, Any], *, count: int, what: str
    ) -> dict[str, np.ndarray]:
        """Check the times of `count` samples and what may come with them; return all by name."""
        times = whole_numbers(time, np.int64, "time", self.name)
        columns = {"time": times}
        for name, value in given.items():
            if value is not None:
                columns[name] = (
                    value if name == "raw" else whole_numbers(value, BESIDE[name], name, self.name)
                )
        unequal = frozenset(columns) ^ (self._extra or frozenset(columns))
        if unequal:
            raise UsageError(
                f"optional arrays come with every sample or with none: {sorted(unequal)}",
                where=self.name,
            )
        for name, column in columns.items():
            if len(column) != len(times):
                raise UsageError(
                    f"{name} has {len(column)} samples, time {len(times)}", where=self.name
                )
        if count != len(times):
            raise UsageError(f"{count} {what}, {len(times)} times", where=self.name)
        self._check_ascending(times)
        return columns

    def _check_ascending(self, times: np.ndarray) -> None:
        # Compared, not subtracted: a difference of two int64 can wrap.
        ascending = times[1:] > times[:-1]
        first = not times.size or self._last_time is None or int(times[0]) > self._last_time
        if not first or not ascending.all():
            at = 1 + int(np.argmin(ascending)) if first else 0
            raise UsageError(
                f"time does not increase at sample {self.count + at}",
                where=self.name,
                fix="Keep the arrival order and nudge ties with "
                "exumi_data.time.strictly_increasing.",
            )

    @contextmanager
    def _appending(self, columns: dict[str, np.ndarray]) -> Iterator[None]:
        """Append checked columns, then what the caller appends: all of it, or the stream is spoilt.

        Everything that can be wrong with the values was found before; what is left is a full disk
        or an interrupt, after which arrays of different lengths must not be finished.
        """
        if not self._usable:
            raise UsageError("an earlier append failed half-way", where=self.name)
        writers = {name: self._column(name, values) for name, values in columns.items()}
        for name, values in columns.items():
            writers[name].check(values)
        self._usable = False
        for name, values in columns.items():
            writers[name].append(values)
        yield
        times = columns["time"]
        self._extra = self._extra or frozenset(columns) & {"time", "raw", *BESIDE}
        if times.size:
            self._last_time = int(times[-1])
        self.count += len(times)
        self._usable = True

    def _column(self, name: str, values: np.ndarray) -> ArrayWriter:
        names = tuple(f"{name}_{i}" for i in range(values.ndim - 1))
        return self._array(name, values.dtype, values.shape[1:], names)

    def set_reference(
        self,
        image: np.ndarray,
        *,
        method: str,
        frames: Sequence[int] | None = None,
        contact_free: bool | None = None,
        algorithm: str | None = None,
        **fields: Any,
    ) -> None:
        """Store the no-contact image of a tactile stream.

        Parameters
        ----------
        image : (H, W, 1|3) uint8
        method : {"captured", "selected", "estimated"}
        frames : sequence of int, optional
            The frames it was made from.
        contact_free : bool, optional
            False when every frame seems to be in contact.
        algorithm : str, optional
        **fields
            Keys of third parties.

        Raises
        ------
        UsageError
            The image is not of that kind or not of the frames' size, or there is one already.
        """
        if not isinstance(self.model, TactileStream):
            raise UsageError("only tactile streams have a reference", where=self.name)
        images = self.model.images
        size = (images.height, images.width)
        if image.dtype != np.uint8 or image.shape not in ((*size, 1), (*size, 3)):
            raise UsageError(
                f"the reference is {image.shape} {image.dtype}, the frames are "
                f"{(*size, images.channels)} uint8",
                where=self.name,
            )
        self._put_whole("reference", image, ("y", "x", "c"))
        values: dict[str, Any] = {"method": method, **fields}
        if frames is not None:
            values["frames"] = [int(frame) for frame in frames]
        if contact_free is not None:
            values["contact_free"] = contact_free
        if algorithm is not None:
            values["algorithm"] = algorithm
        self.model.reference = Reference.model_validate(
            values, context={"newer_minor": self.model.is_newer_minor}
        )

    def _put_whole(self, name: str, values: np.ndarray, names: tuple[str, ...]) -> None:
        """Write an array that the stream has once."""
        if name in self._arrays:
            raise UsageError(f"there is a {name} array already", where=self.name)
        axis, *others = names
        writer = self._array(name, values.dtype, values.shape[1:], tuple(others), axis=axis)
        writer.append(values)

    def _complete(self) -> None:
        """Make the arrays that a stream without samples would lack."""
        self._array("time", np.int64)

    def finish(self) -> StreamModel:
        """Write what is pending; return the stream's final metadata.

        Raises
        ------
        UsageError
            An append failed half-way.
        """
        if not self._usable:
            raise UsageError("an append failed half-way", where=self.name)
        self._complete()
        for writer in self._arrays.values():
            writer.finish()
        (self.folder / "zarr.json").write_bytes(group_document())
        self.model.arrays = list(self._arrays)
        return self.model

    def abort(self) -> None:
        """Close open files."""
        self._usable = False
        for writer in self._arrays.values():
            writer.abort()
