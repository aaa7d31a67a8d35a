"""Writing an episode: aside, root metadata last, then renamed to its final name."""

import os
import re
import shutil
import weakref
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError

from exumi_data.errors import EpisodeExistsError, MetadataError, UsageError
from exumi_data.model.clock import Clock
from exumi_data.model.documents import (
    derived_group_document,
    episode_root_document,
    group_document,
    parse_episode,
    problems_of,
)
from exumi_data.model.episode import DerivedItem, DerivedMetadata, EpisodeMetadata
from exumi_data.model.images import ArrayImages, EncodedImages, VideoImages
from exumi_data.model.streams import AudioStream, Stream
from exumi_data.standard import derived_name_fault
from exumi_data.store.files import (
    claim_folder,
    replace_folder,
    sync_file_system,
    sync_tree,
)
from exumi_data.store.images import MAX_FRAME_BYTES
from exumi_data.store.stream_copy import CopiedStream, copy_files, write_array
from exumi_data.store.stream_writer import (
    AudioStreamWriter,
    DataStreamWriter,
    EncodedStreamWriter,
    StreamWriter,
    VideoStreamWriter,
)
from exumi_data.store.zarr_document import DTYPES, MAX_SHARD_BYTES

if TYPE_CHECKING:
    from exumi_data.episode import Episode, StreamView

__all__ = ["EpisodeWriter"]

_STREAM: TypeAdapter[Any] = TypeAdapter(Stream)
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_UNKNOWN_CLOCK = Clock(source="unknown", stamp_point="unknown")


