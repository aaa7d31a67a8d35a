"""The three encodings of an image stream, read as frames (spec: Images).

``frames[i]`` is (H, W, C) uint8; slices and index arrays give (N, H, W, C). `read_into` decodes
into the caller's buffer, with luma instead of RGB where the buffer has one channel.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, SupportsIndex, overload

import numpy as np

from exumi_data.errors import DamagedDataError, LimitError, UsageError
from exumi_data.lazy import unlocked
from exumi_data.model.images import ArrayImages, EncodedImages, VideoImages
from exumi_data.store import jpeg
from exumi_data.store.access import Store
from exumi_data.store.array_file import open_bytes
from exumi_data.store.shards import ArrayReader, crc32c, open_array
from exumi_data.store.zarr_document import MAX_WHOLE_READ

if TYPE_CHECKING:
    from typing import IO

    from exumi_data.store.video import VideoFrames

__all__ = [
    "MAX_FRAME_BYTES",
    "ArrayFrames",
    "EncodedFrames",
    "Frames",
    "VideoStreamFrames",
    "open_frames",
]

MAX_FRAME_BYTES = 1 << 28
"""Size of the largest frame, decoded."""
_OPEN_VIDEO_FILES = 2
_MAX_VIDEO_BYTES = 8 << 30
_WHOLE_VIDEO_BYTES = 8 << 20  # up to this a video file is read at once, beyond where it is needed


class _Source(Protocol):
    @property
    def store(self) -> Store: ...
    def __len__(self) -> int: ...
    def read_into(self, index: int, out: np.ndarray) -> None: ...
    def ranges(self, index: int) -> list[tuple[str, int, int]]: ...


class Frames:
    """Frames of one image stream.

    Attributes
    ----------
    shape : tuple of int
        (N, H, W, C).
    """

    dtype = np.dtype(np.uint8)

    def __init__(
        self, source: _Source, images: ArrayImages | EncodedImages | VideoImages, where: str
    ) -> None:
        size = images.height * images.width * images.channels
        if size > MAX_FRAME_BYTES:
            raise LimitError(f"a frame of {size:,} bytes", where=where)
        self._source = source
        self._where = where
        self.shape = (len(source), images.height, images.width, images.channels)
        self._fitting = ((images.height, images.width, 1), self.shape[1:])

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[np.ndarray]:
        for index in range(len(self)):
            yield self._read_one(index)

    @overload
    def __getitem__(self, key: SupportsIndex) -> np.ndarray: ...
    @overload
    def __getitem__(self, key: slice | Sequence[int] | np.ndarray) -> np.ndarray: ...
    def __getitem__(self, key: SupportsIndex | slice | Sequence[int] | np.ndarray) -> np.ndarray:
        """Return one frame (H, W, C), or several (N, H, W, C)."""
        if isinstance(key, slice):
            return self.read(range(*key.indices(len(self))))
        if isinstance(key, np.ndarray | Sequence):
            indices = np.asarray(key)
            if indices.dtype == np.bool_:
                if indices.shape != (len(self),):
                    msg = f"a mask of shape {indices.shape} for {len(self)} frames"
                    raise IndexError(msg)
                indices = np.flatnonzero(indices)
            if indices.ndim != 1 or (indices.size and indices.dtype.kind not in "iu"):
                msg = "frames take an index, a slice, or a one-dimensional array of indices"
                raise IndexError(msg)
            return self.read([self._position(int(i)) for i in indices])
        return self._read_one(self._position(int(key.__index__())))

    def _position(self, index: int) -> int:
        count = len(self)
        if not -count <= index < count:
            msg = f"frame {index} of {count}"
            raise IndexError(msg)
        return index % count

    def _read_one(self, index: int) -> np.ndarray:
        out = np.empty(self.shape[1:], dtype=np.uint8)
        self._source.read_into(index, out)
        return out

    def read(self, indices: Iterable[int], *, grey: bool = False) -> np.ndarray:
        """Decode frames, in the given order.

        Parameters
        ----------
        indices : iterable of int
            Each in [0, N).
        grey : bool
            Give luma, one channel.

        Returns
        -------
        (K, H, W, C) uint8

        Raises
        ------
        LimitError
            They are more than 2 GiB: read fewer at a time, or `iterate`.
        """
        # A length is asked for first: metadata could claim more frames than a list can hold.
        chosen = indices if isinstance(indices, Sequence) else list(indices)
        size = len(chosen) * math.prod(self.shape[1:])
        if size > MAX_WHOLE_READ:
            raise self._too_much(len(chosen), size)
        channels = 1 if grey else self.shape[3]
        try:
            out = np.empty((len(chosen), *self.shape[1:3], channels), dtype=np.uint8)
        except MemoryError:
            raise self._too_much(len(chosen), size) from None
        self.read_into(chosen, out)
        return out

    def _too_much(self, frames: int, size: int) -> LimitError:
        return LimitError(
            f"{frames:,} frames are {size:,} bytes; at most {MAX_WHOLE_READ:,} are read at once, "
            "and no more than there is memory",
            where=self._where,
            fix="Read fewer frames at a time.",
        )

    def read_into(self, indices: Sequence[int] | np.ndarray, out: np.ndarray) -> None:
        """Decode frames into a buffer.

        Parameters
        ----------
        indices : (K,) int
            Each in [0, N). A frame that is asked for twice in a row is decoded once.
        out : (K, H, W, C) uint8, C-contiguous
            C = 1 asks for luma.

        Raises
        ------
        DamagedDataError
            Names the stream and the frame.
        IndexError
            There is no such frame.
        UsageError
            The buffer is not of that kind.
        """
        shape, count, read = out.shape, self.shape[0], self._source.read_into
        if (
            out.dtype != self.dtype
            or not shape
            or shape[0] != len(indices)
            or shape[1:] not in self._fitting
        ):
            raise UsageError(
                f"a buffer of {shape} {out.dtype} for {len(indices)} frames of {self.shape[1:]}",
                where=self._where,
            )
        previous = -1
        for position, index in enumerate(indices):
            index = int(index)  # noqa: PLW2901  # numpy integers are slow as indices
            if not 0 <= index < count:
                msg = f"frame {index} of {count}"
                raise IndexError(msg)
            if index == previous:
                out[position] = out[position - 1]
            else:
                read(index, out[position])
            previous = index

    def file(self, index: int) -> bytes:
        """Return the bytes of one frame's own file, checked against its checksum.

        Parameters
        ----------
        index : int
            In [0, N).

        Raises
        ------
        DamagedDataError
            Names the stream and the frame.
        IndexError
            There is no such frame.
        UsageError
            The frames are not stored as files of their own.
        """
        if not isinstance(self._source, EncodedFrames):
            raise UsageError("frames are not stored as files of their own", where=self._where)
        if not 0 <= index < len(self):
            msg = f"frame {index} of {len(self)}"
            raise IndexError(msg)
        return self._source.file(index)

    @property
    def store(self) -> Store:
        """Where the bytes of the frames are."""
        return self._source.store

    def get_ready(self) -> None:
        """Read what says where frames are, so that reading one reads nothing else.

        Raises
        ------
        DamagedDataError
            These arrays are missing or damaged.
        """
        if len(self):
            self._source.ranges(0)
            if isinstance(self._source, EncodedFrames):
                _ = self._source.crc32c

    def ranges(self, indices: Iterable[int]) -> list[tuple[str, int, int]]:
        """Return which bytes of the store hold frames: (path, start, length) each.

        Parameters
        ----------
        indices : iterable of int
            Each in [0, N).

        Raises
        ------
        DamagedDataError
            The arrays that say where frames are, are damaged.
        """
        return [found for index in indices for found in self._source.ranges(index)]

    def iterate(self, *, grey: bool = False) -> Iterator[np.ndarray]:
        """Yield every frame in order, (H, W, C) uint8; memory stays at one frame."""
        for index in range(len(self)):
            out = np.empty((*self.shape[1:3], 1 if grey else self.shape[3]), dtype=np.uint8)
            self._source.read_into(index, out)
            yield out


def _to_grey(frame: np.ndarray, out: np.ndarray) -> None:
    import cv2  # needed only for RGB arrays read as grey

    out[..., 0] = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)


class ArrayFrames:
    """Encoding ``array``."""

    def __init__(self, store: Store, path: str, images: ArrayImages, count: int) -> None:
        self.store = store
        self._data = open_array(store, f"{path}/data")
        expected = (count, images.height, images.width, images.channels)
        self._where = f"{store.location}/{path}"
        if self._data.shape != expected or self._data.dtype != np.uint8:
            raise DamagedDataError(
                f"`data` has shape {self._data.shape} {self._data.dtype}, "
                f"the metadata says {expected} uint8",
                where=self._where,
            )

    def __len__(self) -> int:
        return self._data.shape[0]

    def read_into(self, index: int, out: np.ndarray) -> None:
        """Read one frame."""
        frame = self._data.rows(index, index + 1)[0]
        if out.shape == frame.shape:
            out[:] = frame
        else:
            _to_grey(frame, out)

    def ranges(self, index: int) -> list[tuple[str, int, int]]:
        """Return which bytes hold one frame."""
        size = self._data.document.row_bytes
        return self._data.ranges(index * size, size)


@unlocked
class EncodedFrames:
    """Encoding ``encoded``: image files end to end."""

    def __init__(self, store: Store, path: str, images: EncodedImages, count: int) -> None:
        self.store = store
        self._path = path
        self._where = f"{store.location}/{path}"
        self._count = count
        self._channels = images.channels

    def __len__(self) -> int:
        return self._count

    @cached_property
    def _data(self) -> ArrayReader:
        data = open_array(self.store, f"{self._path}/data")
        if len(data.shape) != 1 or data.dtype != np.uint8:
            raise DamagedDataError("`data` is not one-dimensional uint8", where=self._where)
        return data

    @cached_property
    def offset(self) -> np.ndarray:
        """(N+1,) uint64: where each file begins and ends."""
        reader = open_array(self.store, f"{self._path}/offset")
        if reader.shape != (self._count + 1,) or reader.dtype.kind != "u":
            raise DamagedDataError(
                f"`offset` has shape {reader.shape} {reader.dtype}, expected "
                f"({self._count + 1},) uint64",
                where=self._where,
            )
        offset = reader.read()
        if offset[0] != 0 or (offset[1:] < offset[:-1]).any() or offset[-1] > self._data.shape[0]:
            raise DamagedDataError("`offset` does not ascend within `data`", where=self._where)
        return offset

    @cached_property
    def crc32c(self) -> np.ndarray:
        """(N,) uint32: checksum of each file."""
        reader = open_array(self.store, f"{self._path}/crc32c")
        if reader.shape != (self._count,) or reader.dtype != np.uint32:
            raise DamagedDataError("`crc32c` does not match the frames", where=self._where)
        return reader.read()

    def file(self, index: int) -> bytes:
        """Return the bytes of one frame's file, checked against its checksum."""
        start, stop = int(self.offset[index]), int(self.offset[index + 1])
        if stop - start > MAX_FRAME_BYTES:
            raise LimitError(f"frame {index} has {stop - start:,} bytes", where=self._where)
        data = self._data.bytes_at(start, stop - start)
        if crc32c(data) != self.crc32c[index]:
            raise DamagedDataError(
                f"frame {index} has a wrong checksum",
                where=self._where,
                fix="Copy the episode again from its source.",
            )
        return data

    def read_into(self, index: int, out: np.ndarray) -> None:
        """Decode one frame."""
        data = self.file(index)
        try:
            jpeg.decode_into(data, out)
        except DamagedDataError as error:
            raise DamagedDataError(f"frame {index}: {error.what}", where=self._where) from None

    def ranges(self, index: int) -> list[tuple[str, int, int]]:
        """Return which bytes hold one frame's file."""
        start, stop = int(self.offset[index]), int(self.offset[index + 1])
        return self._data.ranges(start, stop - start) if stop - start <= MAX_FRAME_BYTES else []


