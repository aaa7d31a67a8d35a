"""An episode as the checks see it: everything that can be understood, read once, bounded."""

import hashlib
from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np

from exumi_data.episode import CALIBRATION_PATH
from exumi_data.errors import DamagedDataError, ExumiError, LimitError, UnsupportedError
from exumi_data.extensions import StreamKind, find_stream_kind
from exumi_data.model.description import CalibrationItem
from exumi_data.model.streams import ExtensionStream, StreamModel, images_of
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
from exumi_validators.episode_documents import (
    EXUMI,
    ROOT,
    EpisodeDocuments,
    newer_minor,
    understood,
)
from exumi_validators.expected_shapes import fits
from exumi_validators.frame_statistics import FrameStatistics
from exumi_validators.json_documents import LoadedDocument
from exumi_validators.listing import Listing
from exumi_validators.nodes import ArrayNode, array_problems, parse_array_node
from exumi_validators.report import Problem
from exumi_validators.shards import judge_shards

__all__ = ["CALIBRATION_PATH", "EXUMI", "ROOT", "EpisodeContext", "newer_minor", "understood"]

_MAX_NODE_BYTES = 1 << 20
_BLOCK_BYTES = 4 << 20
_SMALL_BYTES = 1 << 20
_MAX_BLOCK_BYTES = 64 << 20
_MAX_BLOCK_ROWS = 1 << 20  # some checks make Python objects of them
_MAX_CACHED_BYTES = 64 << 20


class EpisodeContext(EpisodeDocuments):
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
        super().__init__(store, listing)
        self._limits = limits or {}
        self.frames = 0
        self.unreadable: dict[str, str] = {}
        self.scanned: set[str] = set()
        self.frame_statistics: dict[str, FrameStatistics] = {}
        self._readers: dict[str, ArrayReader | None] = {}
        self._layouts: dict[str, ArrayDocument | None] = {}
        self._shards: dict[str, tuple[Problem, ...]] = {}
        self._small: dict[str, np.ndarray] = {}
        self._cached = 0

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
