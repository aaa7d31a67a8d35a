"""The JSON files of an episode as the checks see them: whatever can be understood of them."""

import re
from collections.abc import Iterable, Iterator
from functools import cache, cached_property
from typing import Any, TypeVar

from pydantic import TypeAdapter

from exumi_data.errors import ExumiError
from exumi_data.model.base import VERSION, Model
from exumi_data.model.documents import KNOWN_FEATURES
from exumi_data.model.episode import (
    EPISODE_FORMAT,
    FORMAT_VERSION,
    DerivedItem,
    EpisodeMetadata,
)
from exumi_data.model.streams import Stream, StreamModel
from exumi_data.store.access import FolderStore, ZipStore
from exumi_validators.json_documents import LoadedDocument, load_document
from exumi_validators.listing import Listing
from exumi_validators.model_problems import parse_leniently

__all__ = ["EXUMI", "ROOT", "EpisodeDocuments", "newer_minor", "understood"]

ROOT = "zarr.json"
EXUMI = ("attributes", "exumi")
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_DERIVED_KEY = re.compile(r"[a-z][a-z0-9_]*/[a-z][a-z0-9_]*")
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


class EpisodeDocuments:
    """The documents of one episode.

    Parameters
    ----------
    store : FolderStore or ZipStore
    listing : Listing
        Its files.
    """

    def __init__(self, store: FolderStore | ZipStore, listing: Listing) -> None:
        self.store = store
        self.listing = listing
        self._nodes: dict[str, LoadedDocument | None] = {}

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


def _exumi(loaded: LoadedDocument | None) -> dict[str, Any] | None:
    attributes = loaded.value.get("attributes") if loaded and loaded.value else None
    document = attributes.get("exumi") if isinstance(attributes, dict) else None
    return document if isinstance(document, dict) else None