@unlocked
class VideoStreamFrames:
    """Encoding ``video``: container files, decoded from memory."""

    def __init__(self, store: Store, path: str, images: VideoImages, count: int) -> None:
        self.store = store
        self._path = path
        self._where = f"{store.location}/{path}"
        self._images = images
        self._count = count
        self._open: dict[int, _OpenVideo] = {}

    def __len__(self) -> int:
        return self._count

    def _per_frame(self, name: str, dtype: str) -> np.ndarray:
        reader = open_array(self.store, f"{self._path}/{name}")
        if reader.shape != (self._count,) or reader.dtype != np.dtype(dtype):
            raise DamagedDataError(
                f"`{name}` has shape {reader.shape} {reader.dtype}, expected "
                f"({self._count},) {dtype}",
                where=self._where,
            )
        return reader.read()

    @cached_property
    def file_index(self) -> np.ndarray:
        """(N,) uint32: the file of each frame, ascending."""
        files = self._per_frame("file", "uint32")
        if files.size and (
            (files[1:] < files[:-1]).any() or int(files[-1]) >= len(self._images.files)
        ):
            raise DamagedDataError("`file` does not ascend within the files", where=self._where)
        return files

    @cached_property
    def pts(self) -> np.ndarray:
        """(N,) int64: presentation time in units of the file's time base."""
        return self._per_frame("pts", "int64")

    @cached_property
    def keyframe(self) -> np.ndarray:
        """(N,) uint64: index of the frame to start decoding from."""
        keyframe = self._per_frame("keyframe", "uint64")
        if (keyframe > np.arange(self._count, dtype=np.uint64)).any():
            raise DamagedDataError("`keyframe` points forward", where=self._where)
        return keyframe

    @cached_property
    def offset(self) -> np.ndarray:
        """(F+1,) uint64: where each file begins and ends."""
        reader = open_array(self.store, f"{self._path}/offset")
        if reader.shape != (len(self._images.files) + 1,) or reader.dtype.kind != "u":
            raise DamagedDataError("`offset` does not match the files", where=self._where)
        offset = reader.read()
        if offset[0] != 0 or (offset[1:] < offset[:-1]).any():
            raise DamagedDataError("`offset` does not ascend", where=self._where)
        return offset

    def container(self, file: int) -> bytes:
        """Return one container file's bytes, verbatim."""
        start, stop = self._place(file)
        return open_array(self.store, f"{self._path}/data").bytes_at(start, stop - start)

    def _place(self, file: int) -> tuple[int, int]:
        if not 0 <= file < len(self._images.files):
            msg = f"video file {file} of {len(self._images.files)}"
            raise IndexError(msg)
        start, stop = int(self.offset[file]), int(self.offset[file + 1])
        if stop - start > _MAX_VIDEO_BYTES:
            raise LimitError(f"video file {file} has {stop - start:,} bytes", where=self._where)
        return start, stop

    def _source(self, file: int) -> "bytes | IO[bytes]":
        start, stop = self._place(file)
        array = open_array(self.store, f"{self._path}/data")
        if stop - start <= _WHOLE_VIDEO_BYTES or array.document.zstd:
            return array.bytes_at(start, stop - start)
        return open_bytes(array, start, stop)

    def read_into(self, index: int, out: np.ndarray) -> None:
        """Decode one frame."""
        file = int(self.file_index[index])
        video = self._open.get(file)
        if video is None:
            while len(self._open) >= _OPEN_VIDEO_FILES:
                self._open.pop(next(iter(self._open))).frames.close()
            video = self._open_file(file)
            self._open[file] = video
        video.frames.read_into(index - video.first, out)

    def ranges(self, index: int) -> list[tuple[str, int, int]]:
        """Return nothing: a video file is read when its frames are."""
        return []

    def _open_file(self, file: int) -> "_OpenVideo":
        from exumi_data.store.video import VideoFrames, most_pixels  # PyAV is slow to import

        first, last = np.searchsorted(self.file_index, [file, file + 1])
        keyframe = self.keyframe[first:last].astype(np.int64) - first
        if (keyframe < 0).any():
            raise DamagedDataError("`keyframe` points into another file", where=self._where)
        where = f"{self._where} ({self._images.files[file].name})"
        frames = VideoFrames(
            self._source(file),
            self.pts[first:last],
            keyframe,
            where,
            pixels=most_pixels(self._images.height, self._images.width),
        )
        return _OpenVideo(int(first), frames)


class _OpenVideo:
    def __init__(self, first: int, frames: "VideoFrames") -> None:
        self.first = first
        self.frames = frames


def open_frames(
    store: Store, path: str, images: ArrayImages | EncodedImages | VideoImages, count: int
) -> ArrayFrames | EncodedFrames | VideoStreamFrames:
    """Open the frames of a stream of `count` samples, whatever their encoding."""
    if isinstance(images, ArrayImages):
        return ArrayFrames(store, path, images, count)
    if isinstance(images, EncodedImages):
        return EncodedFrames(store, path, images, count)
    return VideoStreamFrames(store, path, images, count)