class EpisodeWriter:
    """Write one episode with bounded memory; the final name appears only when it is complete.

    Parameters
    ----------
    path : path-like
        The final name, ``<something>.zarr``.
    metadata : EpisodeMetadata
        Everything but the streams, which `add_stream` adds.
    overwrite : bool
        Replace an existing episode (only once the new one is complete).
    durable : bool or "filesystem"
        Make every file survive a power loss before the final name appears. ``"filesystem"`` asks
        for all that is pending on the file system at once: much faster where many episodes are
        written, but not while something else is being recorded there.
    before_rename : callable, optional
        Called with the folder of the complete episode before it gets its final name, such as to
        read it back. What it raises gives the episode up.

    Attributes
    ----------
    derived : DerivedMetadata
        What is said of the derived arrays; `add_derived` fills its items.

    Raises
    ------
    EpisodeExistsError
        The final name is taken.
    UsageError
        The name does not end in ``.zarr``, or another process is writing this episode there.

    Examples
    --------
    >>> with EpisodeWriter(path, metadata) as writer:  # doctest: +SKIP
    ...     frames = Frames(parent="world", child="tcp")
    ...     pose = writer.add_stream("pose", kind="pose", frames=frames)
    ...     pose.append(time_ns, poses)
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        metadata: EpisodeMetadata,
        *,
        overwrite: bool = False,
        durable: bool | Literal["filesystem"] = True,
        before_rename: Callable[[Path], None] | None = None,
    ) -> None:
        self.path = Path(path)
        if not self.path.name.endswith(".zarr"):
            raise UsageError("an episode's name ends in .zarr", where=self.path)
        if self.path.exists() and not overwrite:
            raise EpisodeExistsError(
                "already exists", where=self.path, fix="Choose another name, or overwrite it."
            )
        self.metadata = metadata.model_copy(deep=True)
        self.derived = DerivedMetadata(items={})
        self._overwrite = overwrite
        self._durable = durable
        self._before_rename = before_rename
        self._streams: dict[str, StreamWriter | CopiedStream] = {}
        self._derived: dict[str, tuple[np.ndarray, DerivedItem]] = {}
        self._partial = self.path.with_name(f".partial-{metadata.id}")
        self._done = False
        self._release = weakref.finalize(self, os.close, claim_folder(self._partial))
        (self._partial / "streams").mkdir()

    def __enter__(self) -> "EpisodeWriter":
        return self

    def __exit__(self, error: object, *_: object) -> None:
        if error is None:
            try:
                self.finish()
            except BaseException:
                self.abort()
                raise
        else:
            self.abort()

    def add_stream(self, name: str, *, kind: str, clock: Clock | None = None, **fields: Any) -> Any:
        """Add a stream.

        Parameters
        ----------
        name : str
            Lower-case letters, digits and ``_``.
        kind : str
            A kind of the registry, or ``vendor:name``.
        clock : Clock, optional
            Default: said to be unknown.
        **fields
            The other fields of the kind's model (`exumi_data.model`), checked at once.

        Returns
        -------
        DataStreamWriter, EncodedStreamWriter or VideoStreamWriter
            By `images.encoding` for image kinds, else a `DataStreamWriter`.

        Raises
        ------
        MetadataError
            A field is wrong or missing.
        UsageError
            The name is taken or is none, or the frames are too large.
        """
        self._check_open()
        self._check_name(name)
        if name in self._streams:
            raise UsageError(f"stream {name!r} is there already", where=self.path)
        try:
            model = _STREAM.validate_python(
                {"kind": kind, "clock": clock or _UNKNOWN_CLOCK, "arrays": [], **fields},
                context={"newer_minor": self.metadata.is_newer_minor},
            )
        except ValidationError as error:
            found = problems_of(error, below=("streams", name))
            problems = tuple(f"{message} @ {path}" for message, path in found)
            raise MetadataError(
                f"stream {name!r}: {'; '.join(problems)}", where=self.path, problems=problems
            ) from None
        writer = self._make(name, model)
        self._streams[name] = writer
        return writer

    def copy_stream(
        self,
        episode: "Episode",
        name: str,
        *,
        changed: Mapping[str, np.ndarray] | None = None,
        **fields: Any,
    ) -> None:
        """Take over a stream of another episode, byte for byte, under its own name.

        Parameters
        ----------
        episode : Episode
            The other episode; it should have been checked (`Episode.check_complete`).
        name : str
        changed : mapping of str to ndarray, optional
            Arrays of one value a sample that are written instead: `time`, `data` of widths, poses
            and the like, `flags`, which may also be new. Whoever changes `time` states the `clock`
            by which it was computed.
        **fields
            Fields of the stream's metadata that change, such as `clock`.

        Raises
        ------
        UsageError
            The name is taken, the other episode has no such stream, an array has another length or
            type, or times do not increase.
        DamagedDataError
            A file is cut short.
        """
        self._check_open()
        if name in self._streams:
            raise UsageError(f"stream {name!r} is there already", where=self.path)
        stream = episode[name]
        for array, values in (changed or {}).items():
            self._check_changed(stream, array, values)
        model = stream.metadata.model_copy(update=fields)
        folder = self._partial / "streams" / name
        path = f"streams/{name}"
        self._streams[name] = CopiedStream(folder, episode.store, path, model, changed)

    def _check_changed(self, stream: "StreamView", array: str, values: np.ndarray) -> None:
        where = f"{self.path}/streams/{stream.name}/{array}"
        if array not in ("time", "data", "flags"):
            raise UsageError("is what the device said, and is never changed", where=where)
        there = stream.array(array) if array in stream.metadata.arrays else None
        dtype = np.dtype(np.uint32) if there is None else there.dtype
        shape = (len(stream),) if there is None else there.shape
        if (values.shape, values.dtype) != (shape, dtype):
            raise UsageError(
                f"is {values.shape} {values.dtype}, expected {shape} {dtype}", where=where
            )
        if array == "time" and not (values[1:] > values[:-1]).all():
            raise UsageError("does not increase", where=where)

    def copy_group(
        self,
        episode: "Episode",
        name: Literal["calibration", "annotations"],
        *,
        without: Collection[str] = (),
    ) -> None:
        """Take over the arrays that another episode keeps beside its streams, byte for byte.

        Parameters
        ----------
        episode : Episode
            The other episode.
        name : {"calibration", "annotations"}
        without : collection of str, optional
            Paths of arrays to leave out, such as ``calibration/map``; groups that hold nothing
            else are left out as well.
        """
        self._check_open()
        copy_files(episode.store, name, self._partial / name, without)

    def add_calibration_array(
        self, name: str, values: np.ndarray, *, dimension_names: Sequence[str] | None = None
    ) -> None:
        """Store an array of calibration values, too big for JSON.

        Parameters
        ----------
        name : str
            It is stored as ``calibration/<name>``; an item of ``metadata.calibration`` has this as
            its `array`. Names may be divided by ``/``, as in ``tactile_reference/tactile_left``.
        values : ndarray
            Of at least one axis.
        dimension_names : sequence of str, optional
            Names of the axes.

        Raises
        ------
        UsageError
            The name is none or taken, or the array cannot be stored.
        """
        self._check_open()
        parts = name.split("/")
        for part in parts:
            self._check_name(part)
        array = self._storable(name, values)
        names = dimension_names or [f"axis_{i}" for i in range(array.ndim)]
        root = self._partial / "calibration"
        if (root / name).exists() or len(names) != array.ndim:
            raise UsageError(
                f"calibration/{name} is there already, or its axes are not {len(names)}",
                where=self.path,
            )
        groups = [root.joinpath(*parts[:depth]) for depth in range(len(parts))]
        if any((group / "c").exists() for group in groups[1:]):
            raise UsageError(f"calibration/{name} lies inside another array", where=self.path)
        write_array(root / name, array, tuple(names))
        for group in groups:
            (group / "zarr.json").write_bytes(group_document())

    def _storable(self, name: str, values: np.ndarray) -> np.ndarray:
        array = np.asarray(values)
        if not array.ndim or array.dtype.name not in DTYPES:
            raise UsageError(
                f"{name} of shape {array.shape} {array.dtype} cannot be stored", where=self.path
            )
        return array

    def _check_open(self) -> None:
        if self._done:
            raise UsageError("the episode is finished or was given up", where=self.path)

    def _check_name(self, name: str) -> None:
        # It becomes the name of a folder.
        if not _NAME.fullmatch(name):
            raise UsageError(
                f"{name!r} is no name",
                where=self.path,
                fix="Names are lower-case letters, digits and _, and begin with a letter.",
            )

    def _check_derived(self, stream: str, name: str, kind: str | None) -> None:
        # A newer minor version may name arrays that this one does not know.
        fault = None if self.derived.is_newer_minor else derived_name_fault(name, kind)
        if fault:
            raise UsageError(
                f"derived/{stream}/{name} has a name that means nothing: {fault}",
                where=self.path,
                fix="Correct its spelling, or name an array of your own <vendor>__<name>.",
            )

    def _make(self, name: str, model: Any) -> StreamWriter:
        folder = self._partial / "streams" / name
        images = getattr(model, "images", None)
        if images is not None:
            most = MAX_SHARD_BYTES if images.encoding == "array" else MAX_FRAME_BYTES
            if images.height * images.width * images.channels > most:
                raise UsageError(
                    f"frames of {images.height}x{images.width} are larger than {most:,} bytes",
                    where=f"{self.path}: {name}",
                )
        if isinstance(images, EncodedImages):
            return EncodedStreamWriter(folder, name, model)
        if isinstance(images, VideoImages):
            return VideoStreamWriter(folder, name, model)
        if isinstance(model, AudioStream):
            return AudioStreamWriter(folder, name, model)
        assert images is None or isinstance(images, ArrayImages)  # noqa: S101  # the union is closed
        return DataStreamWriter(folder, name, model)

    def add_derived(
        self,
        stream: str,
        name: str,
        values: np.ndarray,
        *,
        algorithm: str,
        parameters: dict[str, Any] | None = None,
        inputs: list[str] | None = None,
        **fields: Any,
    ) -> None:
        """Store an array that was computed from a stream.

        Parameters
        ----------
        stream, name : str
            It is stored as ``derived/<stream>/<name>``. A name of the registry, or your own of the
            form ``<vendor>__<name>``.
        values : ndarray
            Such as activity (N,) float32 or salient (K,) int64.
        algorithm : str
            Id and version, such as ``exumi-activity/1``.
        parameters, inputs
            What it takes to compute it again.
        **fields
            Keys of third parties.

        Raises
        ------
        MetadataError
            A field is wrong.
        UsageError
            A name is none or means nothing, or the array cannot be stored.
        """
        self._check_open()
        self._check_name(stream)
        self._check_name(name)
        self._check_derived(stream, name, None)  # the stream may be added later
        array = self._storable(name, values)
        given = {"parameters": parameters or {}, "inputs": inputs or [], **fields}
        try:
            item = DerivedItem.model_validate(
                {"algorithm": algorithm, **given},
                context={"newer_minor": self.derived.is_newer_minor},
            )
        except ValidationError as error:
            found = problems_of(error, below=("items", f"{stream}/{name}"))
            problems = tuple(f"{message} @ {path}" for message, path in found)
            raise MetadataError("; ".join(problems), where=self.path, problems=problems) from None
        self._derived[f"{stream}/{name}"] = (array, item)

    def copy_derived(self, episode: "Episode") -> None:
        """Take over the arrays that were derived from another episode's streams, and their account.

        Parameters
        ----------
        episode : Episode
            The other episode; what its arrays were computed from is the same in this one.

        Raises
        ------
        UsageError
            An array has a name that means nothing.
        """
        self._check_open()
        if episode.derived is None:
            return
        self.derived = episode.derived.model_copy(deep=True)
        for key, item in episode.derived.items.items():
            stream, _, name = key.partition("/")
            values = episode.derived_array(key)
            if values is not None:
                said = {key: getattr(item, key) for key in ("algorithm", "parameters", "inputs")}
                self.add_derived(stream, name, values, **said, **(item.model_extra or {}))

    def finish(self) -> Path:
        """Complete the episode and give it its final name.

        Returns
        -------
        pathlib.Path
            The final path.

        Raises
        ------
        MetadataError
            The metadata as a whole breaks the standard.
        UsageError
            A stream was not written whole, or a derived array has no stream, or one of a kind that
            it is not computed from.
        EpisodeExistsError
            Another process finished this episode meanwhile.
        """
        if self._done:
            return self.path
        for key in self._derived:
            stream, _, name = key.partition("/")
            if stream not in self._streams:
                raise UsageError(f"derived/{key} belongs to no stream", where=self.path)
            self._check_derived(stream, name, self._streams[stream].model.kind)
        streams: dict[str, Any] = {name: w.finish() for name, w in self._streams.items()}
        self.metadata.streams = streams
        self._write_derived()
        (self._partial / "streams" / "zarr.json").write_bytes(group_document())
        root = episode_root_document(self.metadata)
        parse_episode(root, self.path)  # what we could not read again is never written
        (self._partial / "zarr.json").write_bytes(root)
        if self._durable and not (
            self._durable == "filesystem" and sync_file_system(self._partial)
        ):
            sync_tree(self._partial)
        if self._before_rename is not None:
            self._before_rename(self._partial)
        if self.path.exists() and not self._overwrite:
            raise EpisodeExistsError("was written by another process meanwhile", where=self.path)
        replace_folder(self._partial, self.path)
        self._done = True
        self._release()
        return self.path

    def _write_derived(self) -> None:
        if not self._derived:
            return
        root = self._partial / "derived"
        for key, (values, _) in self._derived.items():
            first = "time" if key.endswith("/activity") else "index"
            others = (f"axis_{i}" for i in range(values.ndim - 1))
            write_array(root / key, values, (first, *others))
        for stream in {key.partition("/")[0] for key in self._derived}:
            (root / stream / "zarr.json").write_bytes(group_document())
        self.derived.items = {key: item for key, (_, item) in self._derived.items()}
        (root / "zarr.json").write_bytes(derived_group_document(self.derived))

    def abort(self) -> None:
        """Remove what was written. The final name never appears."""
        if self._done:
            return
        for writer in self._streams.values():
            writer.abort()
        shutil.rmtree(self._partial, ignore_errors=True)
        self._done = True
        self._release()
