"""Kinds of streams that other packages describe (spec: Versions, third parties).

A package describes a kind with an entry point of the group ``exumi.stream_kinds``, which bears the
kind's name and leads to a `StreamKind`. Without it such a stream reads generically; with it its
metadata and its arrays are judged as those of the core kinds are.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from exumi_data.errors import UsageError
from exumi_data.model.base import EXTENSION_KEY
from exumi_data.model.streams import ExtensionStream
from exumi_data.plugins import Plugin, load_plugins
from exumi_data.standard import ArraySpec, common_arrays
from exumi_data.store.zarr_document import DTYPES

__all__ = [
    "STREAM_KINDS",
    "StreamKind",
    "find_stream_kind",
    "mistakes_of_kind",
    "stream_kind_plugins",
]

STREAM_KINDS = "exumi.stream_kinds"
"""The group of the entry points."""

_NAME = re.compile(EXTENSION_KEY)
_URL = re.compile(r"https?://\S+")


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamKind:
    """A third party's kind of stream.

    Attributes
    ----------
    name : str
        ``vendor:name``.
    version : str
        The `extension_version` that this describes; streams of another one are read generically.
    schema_url : str
        Where the kind is described for people and other programs.
    text : str
        What it is, in a sentence.
    arrays : tuple of ArraySpec
        The arrays of the kind, besides those that every stream may have.
    metadata : type
        Model of the stream's metadata: `ExtensionStream`, or a model derived from it whose own
        fields bear the vendor's prefix as `alias`. Its JSON Schema is `model_json_schema()`.
    """

    name: str
    version: str
    schema_url: str
    text: str
    arrays: tuple[ArraySpec, ...]
    metadata: type[ExtensionStream] = ExtensionStream

    @property
    def vendor(self) -> str:
        """The part of the name before the colon."""
        return self.name.partition(":")[0]

    @property
    def keys(self) -> frozenset[str]:
        """The vendor's keys that the metadata has."""
        fields = self.metadata.model_fields.items()
        names = (field.alias or name for name, field in fields)
        return frozenset(name for name in names if ":" in name)


def mistakes_of_kind(kind: StreamKind) -> list[str]:
    """List what is wrong with a description.

    Parameters
    ----------
    kind : StreamKind
    """
    found = []
    if not _NAME.fullmatch(kind.name):
        found.append(f"the name {kind.name!r} is not vendor:name")
    if not _URL.fullmatch(kind.schema_url):
        found.append(f"schema_url {kind.schema_url!r} is no address")
    names = [spec.name for spec in kind.arrays]
    if len(set(names)) < len(names):
        found.append("two arrays have the same name")
    for spec in kind.arrays:
        if spec.name in common_arrays():
            found.append(f"the array {spec.name} is one that every stream may have")
        if not spec.dtype or not set(spec.dtype) <= DTYPES:
            found.append(f"the array {spec.name} has a data type that episodes have not")
        if not spec.shape or (spec.per_sample and spec.dimensions[:1] != ("time",)):
            found.append(f"the array {spec.name} has no first axis, or one that is not named time")
    own = set(kind.metadata.model_fields) - set(ExtensionStream.model_fields)
    for field in sorted(own):
        alias = kind.metadata.model_fields[field].alias or field
        if not alias.startswith(f"{kind.vendor}:"):
            found.append(f"the key {alias} does not begin with {kind.vendor}:")
    return found


@cache
def stream_kind_plugins() -> Mapping[str, Plugin]:
    """Return the kinds that installed packages describe, by name.

    Raises
    ------
    UsageError
        A description is wrong, or two packages describe the same kind.
    """
    found: dict[str, Plugin] = {}
    for plugin in load_plugins(STREAM_KINDS):
        kind = plugin.value
        if not isinstance(kind, StreamKind):
            what = f"is {type(kind).__name__}, not a StreamKind"
        elif kind.name != plugin.name:
            what = f"does not bear that name, but {kind.name!r}"
        else:
            what = "; ".join(mistakes_of_kind(kind))
        if what:
            raise UsageError(
                f"the stream kind that {plugin.origin} registers as {plugin.name!r}: {what}",
                fix="Tell the authors of that package.",
            )
        found[kind.name] = plugin
    return MappingProxyType(found)


def find_stream_kind(name: str, version: str) -> StreamKind | None:
    """Return the description of a kind; None when no installed package has it.

    Parameters
    ----------
    name : str
    version : str
        The stream's `extension_version`.
    """
    plugin = stream_kind_plugins().get(name)
    kind: StreamKind | None = plugin.value if plugin else None
    return kind if kind is not None and kind.version == version else None
