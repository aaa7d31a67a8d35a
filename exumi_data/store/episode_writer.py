"""Writing an episode: aside, root metadata last, then renamed to its final name."""

import os
import shutil
from pathlib import Path
from typing import Any

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
from exumi_data.model.streams import Stream
from exumi_data.store.files import replace_folder, sync_tree
from exumi_data.store.shards import ArrayWriter
from exumi_data.store.stream_writer import (
    DataStreamWriter,
    EncodedStreamWriter,
    StreamWriter,
    VideoStreamWriter,
)

__all__ = ["EpisodeWriter"]

_STREAM: TypeAdapter[Any] = TypeAdapter(Stream)
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
    durable : bool
        Make every file survive a power loss before the final name appears.

    Raises
    ------
    EpisodeExistsError
        The final name is taken.
    UsageError
        The name does not end in ``.zarr``.

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
        durable: bool = True,
    ) -> None:
        self.path = Path(path)
        if not self.path.name.endswith(".zarr"):
            raise UsageError("an episode's name ends in .zarr", where=self.path)
        if self.path.exists() and not overwrite:
            raise EpisodeExistsError(
                "already exists", where=self.path, fix="Choose another name, or overwrite it."
            )
        self.metadata = metadata.model_copy(deep=True)
        self._durable = durable
        self._streams: dict[str, StreamWriter] = {}
        self._derived: dict[str, tuple[np.ndarray, DerivedItem]] = {}
        self._partial = self.path.with_name(f".partial-{metadata.id}")
        self._done = False
        if self._partial.exists():
            shutil.rmtree(self._partial)
        (self._partial / "streams").mkdir(parents=True)

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
            The name is taken.
        """
        if name in self._streams:
            raise UsageError(f"stream {name!r} is there already", where=self.path)
        try:
            model = _STREAM.validate_python(
                {"kind": kind, "clock": clock or _UNKNOWN_CLOCK, "arrays": [], **fields}
            )
        except ValidationError as error:
            problems = tuple(f"{message} @ {path}" for message, path in problems_of(error))
            raise MetadataError(
                f"stream {name!r}: {'; '.join(problems)}", where=self.path, problems=problems
            ) from None
        writer = self._make(name, model)
        self._streams[name] = writer
        return writer

    def _make(self, name: str, model: Any) -> StreamWriter:
        folder = self._partial / "streams" / name
        images = getattr(model, "images", None)
        if isinstance(images, EncodedImages):
            return EncodedStreamWriter(folder, name, model)
        if isinstance(images, VideoImages):
            return VideoStreamWriter(folder, name, model)
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
    ) -> None:
        """Store an array that was computed from a stream.

        Parameters
        ----------
        stream, name : str
            It is stored as ``derived/<stream>/<name>``.
        values : ndarray
            Such as activity (N,) float32 or salient (K,) int64.
        algorithm : str
            Id and version, such as ``exumi-activity/1``.
        parameters, inputs
            What it takes to compute it again.
        """
        item = DerivedItem(algorithm=algorithm, parameters=parameters or {}, inputs=inputs or [])
        self._derived[f"{stream}/{name}"] = (np.asarray(values), item)

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
        """
        if self._done:
            return self.path
        streams: dict[str, Any] = {name: w.finish() for name, w in self._streams.items()}
        self.metadata.streams = streams
        self._write_derived()
        (self._partial / "streams" / "zarr.json").write_bytes(group_document())
        root = episode_root_document(self.metadata)
        parse_episode(root, self.path)  # what we could not read again is never written
        (self._partial / "zarr.json").write_bytes(root)
        if self._durable:
            sync_tree(self._partial)
        replace_folder(self._partial, self.path)
        self._done = True
        return self.path

    def _write_derived(self) -> None:
        if not self._derived:
            return
        root = self._partial / "derived"
        for key, (values, _) in self._derived.items():
            writer = ArrayWriter(
                root / key,
                values.dtype,
                values.shape[1:],
                chunk_rows=8192,
                zstd=True,
                dimension_names=(
                    "time" if key.endswith("/activity") else "index",
                    *(f"axis_{i}" for i in range(values.ndim - 1)),
                ),
            )
            writer.append(values)
            writer.finish()
        for stream in {key.partition("/")[0] for key in self._derived}:
            (root / stream / "zarr.json").write_bytes(group_document())
        items = {key: item for key, (_, item) in self._derived.items()}
        (root / "zarr.json").write_bytes(derived_group_document(DerivedMetadata(items=items)))

    def abort(self) -> None:
        """Remove what was written. The final name never appears."""
        if self._done:
            return
        for writer in self._streams.values():
            writer.abort()
        shutil.rmtree(self._partial, ignore_errors=True)
        self._done = True
