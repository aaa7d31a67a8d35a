"""An episode, read: metadata at once, arrays and frames when they are asked for."""

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from exumi_data.errors import DamagedDataError, NotAnEpisodeError, UsageError
from exumi_data.lazy import unlocked
from exumi_data.model.documents import parse_derived, parse_episode
from exumi_data.model.episode import DerivedMetadata, EpisodeMetadata
from exumi_data.model.images import EncodedImages, VideoImages
from exumi_data.model.streams import StreamModel, images_of
from exumi_data.store.access import Store, open_store

if TYPE_CHECKING:
    from exumi_data.store.images import EncodedFrames, Frames, VideoStreamFrames

__all__ = ["CALIBRATION_PATH", "Episode", "StreamView", "open_episode"]

CALIBRATION_PATH = re.compile(r"calibration(/[a-z][a-z0-9_]*)+")
"""Paths of arrays that are too big for JSON."""


@unlocked
class StreamView:
    """One stream of an episode.

    Parameters
    ----------
    episode : Episode
        The episode that it belongs to.
    name : str
        Its name there.
    metadata : StreamModel
        Clock, sensor, encoding and so on.

    Attributes
    ----------
    kind : str
        ``tactile``, ``rgb``, ``pose``, ``width``, ``wrench``, ``taxels``, ``audio`` or
        ``vendor:name``.
    """

    def __init__(self, episode: "Episode", name: str, metadata: StreamModel) -> None:
        self.name = name
        self.kind = metadata.kind
        self.metadata = metadata
        self._episode = episode
        self._path = f"streams/{name}"

    def __repr__(self) -> str:
        return f"<{self.kind} stream {self.name!r} of episode {self._episode.id}>"

    def __len__(self) -> int:
        from exumi_data.store.shards import open_array

        if "time" in self.__dict__:  # read already
            return len(self.time)
        return open_array(self._episode.store, f"{self._path}/time").shape[0]

    def array(self, name: str) -> np.ndarray:
        """Return one of the stream's arrays by name, whole.

        Parameters
        ----------
        name : str
            One of ``metadata.arrays``.

        Returns
        -------
        ndarray

        Raises
        ------
        UsageError
            The stream has no such array.
        DamagedDataError
            It has, but the array is missing or damaged.
        """
        from exumi_data.store.shards import open_array  # keeps the import light

        self._check_has(name)
        return open_array(self._episode.store, f"{self._path}/{name}").read()

    def rows(self, name: str, start: int, stop: int) -> np.ndarray:
        """Return part of one of the stream's arrays: for arrays that are too long to hold.

        Parameters
        ----------
        name : str
            One of ``metadata.arrays``.
        start, stop : int
            Along the first axis.

        Returns
        -------
        ndarray

        Raises
        ------
        UsageError
            The stream has no such array.
        DamagedDataError
            It has, but the array is missing or damaged.
        """
        from exumi_data.store.shards import open_array  # keeps the import light

        self._check_has(name)
        return open_array(self._episode.store, f"{self._path}/{name}").rows(start, stop)

    def _check_has(self, name: str) -> None:
        if name not in self.metadata.arrays:
            raise UsageError(
                f"stream {self.name!r} has no array {name!r}",
                where=self._episode.path,
                fix=f"It has: {', '.join(self.metadata.arrays)}.",
            )

    def _optional(self, name: str) -> np.ndarray | None:
        return self.array(name) if name in self.metadata.arrays else None

    @cached_property
    def time(self) -> np.ndarray:
        """(N,) int64: nanoseconds since the episode's start, strictly increasing."""
        time = self.array("time")
        if time.ndim != 1 or time.dtype != np.int64:
            raise DamagedDataError(
                f"`time` is {time.shape} {time.dtype}, expected (N,) int64",
                where=f"{self._episode.path}/{self._path}",
            )
        return time

    @property
    def time_host(self) -> np.ndarray | None:
        """(N,) int64 or None: the hub's monotonic clock, ns."""
        return self._optional("time_host")

    @property
    def time_device(self) -> np.ndarray | None:
        """(N,) int64 or None: the device's own clock, in ``metadata.time_device_unit``."""
        return self._optional("time_device")

    @property
    def sequence(self) -> np.ndarray | None:
        """(N,) uint64 or None: the device's own sample counter."""
        return self._optional("sequence")

    @property
    def flags(self) -> np.ndarray | None:
        """(N,) uint32 or None: bits of the registry."""
        return self._optional("flags")

    @property
    def data(self) -> np.ndarray:
        """The stream's values; pose (N, 7) float64, width (N,) float32 m, taxels (N, R, C)."""
        return self.array("data")

    @property
    def raw(self) -> np.ndarray | None:
        """The device's own values, or None."""
        return self._optional("raw")

    def samples(self, start: int, stop: int) -> np.ndarray:
        """Return a part of a stream's sound; nothing else is read.

        Parameters
        ----------
        start, stop : int
            From sample `start` to before sample `stop`, as ``offset`` counts them: block *i* of the
            stream is from ``array("offset")[i]`` to ``array("offset")[i + 1]``.

        Returns
        -------
        (stop - start, channels) int16

        Raises
        ------
        UsageError
            The stream is no sound, or has no such samples.
        """
        from exumi_data.store.shards import open_array  # keeps the import light

        if self.kind != "audio":
            raise UsageError(
                f"stream {self.name!r} is of kind {self.kind}, not audio", where=self._episode.path
            )
        array = open_array(self._episode.store, f"{self._path}/data")
        if not 0 <= start <= stop <= array.shape[0]:
            raise UsageError(
                f"samples {start} to {stop} of {array.shape[0]}",
                where=f"{self._episode.path}/{self._path}",
            )
        return array.rows(start, stop)

    @property
    def is_image(self) -> bool:
        """Whether the stream holds frames."""
        return images_of(self.metadata) is not None

    @cached_property
    def _frame_source(self) -> object:
        from exumi_data.store.images import open_frames  # needs an image codec

        images = images_of(self.metadata)
        if images is None:
            raise UsageError(
                f"stream {self.name!r} is of kind {self.kind} and has no frames",
                where=self._episode.path,
            )
        return open_frames(self._episode.store, self._path, images, len(self))

    @cached_property
    def frames(self) -> "Frames":
        """Frames: ``frames[i]`` is (H, W, C) uint8, slices and index arrays give (N, H, W, C)."""
        from exumi_data.store.images import Frames

        where = f"{self._episode.path}/{self._path}"
        return Frames(self._frame_source, self.metadata.images, where)  # type: ignore[arg-type,attr-defined]  # checked in _frame_source

    def encoded(self, index: int) -> bytes:
        """Return the bytes of one frame's own file, as the camera made them.

        Parameters
        ----------
        index : int
            The frame; negative counts from the end.

        Returns
        -------
        bytes

        Raises
        ------
        UsageError
            The stream's frames are no files of their own.
        """
        if not isinstance(images_of(self.metadata), EncodedImages):
            raise UsageError(
                f"frames of stream {self.name!r} are not stored as files of their own",
                where=self._episode.path,
                fix="Use .frames[i] for pixels, or .container(file) for a video file.",
            )
        source: EncodedFrames = self._frame_source  # type: ignore[assignment]  # by its encoding
        count = len(source)
        if not -count <= index < count:
            msg = f"frame {index} of {count}"
            raise IndexError(msg)
        return source.file(index % count)

    def container(self, file: int = 0) -> bytes:
        """Return the bytes of one video file, verbatim.

        Parameters
        ----------
        file : int
            Position in ``metadata.images.files``.

        Returns
        -------
        bytes

        Raises
        ------
        UsageError
            The stream is not stored as video.
        """
        if not isinstance(images_of(self.metadata), VideoImages):
            raise UsageError(
                f"stream {self.name!r} is not stored as video", where=self._episode.path
            )
        source: VideoStreamFrames = self._frame_source  # type: ignore[assignment]  # by its encoding
        return source.container(file)

    @cached_property
    def reference(self) -> np.ndarray | None:
        """(H, W, C) uint8 or None: the image without contact (tactile streams)."""
        return self._optional("reference")

    @property
    def valid(self) -> np.ndarray | None:
        """(R, C) bool or None: which taxels are alive."""
        return self._optional("valid")

    @cached_property
    def activity(self) -> np.ndarray | None:
        """(N,) float32 or None: fraction of active pixels of each tactile frame (derived)."""
        activity = self._episode.derived_array(f"{self.name}/activity")
        if activity is not None and activity.shape != (len(self),):
            raise DamagedDataError(
                f"activity of {activity.shape} for {len(self)} frames",
                where=f"{self._episode.path}/derived/{self.name}/activity",
            )
        return activity

    @property
    def salient(self) -> np.ndarray | None:
        """(K,) int64 or None: indices of the salient frames (derived)."""
        return self._episode.derived_array(f"{self.name}/salient")


