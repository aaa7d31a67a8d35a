"""``index.json``: what an index consists of. It is written last, and whole."""

import json
import re
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from exumi_data.errors import MetadataError, UnsupportedError
from exumi_data.model.documents import load_json, problems_of
from exumi_data.model.json_limits import MAX_LIST_PARTS
from exumi_loaders.clips import MOST_FRAMES

__all__ = [
    "INDEX_VERSION",
    "EncoderStatement",
    "IndexDocument",
    "SegmentStatement",
    "SourceStatement",
    "dump_index",
    "parse_index",
]

INDEX_VERSION = "1.0"
_FORMAT = "exumi-index"

_Count = Annotated[int, Field(ge=0, le=2**40)]
_Width = Annotated[int, Field(ge=1, le=1 << 16)]
_Word = Annotated[str, StringConstraints(min_length=1, max_length=1000)]
_Name = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{32}$")]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class EncoderStatement(_Part):
    """Which encoder made the vectors."""

    name: _Word
    digest: _Word
    dimension: _Width


class SourceStatement(_Part):
    """Which dataset the clips come from."""

    name: str
    digest: _Word
    """`Dataset.fingerprint` of the episodes that were taken."""
    split: str | None = None
    clips: _Count
    damaged: _Count = 0
    """Clips that were left out, since they cannot be decoded."""


class SegmentStatement(_Part):
    """Some entries, in a folder that never changes."""

    name: _Name
    rows: Annotated[int, Field(ge=1, le=2**31)]
    crc32c: list[Annotated[int, Field(ge=0, lt=2**32)]]
    """Of the vectors in each file of the Zarr array, without what fills its last chunk up."""
    forgotten: list[_Count] = []
    """Rows that no longer count."""


class IndexDocument(_Part):
    """All of ``index.json``."""

    format: Literal["exumi-index"] = "exumi-index"
    version: str = INDEX_VERSION
    generation: _Count = 0
    """Grows by one with each change."""
    encoder: EncoderStatement
    frames: Annotated[int, Field(ge=1, le=MOST_FRAMES)]
    """Salient frames a clip."""
    dimension: _Width
    """Of the vectors that are stored."""
    space: Literal["half-whitening/1"] | None = None
    source: SourceStatement | None = None
    segments: list[SegmentStatement] = []


def dump_index(document: IndexDocument) -> bytes:
    """Write ``index.json``."""
    values = document.model_dump(mode="json")
    return (json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def parse_index(raw: bytes, where: object) -> IndexDocument:
    """Parse ``index.json``.

    Parameters
    ----------
    raw : bytes
    where : object
        Named in errors.

    Raises
    ------
    MetadataError
        It is none, or breaks the model.
    UnsupportedError
        It is of a newer version.
    """
    values = load_json(raw, where, most_parts=MAX_LIST_PARTS)
    if values.get("format") != _FORMAT:
        raise MetadataError(
            f"expected format {_FORMAT!r}, found {str(values.get('format'))[:40]!r}", where=where
        )
    version = str(values.get("version"))
    if re.fullmatch(r"[0-9]{1,9}\.[0-9]{1,9}", version) and version != INDEX_VERSION:
        raise UnsupportedError(
            f"an index of version {version}; this library reads {INDEX_VERSION}",
            where=where,
            fix='Upgrade with: pip install -U "exumi-data", or build the index again.',
        )
    try:
        document = IndexDocument.model_validate_json(raw)
    except ValidationError as error:
        problems = tuple(f"{message} @ {path}" for message, path in problems_of(error))
        raise MetadataError("; ".join(problems[:5]), where=where, problems=problems) from None
    names = [segment.name for segment in document.segments]
    if version != INDEX_VERSION or len(set(names)) != len(names):
        raise MetadataError("the version is wrong, or a segment is named twice", where=where)
    if any(not _rises_below(segment.forgotten, segment.rows) for segment in document.segments):
        raise MetadataError("forgotten rows do not rise, or are not there", where=where)
    return document


def _rises_below(rows: list[int], end: int) -> bool:
    return all(a < b for a, b in zip(rows, [*rows[1:], end], strict=True)) if rows else True
