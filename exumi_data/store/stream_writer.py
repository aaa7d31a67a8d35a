"""Writing one stream: samples are appended, memory stays bounded, nothing is measured twice."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.model.documents import group_document
from exumi_data.model.images import ArrayImages, EncodedImages, VideoFile, VideoImages
from exumi_data.model.streams import (
    AudioStream,
    PoseStream,
    Reference,
    RgbStream,
    StreamModel,
    TactileStream,
    TaxelsStream,
    WidthStream,
    WrenchStream,
)
from exumi_data.store import jpeg
from exumi_data.store.shards import ArrayWriter, Bytes, crc32c
from exumi_data.time import NS_PER_S, apply_clock

__all__ = [
    "AudioStreamWriter",
    "DataStreamWriter",
    "EncodedStreamWriter",
    "StreamWriter",
    "VideoStreamWriter",
]

_LOW_DIM_ROWS = 8192
_BYTE_CHUNK = 64 << 10
_LOW_DIM_CHUNK_BYTES = 1 << 20
_COPY_PIECE = 4 << 20
_EXTRA: dict[str, Any] = {
    "time_host": np.int64,
    "time_device": np.int64,
    "sequence": np.uint64,
    "flags": np.uint32,
}


def _whole_numbers(value: Any, dtype: Any, what: str, where: str) -> np.ndarray:
    """Cast times, counters or flags; a plain int may become unsigned, a negative one may not."""
    column = np.atleast_1d(_as_array(value, what, where))
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


def _as_array(value: Any, what: str, where: str) -> np.ndarray:
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

    def _checked(self, time: Any, given: dict[str, Any]) -> dict[str, np.ndarray]:
        """Check times and the arrays that may come with them; return them by name."""
        times = _whole_numbers(time, np.int64, "time", self.name)
        columns = {"time": times}
        for name, value in given.items():
            if value is not None:
                columns[name] = (
                    value if name == "raw" else _whole_numbers(value, _EXTRA[name], name, self.name)
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
        self._extra = self._extra or frozenset(columns) & {"time", "raw", *_EXTRA}
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
        )
        if len(values) != len(columns["time"]):
            raise UsageError(
                f"data has {len(values)} samples, time {len(columns['time'])}", where=self.name
            )
        with self._appending({**columns, "data": values}):
            pass

    def _samples(self, value: Any, what: str, *, scalar: bool) -> np.ndarray:
        samples = _as_array(value, what, self.name)
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


class EncodedStreamWriter(StreamWriter):
    """An image stream stored as ``encoded``: JPEG files verbatim, end to end."""

    def __init__(self, folder: Path, name: str, model: RgbStream | TactileStream) -> None:
        super().__init__(folder, name, model)
        self._images: EncodedImages = model.images  # type: ignore[assignment]  # the factory saw to it
        self._position = 0
        self._comment: str | None = None
        byte_array = self._array("data", np.uint8, rows=_BYTE_CHUNK, zstd=False, axis="byte")
        self._data = byte_array
        self._offset = self._array("offset", np.uint64, axis="edge")
        self._offset.append(np.zeros(1, np.uint64))
        self._crc = self._array("crc32c", np.uint32)

    def append(
        self,
        time: Any,
        encoded: bytes | Sequence[bytes],
        *,
        time_host: Any = None,
        time_device: Any = None,
        sequence: Any = None,
        flags: Any = None,
    ) -> None:
        """Append the file of one frame, or of several.

        Parameters
        ----------
        time : int or (n,) int64
            Nanoseconds since the episode's start, strictly increasing.
        encoded : bytes or sequence of bytes
            JPEG files, stored as they are.
        time_host, time_device, sequence, flags : int or (n,), optional

        Raises
        ------
        UsageError
            A file is no JPEG of the declared size, or times do not increase.
            Nothing was appended.
        """
        files = [encoded] if isinstance(encoded, Bytes) else list(encoded)
        expected = (self._images.height, self._images.width, self._images.channels)
        for index, file in enumerate(files):
            self._check_file(file, self.count + index, expected)
        columns = self._checked(
            time,
            {
                "time_host": time_host,
                "time_device": time_device,
                "sequence": sequence,
                "flags": flags,
            },
        )
        if len(files) != len(columns["time"]):
            raise UsageError(f"{len(files)} frames, {len(columns['time'])} times", where=self.name)
        ends = self._position + np.cumsum([len(file) for file in files], dtype=np.uint64)
        with self._appending(columns):
            for file in files:
                self._data.append_bytes(file)
            self._offset.append(ends)
            self._crc.append(np.array([crc32c(file) for file in files], dtype=np.uint32))
        if files:
            self._position = int(ends[-1])

    def _check_file(self, file: bytes, index: int, expected: tuple[int, int, int]) -> None:
        try:
            size = jpeg.size_of(file)
        except DamagedDataError as error:
            raise UsageError(f"frame {index}: {error.what}", where=self.name) from None
        if size != expected:
            raise UsageError(
                f"frame {index} is {size} (height, width, channels), expected {expected}",
                where=self.name,
            )


class AudioStreamWriter(StreamWriter):
    """Sound: blocks end to end, each with the time of its first sample."""

    def __init__(self, folder: Path, name: str, model: AudioStream) -> None:
        super().__init__(folder, name, model)
        self._channels = model.channels
        self._position = 0
        self._data = self._array("data", np.int16, (model.channels,), ("channel",), axis="sample")
        self._offset = self._array("offset", np.uint64, axis="edge")
        self._offset.append(np.zeros(1, np.uint64))

    def append(
        self,
        time: Any,
        blocks: np.ndarray | Sequence[np.ndarray],
        *,
        time_host: Any = None,
        time_device: Any = None,
        sequence: Any = None,
        flags: Any = None,
    ) -> None:
        """Append one block, or several.

        Parameters
        ----------
        time : int or (n,) int64
            Nanoseconds since the episode's start of each block's first sample, strictly increasing.
        blocks : (S, channels) int16 or sequence of such
            None of them empty.
        time_host, time_device, sequence, flags : int or (n,), optional
            Of each block; see the standard, section Time.

        Raises
        ------
        UsageError
            A block is no sound of the declared channels, or times do not increase.
            Nothing was appended.
        """
        given = [blocks] if np.ndim(time) == 0 else list(blocks)
        sound = [self._checked_block(block, self.count + i) for i, block in enumerate(given)]
        columns = self._checked(
            time,
            {
                "time_host": time_host,
                "time_device": time_device,
                "sequence": sequence,
                "flags": flags,
            },
        )
        if len(sound) != len(columns["time"]):
            raise UsageError(f"{len(sound)} blocks, {len(columns['time'])} times", where=self.name)
        ends = self._position + np.cumsum([len(block) for block in sound], dtype=np.uint64)
        with self._appending(columns):
            for block in sound:
                self._data.append(block)
            self._offset.append(ends)
        if sound:
            self._position = int(ends[-1])

    def _checked_block(self, block: Any, index: int) -> np.ndarray:
        values = np.asarray(block)
        fits = values.ndim == 2 and values.shape[1] == self._channels and len(values)
        if values.dtype != np.int16 or not fits:
            raise UsageError(
                f"block {index} is {values.shape} {values.dtype}, expected "
                f"(samples, {self._channels}) int16",
                where=self.name,
            )
        return values


class VideoStreamWriter(StreamWriter):
    """An image stream stored as ``video``: container files verbatim."""

    def __init__(self, folder: Path, name: str, model: RgbStream | TactileStream) -> None:
        super().__init__(folder, name, model)
        self._position = 0
        self._files: list[VideoFile] = []
        self._data = self._array("data", np.uint8, rows=_BYTE_CHUNK, zstd=False, axis="byte")
        self._offset = self._array("offset", np.uint64, axis="edge")
        self._offset.append(np.zeros(1, np.uint64))

    def append_file(
        self,
        source: Path | bytes,
        file: VideoFile,
        *,
        pts: np.ndarray,
        keyframe: np.ndarray,
        time: Any = None,
        **beside: Any,
    ) -> None:
        """Append one container file and the times of its frames.

        `time` is what the pts and the stream's clock give. A clock that names a `raw_time` has no
        part in the pts: then `time` is given, with the array that it was computed from.

        Parameters
        ----------
        source : pathlib.Path or bytes
            The file: copied as it is.
        file : VideoFile
            What is known of it.
        pts : (n,) int64
            Presentation time of each frame, ascending, in units of the file's time base.
        keyframe : (n,) int
            For each frame, the index *within this file* of the frame to start decoding from.
        time : (n,) int64, optional
            Nanoseconds since the episode's start, where the clock names a `raw_time`.
        **beside
            `time_host`, `time_device`, `sequence`, `flags`, each (n,): see the standard, section
            Time.

        Raises
        ------
        UsageError
            Times do not increase, the arrays differ in length, a keyframe is not at or before its
            frame, the file has another size, or `time` is given without a `raw_time` or missing
            beside one. Nothing was appended, unless the file changed while it was read: then the
            stream cannot be finished.
        """
        pts = _whole_numbers(pts, np.int64, "pts", self.name)
        keyframe = _whole_numbers(keyframe, np.int64, "keyframe", self.name)
        if len(pts) != len(keyframe):
            raise UsageError(f"{len(pts)} pts, {len(keyframe)} keyframes", where=self.name)
        if (keyframe < 0).any() or (keyframe > np.arange(len(keyframe))).any():
            raise UsageError("a keyframe is not at or before its frame", where=self.name)
        if unknown := set(beside) - set(_EXTRA):
            raise UsageError(
                f"no array {min(unknown)} comes with a video's frames", where=self.name
            )
        if (time is None) != (self.model.clock.raw_time is None):
            raise UsageError(
                "times are given where the clock names a raw_time, and only there",
                where=self.name,
                fix="Without a raw_time they follow from pts, start_ns and the clock.",
            )
        size = len(source) if isinstance(source, bytes) else source.stat().st_size
        if size != file.bytes:
            raise UsageError(
                f"{file.name} has {size} bytes, its metadata says {file.bytes}", where=self.name
            )
        columns = self._checked(self._times_of(pts, file) if time is None else time, beside)
        if len(columns["time"]) != len(pts):
            raise UsageError(f"{len(columns['time'])} times, {len(pts)} pts", where=self.name)
        columns["file"] = np.full(len(pts), len(self._files), np.uint32)
        columns["pts"] = pts
        columns["keyframe"] = (keyframe + self.count).astype(np.uint64)
        with self._appending(columns):
            self._copy(source)
            self._position += file.bytes
            if self._data.rows != self._position:
                raise UsageError(f"{file.name} changed while it was read", where=self.name)
            self._offset.append(np.array([self._position], np.uint64))
        self._files.append(file)

    def _times_of(self, pts: np.ndarray, file: VideoFile) -> Any:
        """Return the times that pts and clock give: exact, and rounded as the standard says."""
        scale = Fraction(file.time_base) * NS_PER_S
        half = Fraction(1, 2)
        raw = [file.start_ns + math.floor(instant * scale + half) for instant in pts.tolist()]
        clock = self.model.clock
        if clock.is_identity or not raw:
            return raw
        try:
            return apply_clock(
                np.array(raw, dtype=np.int64),
                t_ref=clock.t_ref_ns,
                drift_ppm=clock.drift_ppm,
                offset_ns=clock.offset_ns,
                latency_ns=clock.latency_ns,
            )
        except (ValueError, OverflowError) as error:
            raise UsageError(str(error), where=self.name) from None

    def _copy(self, source: Path | bytes) -> None:
        if isinstance(source, bytes):
            self._data.append_bytes(source)
            return
        with source.open("rb") as reader:
            while piece := reader.read(_COPY_PIECE):
                self._data.append_bytes(piece)

    def finish(self) -> StreamModel:
        """Write what is pending; return the stream's final metadata."""
        if not self._files:
            raise UsageError("a video stream needs at least one file", where=self.name)
        images: VideoImages = self.model.images  # type: ignore[attr-defined]  # the factory saw to it
        images.files = self._files
        return super().finish()

    def _complete(self) -> None:
        super()._complete()
        for name, dtype in (("file", np.uint32), ("pts", np.int64), ("keyframe", np.uint64)):
            self._array(name, dtype)
