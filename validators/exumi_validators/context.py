"""An episode as the checks see it: everything that can be understood, read once, bounded."""

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, cached_property
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter

from exumi_data.episode import CALIBRATION_PATH
from exumi_data.errors import DamagedDataError, ExumiError, LimitError, UnsupportedError
from exumi_data.extensions import StreamKind, find_stream_kind
from exumi_data.model.base import VERSION, Model
from exumi_data.model.description import CalibrationItem
from exumi_data.model.documents import KNOWN_FEATURES
from exumi_data.model.episode import (
    EPISODE_FORMAT,
    FORMAT_VERSION,
    DerivedItem,
    EpisodeMetadata,
)
from exumi_data.model.streams import ExtensionStream, Stream, StreamModel, images_of
from exumi_data.standard import (
    ArraySpec,
    Rule,
    common_arrays,
    derived_arrays,
    encodings,
    kinds,
    rules,
)
from exumi_data.store.access import FolderStore, ZipStore
from exumi_data.store.shards import ArrayReader
from exumi_data.store.zarr_document import ArrayDocument, layout_of
from exumi_validators.expected_shapes import fits
from exumi_validators.frame_statistics import FrameStatistics
from exumi_validators.json_documents import LoadedDocument, load_document
from exumi_validators.listing import Listing
from exumi_validators.model_problems import parse_leniently
from exumi_validators.nodes import ArrayNode, array_problems, parse_array_node
from exumi_validators.report import Problem
from exumi_validators.shards import judge_shards

__all__ = ["CALIBRATION_PATH", "EXUMI", "ROOT", "EpisodeContext", "newer_minor", "understood"]

ROOT = "zarr.json"
EXUMI = ("attributes", "exumi")
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_DERIVED_KEY = re.compile(r"[a-z][a-z0-9_]*/[a-z][a-z0-9_]*")
_MAX_NODE_BYTES = 1 << 20
_BLOCK_BYTES = 4 << 20
_SMALL_BYTES = 1 << 20
_MAX_BLOCK_BYTES = 64 << 20
_MAX_BLOCK_ROWS = 1 << 20  # some checks make Python objects of them
_MAX_CACHED_BYTES = 64 << 20
_METADATA: TypeAdapter[Any] = TypeAdapter(EpisodeMetadata)
_STREAM: TypeAdapter[Any] = TypeAdapter(Stream)
_DERIVED_ITEM: TypeAdapter[Any] = TypeAdapter(DerivedItem)


M = TypeVar("M", bound=Model)
Pointer = tuple[int | str, ...]


@cache
def _adapter(section: str) -> TypeAdapter[Any]:
    annotation: Any = EpisodeMetadata.model_fields[section].annotation
    return TypeAdapter(annotation)


@cache
def _adapter_of(model: type[Model]) -> TypeAdapter[Any]:
    return TypeAdapter(model)


def newer_minor(version: object) -> bool | None:
    """Whether a version is a newer minor one than this library's; None when it is not readable.

    Parameters
    ----------
    version : object
        ``major.minor``, as it stands in a document.
    """
    if not isinstance(version, str) or not re.fullmatch(VERSION, version):
        return None
    major, minor = (int(part) for part in version.split("."))
    known_major, known_minor = (int(part) for part in FORMAT_VERSION.split("."))
    return minor > known_minor if major == known_major else None


def understood(document: dict[str, Any]) -> bool:
    """Whether a document is of a version, and needs only features, that are known.

    Parameters
    ----------
    document : dict
    """
    requires = document.get("requires", [])
    features = {str(f) for f in requires} if isinstance(requires, list) else set()
    return newer_minor(document.get("version")) is not None and features <= KNOWN_FEATURES


