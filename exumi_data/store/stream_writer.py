"""Writing one stream: samples are appended, memory stays bounded, nothing is measured twice."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.model.documents import group_document
from exumi_data.model.images import ArrayImages, EncodedImages, VideoFile, VideoImages
from exumi_data.model.streams import (
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
from exumi_data.store.shards import ArrayWriter, crc32c

__all__ = ["DataStreamWriter", "EncodedStreamWriter", "StreamWriter", "VideoStreamWriter"]

_LOW_DIM_ROWS = 8192
_BYTE_CHUNK = 64 << 10
_COPY_PIECE = 4 << 20
_RAW_TIMES = ("time_host", "time_device")
# dtype, and the names of the axes after `time`
_EXTRA: dict[str, tuple[Any, tuple[str, ...]]] = {
    "time_host": (np.int64, ()),
    "time_device": (np.int64, ()),
    "sequence": (np.uint64, ()),
    "flags": (np.uint32, ()),
}


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
                chunk_rows=rows,
                zstd=zstd,
                dimension_names=(axis, *names),
            )
            self._arrays[name] = writer
        return writer

    def _append_time(self, time: Any, extra: dict[str, Any]) -> int:
        """Append times and the arrays beside them; return how many samples."""
        times = np.atleast_1d(np.asarray(time))
        if times.ndim != 1 or (times.size and times.dtype.kind not in "iu"):
            raise UsageError(
                "time must be int64 nanoseconds, a number or one axis", where=self.name
            )
        times = times.astype(np.int64)
        given = {key: value for key, value in extra.items() if value is not None}
        if self._extra is None:
            self._extra = frozenset(given)
        elif self._extra != frozenset(given):
            raise UsageError(
                "optional arrays come with every sample or with none: "
                f"{sorted(self._extra ^ frozenset(given))}",
                where=self.name,
            )
        if times.size:
            before = int(times[0]) - 1 if self._last_time is None else self._last_time
            steps = np.diff(times, prepend=before)
            if (steps <= 0).any():
                at = self.count + int(np.argmax(steps <= 0))
                raise UsageError(
                    f"time does not increase at sample {at}",
                    where=self.name,
                    fix="Keep the arrival order and nudge ties with "
                    "exumi_data.time.strictly_increasing.",
                )
            self._last_time = int(times[-1])
        columns = {}
        for key, value in given.items():
            dtype, names = _EXTRA[key]
            column = np.atleast_1d(np.asarray(value)).astype(dtype, casting="same_kind")
            if len(column) != len(times):
                raise UsageError(
                    f"{key} has {len(column)} samples, time {len(times)}", where=self.name
                )
            columns[key] = (column, dtype, names)
        self._array("time", np.int64).append(times)
        for key, (column, dtype, names) in columns.items():
            self._array(key, dtype, (), names).append(column)
        self.count += len(times)
        return len(times)

    def set_reference(
        self,
        image: np.ndarray,
        *,
        method: str,
        frames: Sequence[int] | None = None,
        contact_free: bool | None = None,
        algorithm: str | None = None,
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
        """
        if not isinstance(self.model, TactileStream):
            raise UsageError("only tactile streams have a reference", where=self.name)
        writer = ArrayWriter(
            self.folder / "reference",
            np.uint8,
            image.shape[1:],
            chunk_rows=image.shape[0],
            zstd=True,
            dimension_names=("y", "x", "c"),
        )
        writer.append(image)
        self._arrays["reference"] = writer
        values: dict[str, Any] = {"method": method}
        if frames is not None:
            values["frames"] = [int(frame) for frame in frames]
        if contact_free is not None:
            values["contact_free"] = contact_free
        if algorithm is not None:
            values["algorithm"] = algorithm
        self.model.reference = Reference(**values)

    def _complete(self) -> None:
        """Make the arrays that a stream without samples would lack."""
        self._array("time", np.int64)

    def finish(self) -> StreamModel:
        """Write what is pending; return the stream's final metadata."""
        self._complete()
        for writer in self._arrays.values():
            writer.finish()
        (self.folder / "zarr.json").write_bytes(group_document())
        self.model.arrays = list(self._arrays)
        return self.model

    def abort(self) -> None:
        """Close open files."""
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
        values = self._rows(data, self._dtype(data), self._row_shape(), scalar=scalar)
        count = 1 if scalar else len(time)
        raws = None
        if raw is not None:
            raws = np.asarray(raw)[None] if scalar else np.asarray(raw)
        for what, array in (("data", values), ("raw", raws)):
            if array is not None and len(array) != count:
                raise UsageError(f"{what} has {len(array)} samples, time {count}", where=self.name)
        if self.count and (raws is not None) != ("raw" in self._arrays):
            raise UsageError("raw comes with every sample or with none", where=self.name)
        self._append_time(
            time,
            {
                "time_host": time_host,
                "time_device": time_device,
                "sequence": sequence,
                "flags": flags,
            },
        )
        self._data_array(values).append(values)
        if raws is not None:
            names = tuple(f"raw_{i}" for i in range(raws.ndim - 1))
            self._array("raw", raws.dtype, raws.shape[1:], names).append(raws)

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

    def _dtype(self, data: Any) -> Any:
        if self._images() is not None:
            return np.uint8
        known = _DATA_LAYOUT.get(type(self.model), (None, ()))[0]
        if known is not None:
            return known
        dtype = np.asarray(data).dtype
        if isinstance(self.model, TaxelsStream) and dtype not in (np.int16, np.float32):
            raise UsageError(f"taxels are int16 or float32, not {dtype}", where=self.name)
        return dtype

    def _rows(
        self, data: Any, dtype: Any, row_shape: tuple[int, ...] | None, *, scalar: bool
    ) -> np.ndarray:
        values = np.asarray(data)
        values = values[None] if scalar else values
        if row_shape is not None and values.shape[1:] != row_shape:
            raise UsageError(
                f"a sample has shape {values.shape[1:]}, expected {row_shape}", where=self.name
            )
        if self._images() is not None and values.dtype != np.uint8:
            raise UsageError(f"frames are uint8, not {values.dtype}", where=self.name)
        return values.astype(dtype, copy=False)

    def _data_array(self, values: np.ndarray) -> ArrayWriter:
        images = self._images()
        if images is not None:
            return self._array("data", np.uint8, values.shape[1:], ("y", "x", "c"), rows=1)
        names = _DATA_LAYOUT.get(type(self.model), (None, None))[1]
        if names is None:
            names = tuple(f"axis_{i}" for i in range(values.ndim - 1))
        return self._array("data", values.dtype, values.shape[1:], names)

    def set_valid(self, valid: np.ndarray) -> None:
        """Store which taxels are alive, (R, C) bool."""
        if not isinstance(self.model, TaxelsStream):
            raise UsageError("only taxel streams have a valid mask", where=self.name)
        writer = ArrayWriter(
            self.folder / "valid",
            np.bool_,
            valid.shape[1:],
            chunk_rows=valid.shape[0],
            zstd=True,
            dimension_names=("row", "column"),
        )
        writer.append(valid)
        self._arrays["valid"] = writer

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
        files = [encoded] if isinstance(encoded, bytes) else list(encoded)
        if np.ndim(time) and len(time) != len(files):
            raise UsageError(f"{len(files)} frames, {len(time)} times", where=self.name)
        expected = (self._images.height, self._images.width, self._images.channels)
        for index, file in enumerate(files):
            size = jpeg.size_of(file)
            if size != expected:
                raise UsageError(
                    f"frame {self.count + index} is {size} (height, width, channels), "
                    f"expected {expected}",
                    where=self.name,
                )
        self._append_time(
            time,
            {
                "time_host": time_host,
                "time_device": time_device,
                "sequence": sequence,
                "flags": flags,
            },
        )
        ends = self._position + np.cumsum([len(file) for file in files], dtype=np.uint64)
        for file in files:
            self._data.append_bytes(file)
        self._offset.append(ends)
        self._crc.append(np.array([crc32c(file) for file in files], dtype=np.uint32))
        if files:
            self._position = int(ends[-1])


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
        self, source: Path | bytes, file: VideoFile, *, pts: np.ndarray, keyframe: np.ndarray
    ) -> None:
        """Append one container file and the times of its frames.

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

        Raises
        ------
        UsageError
            Times do not increase, or the arrays differ in length.
        """
        if len(pts) != len(keyframe):
            raise UsageError(f"{len(pts)} pts, {len(keyframe)} keyframes", where=self.name)
        scale = Fraction(file.time_base) * 1_000_000_000
        time = np.array([file.start_ns + round(int(p) * scale) for p in pts], dtype=np.int64)
        first = self.count
        self._append_time(time, {})
        self._array("file", np.uint32).append(np.full(len(pts), len(self._files), np.uint32))
        self._array("pts", np.int64).append(np.asarray(pts, np.int64))
        self._array("keyframe", np.uint64).append(
            np.asarray(keyframe, np.uint64) + np.uint64(first)
        )
        if isinstance(source, bytes):
            self._data.append_bytes(source)
        else:
            with source.open("rb") as reader:
                while piece := reader.read(_COPY_PIECE):
                    self._data.append_bytes(piece)
        self._position += file.bytes
        if self._data.rows != self._position:
            raise UsageError(
                f"{file.name} changed while it was read, or its size is wrong", where=self.name
            )
        self._offset.append(np.array([self._position], np.uint64))
        self._files.append(file)

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