@unlocked
class Episode:
    """An episode: a folder or a packed zip, opened for reading. Reading never writes.

    Parameters
    ----------
    store : Store
        Where its files are; `exumi_data.open` makes it from a path.

    Attributes
    ----------
    metadata : EpisodeMetadata
    streams : mapping of str to StreamView
    path : str
    root_sha256 : str
        Digest of the root document: it changes whenever the metadata does.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        self.path = store.location
        try:
            raw = store.read("zarr.json")
        except FileNotFoundError:
            raise NotAnEpisodeError(
                "no zarr.json: not an exUMI Episode, or one that was never finished",
                where=self.path,
            ) from None
        self.root_sha256 = hashlib.sha256(raw).hexdigest()
        self.metadata: EpisodeMetadata = parse_episode(raw, f"{self.path}/zarr.json")
        self._streams = {
            name: StreamView(self, name, model) for name, model in self.metadata.streams.items()
        }

    @property
    def id(self) -> str:
        """The episode's id, a UUID."""
        return self.metadata.id

    @property
    def streams(self) -> Mapping[str, StreamView]:
        """The streams by name."""
        return MappingProxyType(self._streams)

    def __getitem__(self, name: str) -> StreamView:
        try:
            return self._streams[name]
        except KeyError:
            raise UsageError(
                f"no stream {name!r}",
                where=self.path,
                fix=f"The episode has: {', '.join(self._streams) or 'none'}.",
            ) from None

    def __contains__(self, name: object) -> bool:
        return name in self._streams

    def __iter__(self) -> Iterator[str]:
        return iter(self._streams)

    def __repr__(self) -> str:
        return f"<Episode {self.id} ({', '.join(self._streams)})>"

    def of_kind(self, kind: str) -> list[StreamView]:
        """List the streams of a kind, in their order.

        Parameters
        ----------
        kind : str
            Such as ``tactile``.

        Returns
        -------
        list of StreamView
        """
        return [stream for stream in self._streams.values() if stream.kind == kind]

    @cached_property
    def derived(self) -> DerivedMetadata | None:
        """What is known of the derived arrays, or None when there are none."""
        try:
            raw = self.store.read("derived/zarr.json")
        except FileNotFoundError:
            return None
        return parse_derived(raw, f"{self.path}/derived/zarr.json")

    def derived_array(self, key: str) -> np.ndarray | None:
        """Return a derived array, or None when it was not computed.

        Parameters
        ----------
        key : str
            ``<stream>/<name>``, such as ``tactile_left/activity``.

        Returns
        -------
        ndarray or None
        """
        from exumi_data.store.shards import open_array  # keeps the import light

        if self.derived is None or key not in self.derived.items:
            return None
        return open_array(self.store, f"derived/{key}").read()

    def calibration_array(self, name: str, *, shape: tuple[int, ...] | None = None) -> np.ndarray:
        """Return the array of a calibration item.

        Parameters
        ----------
        name : str
            Of an item that has one.
        shape : tuple of int, optional
            Which it must have: nothing is read otherwise.

        Returns
        -------
        ndarray

        Raises
        ------
        UsageError
            There is no such item, or it has no array.
        DamagedDataError
            The array is missing, damaged or of another shape.
        """
        from exumi_data.store.shards import open_array  # keeps the import light

        item = self.metadata.calibration.get(name)
        if item is None or item.array is None:
            raise UsageError(f"no calibration array of {name!r}", where=self.path)
        if not CALIBRATION_PATH.fullmatch(item.array):
            raise DamagedDataError(f"{item.array!r} is no array below calibration", where=self.path)
        array = open_array(self.store, item.array)
        if shape is not None and array.shape != shape:
            raise DamagedDataError(
                f"an array of {array.shape}, expected {shape}", where=f"{self.path}/{item.array}"
            )
        return array.read()

    @property
    def duration_s(self) -> float:
        """From the first to the last sample of any stream, seconds."""
        # Python's integers: the difference of two hostile times does not fit into 64 bits.
        ends = [(int(s.time[0]), int(s.time[-1])) for s in self._streams.values() if len(s.time)]
        if not ends:
            return 0.0
        return float(max(b for _, b in ends) - min(a for a, _ in ends)) * 1e-9

    def digest(self) -> str:
        """Compute the episode's digest (sha-256, without ``derived/``)."""
        from exumi_data.store.digest import digest_of

        return digest_of(self.store)

    def check_complete(self) -> None:
        """Check that every array and every shard is there; reads no data.

        Raises
        ------
        DamagedDataError
            Names the first that is missing.
        """
        from exumi_data.store.shards import open_array

        for name, stream in self._streams.items():
            for array in stream.metadata.arrays:
                open_array(self.store, f"streams/{name}/{array}").check_shards()
        for key in self.derived.items if self.derived else ():
            open_array(self.store, f"derived/{key}").check_shards()

    def close(self) -> None:
        """Close open files."""
        self.store.close()

    def __enter__(self) -> "Episode":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> tuple[object, ...]:
        return (open_episode, (self.store.source,))


def open_episode(path: str | os.PathLike[str]) -> Episode:
    """Open one episode: a ``.zarr`` folder or a ``.zarr.zip``, or the URL of one.

    Raises
    ------
    NotAnEpisodeError, MetadataError, UnsupportedError, DamagedDataError, UnreachableError
    """
    text = os.fsdecode(path)
    name = text.rstrip("/").rpartition("/")[2]
    if name.startswith(".partial-"):
        raise DamagedDataError(
            "an episode that was never finished",
            where=text,
            fix="Run the command that was writing it again; it starts this episode anew.",
        )
    return Episode(open_store(path))