class EpisodeContext:
    """One episode under validation.

    Parameters
    ----------
    store : FolderStore or ZipStore
    listing : Listing
        Its files.
    limits : mapping, optional
        Numbers to judge by in place of those in the table of rules, by the rule's id.

    Attributes
    ----------
    frames : int
        Frames that were decoded so far.
    unreadable : dict
        Arrays that turned out to be unreadable, with the reason.
    scanned : set
        Arrays that were read to their end.
    frame_statistics : dict
        Tactile stream to the statistics of its frames, once they were decoded.
    """

    def __init__(
        self,
        store: FolderStore | ZipStore,
        listing: Listing,
        limits: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        self.store = store
        self.listing = listing
        self._limits = limits or {}
        self.frames = 0
        self.unreadable: dict[str, str] = {}
        self.scanned: set[str] = set()
        self.frame_statistics: dict[str, FrameStatistics] = {}
        self._nodes: dict[str, LoadedDocument | None] = {}
        self._readers: dict[str, ArrayReader | None] = {}
        self._layouts: dict[str, ArrayDocument | None] = {}
        self._shards: dict[str, tuple[Problem, ...]] = {}
        self._small: dict[str, np.ndarray] = {}
        self._cached = 0

    # ------------------------------------------------------------------------------- documents

    def load(self, path: str, limit: int | None = None) -> LoadedDocument | None:
        """Parse one of the episode's JSON files; None when it is not there.

        Parameters
        ----------
        path : str
        limit : int, optional
            Most bytes.
        """
        if path not in self._nodes:
            self._nodes[path] = self._load(path, limit)
        return self._nodes[path]

    def _load(self, path: str, limit: int | None) -> LoadedDocument | None:
        size = self.listing.files.get(path)
        if size is None:
            return None
        if limit is not None and size > limit:
            return LoadedDocument(path, mistake=f"the document has more than {limit:,} bytes")
        try:
            return load_document(self.store.read(path), path)
        except ExumiError as error:
            return LoadedDocument(path, mistake=error.what)
        except OSError as error:
            return LoadedDocument(path, mistake=f"cannot be read ({error.strerror})")

    @cached_property
    def root(self) -> LoadedDocument | None:
        """The root ``zarr.json``."""
        return self.load(ROOT)

    @cached_property
    def document(self) -> dict[str, Any] | None:
        """The attribute ``exumi`` of the root, when it is an object."""
        return _exumi(self.root)

    @cached_property
    def judgeable(self) -> bool:
        """Whether the rest can be judged: the format, its version and its features are known."""
        document = self.document
        if document is None or document.get("format") != EPISODE_FORMAT:
            return False
        return understood(document)

    @cached_property
    def newer(self) -> bool:
        """Whether the episode is of a newer minor version."""
        return bool(self.document and newer_minor(self.document.get("version")))

    @cached_property
    def metadata(self) -> EpisodeMetadata | None:
        """The metadata, when nothing at all is wrong with it."""
        if self.document is None:
            return None
        found: EpisodeMetadata | None = parse_leniently(_METADATA, self.document, strictly=True)
        return found

    def section(self, name: str) -> Any:
        """Return a part of the metadata as its model, whatever is wrong elsewhere.

        Parameters
        ----------
        name : str
            Field of `EpisodeMetadata`.

        Returns
        -------
        object
            None when it is absent or not valid itself.
        """
        value = (self.document or {}).get(name)
        if value is None or self.metadata is not None:
            return None if value is None else getattr(self.metadata, name)
        return parse_leniently(_adapter(name), value)

    def parts(self, model: type[M], *keys: str) -> Iterator[tuple[Pointer, M]]:
        """Go through a list or map of the metadata; entries that are not valid are passed over.

        Parameters
        ----------
        model : type
            Model of an entry.
        *keys : str
            Where the list or map is in the document.

        Yields
        ------
        pointer : tuple
            Of the entry, from the root of the file.
        part : model
        """
        if self.metadata is not None:
            yield from self._valid_parts(*keys)
            return
        value: Any = self.document
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        entries: Iterable[tuple[int | str, Any]] = ()
        if isinstance(value, dict):
            entries = value.items()
        elif isinstance(value, list):
            entries = enumerate(value)
        for key_or_index, entry in entries:
            part = parse_leniently(_adapter_of(model), entry)
            if part is not None:
                yield (*EXUMI, *keys, key_or_index), part

    def _valid_parts(self, *keys: str) -> Iterator[tuple[Pointer, Any]]:
        """Go through a list or map of metadata that is valid as a whole: it is parsed already."""
        value: Any = self.metadata
        for key in keys:
            value = getattr(value, key, None)
        entries: Iterable[tuple[int | str, Any]] = ()
        if isinstance(value, dict):
            entries = value.items()
        elif isinstance(value, list):
            entries = enumerate(value)
        for key_or_index, entry in entries:
            yield (*EXUMI, *keys, key_or_index), entry

    @cached_property
    def streams(self) -> dict[str, StreamModel]:
        """The streams whose own metadata is valid."""
        if self.metadata is not None:
            return dict(self.metadata.streams)
        streams = (self.document or {}).get("streams", {})
        if not isinstance(streams, dict):
            return {}
        parsed = {name: parse_leniently(_STREAM, value) for name, value in streams.items()}
        return {name: model for name, model in parsed.items() if model and _NAME.fullmatch(name)}

    @cached_property
    def stream_names(self) -> frozenset[str]:
        """The names of all streams, valid or not."""
        streams = (self.document or {}).get("streams", {})
        return frozenset(streams) if isinstance(streams, dict) else frozenset()

    @cached_property
    def derived_document(self) -> dict[str, Any] | None:
        """The attribute ``exumi`` of the group ``derived``."""
        return _exumi(self.load("derived/zarr.json"))

    @cached_property
    def derived(self) -> dict[str, DerivedItem]:
        """The derived arrays whose description is valid, by ``<stream>/<name>``."""
        document = self.derived_document or {}
        items = document.get("items", {})
        if not isinstance(items, dict) or not understood(document):
            return {}
        parsed = {key: parse_leniently(_DERIVED_ITEM, value) for key, value in items.items()}
        return {key: i for key, i in parsed.items() if i and _DERIVED_KEY.fullmatch(key)}

    # ---------------------------------------------------------------------------------- arrays

    def specs(self, stream: StreamModel) -> dict[str, ArraySpec]:
        """Return the arrays that the registry gives a stream, by name.

        Parameters
        ----------
        stream : StreamModel
        """
        found = dict(common_arrays())
        kind = kinds().get(stream.kind)
        if kind is not None:
            found |= kind.arrays
        described = self.described_kind(stream)
        if described is not None:
            found |= {spec.name: spec for spec in described.arrays}
        images = images_of(stream)
        if images is not None:
            found |= encodings()[images.encoding].arrays
        return found

    @cached_property
    def expected_arrays(self) -> dict[str, ArraySpec | None]:
        """Paths of all arrays that the metadata names, with what the registry says of them."""
        found: dict[str, ArraySpec | None] = {}
        for name, stream in self.streams.items():
            specs = self.specs(stream)
            for array in stream.arrays:
                found[f"streams/{name}/{array}"] = specs.get(array)
        for key in self.derived:
            found[f"derived/{key}"] = derived_arrays().get(key.partition("/")[2])
        for _, item in self.parts(CalibrationItem, "calibration"):
            if item.array is not None and CALIBRATION_PATH.fullmatch(item.array):
                found[item.array] = None
        return found

    @cached_property
    def group_paths(self) -> tuple[str, ...]:
        """Paths of all groups but the root: parents of what the metadata names, sorted."""
        found = {"streams"}
        arrays = [path for path in self.expected_arrays if not self.is_missing_calibration(path)]
        for path in (*arrays, *(f"streams/{name}/x" for name in self.streams)):
            parts = path.split("/")[:-1]
            found |= {"/".join(parts[: depth + 1]) for depth in range(len(parts))}
        return tuple(sorted(found))

    def is_missing_calibration(self, path: str) -> bool:
        """Whether a path is that of a calibration array which is not there."""
        return path.startswith("calibration/") and f"{path}/zarr.json" not in self.listing.files

    def stream_of(self, path: str) -> StreamModel | None:
        """Return the stream that an array belongs to; None for arrays outside ``streams``.

        Parameters
        ----------
        path : str
        """
        return self.streams.get(path.split("/")[1]) if path.startswith("streams/") else None

    def array_document(self, path: str) -> LoadedDocument | None:
        """Return the document of an array or group; None when it is not there.

        Parameters
        ----------
        path : str
            Of the node.
        """
        return self.load(f"{path}/zarr.json", _MAX_NODE_BYTES)

    @cached_property
    def array_nodes(self) -> dict[str, ArrayNode]:
        """The arrays that the metadata names and whose documents can be understood."""
        found = {}
        for path in self.expected_arrays:
            loaded = self.array_document(path)
            if loaded is None or loaded.value is None:
                continue
            if loaded.value.get("node_type") == "array" and loaded.value.get("zarr_format") == 3:
                node = parse_array_node(loaded.value, path)
                if node is not None:
                    found[path] = node
        return found

    def shard_problems(self, path: str) -> tuple[Problem, ...]:
        """Return what is wrong with the shards of an array; nothing where its layout is at fault.

        Parameters
        ----------
        path : str
        """
        if path not in self._shards:
            document = self._layout(path)
            found = () if document is None else judge_shards(self, path, document)
            self._shards[path] = tuple(found)
        return self._shards[path]

    def _layout(self, path: str) -> ArrayDocument | None:
        """Return the layout of an array that follows the rules for it."""
        if path not in self._layouts:
            self._layouts[path] = self._parse_layout(path)
        return self._layouts[path]

    def _parse_layout(self, path: str) -> ArrayDocument | None:
        node = self.array_nodes.get(path)
        if node is None or any(array_problems(node)):
            return None
        spec = self.expected_arrays[path]
        if spec is not None and (
            node.dtype not in spec.dtype or not fits(node.shape, spec, self.stream_of(path))
        ):
            return None
        try:
            return layout_of(node.document, path)
        except (UnsupportedError, DamagedDataError, LimitError) as error:
            self.unreadable[path] = f"the document cannot be understood: {error}"
            return None

    def reader(self, path: str) -> ArrayReader | None:
        """Return a reader of an array; None when its document or its shards are at fault.

        An array that can be read has the data type and the shape of the registry.

        Parameters
        ----------
        path : str
        """
        if path not in self._readers:
            document = self._layout(path)
            if document is None or self.shard_problems(path):
                self._readers[path] = None
            else:
                self._readers[path] = ArrayReader(self.store, path, document)
        return self._readers[path]

    def count(self, stream: str) -> int | None:
        """Return the number of samples of a stream: the length of its `time`, when that is whole.

        Parameters
        ----------
        stream : str
        """
        reader = self.reader(f"streams/{stream}/time")
        return None if reader is None else int(reader.shape[0])

    def blocks(self, *paths: str) -> Iterator[tuple[int, tuple[np.ndarray, ...]]]:
        """Read arrays of equal length side by side, a few MiB at a time.

        Nothing is read when one of them is missing or at fault, or the lengths differ: other
        rules say so. Where an array cannot be read further, that is noted and reading ends.

        Parameters
        ----------
        *paths : str

        Yields
        ------
        start : int
        rows : tuple of ndarray
            One block of each array.
        """
        readers = [self.reader(path) for path in paths]
        whole = [reader for reader in readers if reader is not None]
        if len(whole) < len(paths) or len({reader.shape[0] for reader in whole}) != 1:
            return
        step = min(max(_rows(r) for r in whole), _MAX_BLOCK_ROWS, *(_most_rows(r) for r in whole))
        for start in range(0, whole[0].shape[0], step):
            stop = min(start + step, whole[0].shape[0])
            rows = []
            for reader in whole:
                try:
                    rows.append(self._rows(reader, start, stop))
                except (ExumiError, OSError) as error:
                    self.unreadable[reader.path] = str(getattr(error, "what", error))
                    return
            yield start, tuple(rows)
        self.scanned.update(paths)

    def _rows(self, reader: ArrayReader, start: int, stop: int) -> np.ndarray:
        if reader.document.nbytes > _SMALL_BYTES:
            return reader.rows(start, stop)
        # Many checks ask for the same small arrays.
        if reader.path not in self._small:
            rows = reader.rows(0, reader.shape[0])
            if self._cached + rows.nbytes > _MAX_CACHED_BYTES:
                return rows[start:stop]
            self._small[reader.path] = rows
            self._cached += rows.nbytes
        return self._small[reader.path][start:stop]

    def root_sha256(self) -> str | None:
        """Return the digest of the root document."""
        if ROOT not in self.listing.files:
            return None
        return hashlib.sha256(self.store.read(ROOT)).hexdigest()

    def limit(self, code: str | Rule, name: str) -> float:
        """Return a number that a rule judges by.

        Parameters
        ----------
        code : str or Rule
            Id of a rule of the standard, or another package's rule.
        name : str
            Of the limit, as the table of rules has it.
        """
        rule = code if isinstance(code, Rule) else rules()[code]
        return self._limits.get(rule.id, {}).get(name, rule.limits[name])

    def described_kind(self, stream: StreamModel) -> StreamKind | None:
        """Return the description of a third party's kind; None for core kinds, or without one.

        Parameters
        ----------
        stream : StreamModel
        """
        if not isinstance(stream, ExtensionStream):
            return None
        return find_stream_kind(stream.kind, stream.extension_version)

    def is_extension(self, stream: StreamModel) -> bool:
        """Whether a stream is of a third party's kind.

        Parameters
        ----------
        stream : StreamModel
        """
        return isinstance(stream, ExtensionStream)


def _rows(reader: ArrayReader) -> int:
    """Rows to read at once: a few MiB, and whole chunks, so that none is decoded twice."""
    document = reader.document
    row_bytes = max(1, document.row_bytes)
    return max(_BLOCK_BYTES // row_bytes, document.chunk_rows if document.zstd else 1, 1)


def _most_rows(reader: ArrayReader) -> int:
    return max(1, _MAX_BLOCK_BYTES // max(1, reader.document.row_bytes))


def _exumi(loaded: LoadedDocument | None) -> dict[str, Any] | None:
    attributes = loaded.value.get("attributes") if loaded and loaded.value else None
    document = attributes.get("exumi") if isinstance(attributes, dict) else None
    return document if isinstance(document, dict) else None
