"""Reading and writing the documents of the format: versions first, then the model.

All problems of a document are collected, each as ``message @ $.json.path``.
"""

import json
import math
import re
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import PydanticSerializationError

from exumi_data.errors import MetadataError, UnsupportedError
from exumi_data.model.base import VERSION, Model
from exumi_data.model.dataset import DATASET_FORMAT, DatasetMetadata, SplitDocument
from exumi_data.model.episode import (
    CONVENTION,
    EPISODE_FORMAT,
    FORMAT_VERSION,
    DerivedMetadata,
    EpisodeMetadata,
)
from exumi_data.model.json_limits import (
    MAX_DOCUMENT_BYTES,
    MAX_DOCUMENT_PARTS,
    MAX_LIST_PARTS,
    is_too_deep,
    size_mistake,
)
from exumi_data.model.manifest import MANIFEST_FORMAT, Manifest

__all__ = [
    "KNOWN_FEATURES",
    "MAX_DOCUMENT_BYTES",
    "check_requires",
    "check_version",
    "derived_group_document",
    "dump",
    "episode_root_document",
    "group_document",
    "json_path",
    "load_json",
    "parse_dataset",
    "parse_derived",
    "parse_episode",
    "parse_manifest",
    "parse_split",
    "problems_of",
]

KNOWN_FEATURES: frozenset[str] = frozenset()
"""Entries of ``requires`` that this version understands: 1.0 defines none."""

M = TypeVar("M", bound=Model)


def load_json(raw: bytes, where: object, *, most_parts: int = MAX_DOCUMENT_PARTS) -> dict[str, Any]:
    """Parse a JSON object.

    Parameters
    ----------
    raw : bytes
    where : object
        Named in errors.
    most_parts : int
        See `json_limits`.

    Raises
    ------
    MetadataError
        Not UTF-8, not JSON, not an object, or beyond the limits of `json_limits`.
    """
    mistake = size_mistake(raw, most_parts=most_parts)
    if mistake:
        raise MetadataError(mistake, where=where)
    try:
        value = json.loads(raw.decode(), parse_constant=_refuse_constant, parse_float=_finite_float)
    except RecursionError:
        raise MetadataError("JSON is nested too deeply", where=where) from None
    except ValueError as error:
        raise MetadataError(
            f"not valid JSON ({error})", where=where, fix="The file is damaged; restore it."
        ) from None
    if not isinstance(value, dict):
        raise MetadataError("expected a JSON object", where=where)
    if is_too_deep(value, raw):
        raise MetadataError("JSON is nested too deeply", where=where)
    return value


def _refuse_constant(name: str) -> float:
    msg = f"{name} is no number in JSON"
    raise ValueError(msg)


def _finite_float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        msg = f"the number {text} is too large"
        raise ValueError(msg)
    return value


def check_version(document: dict[str, Any], expected_format: str, where: object) -> bool:
    """Check ``format``, ``version`` and ``requires``.

    Returns
    -------
    bool
        True when the document is of a newer minor version, whose unknown keys are kept.

    Raises
    ------
    MetadataError
        Another format, or no readable version.
    UnsupportedError
        A newer major version, or an unknown entry of ``requires``.
    """
    if document.get("format") != expected_format:
        raise MetadataError(
            f"expected format {expected_format!r}, found {document.get('format')!r}", where=where
        )
    version = document.get("version")
    if not isinstance(version, str) or not re.fullmatch(VERSION, version):
        raise MetadataError(f"version {version!r} is not major.minor", where=where)
    major, minor = (int(part) for part in version.split("."))
    known_major, known_minor = (int(part) for part in FORMAT_VERSION.split("."))
    if major > known_major:
        raise UnsupportedError(
            f"{expected_format} version {version} is newer than this library, "
            f"which reads up to {known_major}.x",
            where=where,
            fix='Upgrade with: pip install -U "exumi-data"',
        )
    if major < known_major:
        raise UnsupportedError(f"{expected_format} version {version} does not exist", where=where)
    check_requires(document, where)
    return minor > known_minor


def check_requires(document: dict[str, Any], where: object) -> None:
    """Refuse a document that needs a feature which this library does not know.

    Raises
    ------
    UnsupportedError
        Names the unknown features.
    """
    requires = document.get("requires", [])
    names = requires if isinstance(requires, list) else [requires]
    unknown = sorted({str(name) for name in names} - KNOWN_FEATURES)
    if unknown:
        raise UnsupportedError(
            f"requires {', '.join(unknown)}, which this library does not know "
            f"(format version {document.get('version')})",
            where=where,
            fix='Upgrade with: pip install -U "exumi-data". No other package adds one: of an entry '
            "vendor:name, ask the vendor.",
        )


def json_path(location: tuple[int | str, ...]) -> str:
    """Write a location as ``$.streams.pose.clock``."""
    path = "$"
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}"
    return path


_TAGS = {"rgb", "tactile", "pose", "width", "wrench", "taxels", "audio", "extension"}
_ENCODINGS = {"array", "encoded", "video"}


def _location(location: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Drop the tags that pydantic inserts for the branch of a union."""
    kept: list[int | str] = []
    for index, part in enumerate(location):
        previous = location[index - 1] if index else None
        is_branch = (
            part in _TAGS and index == 2 and location[0] == "streams"
        )  # streams.<name>.<branch>
        if is_branch or (part in _ENCODINGS and previous == "images"):
            continue
        kept.append(part)
    return tuple(kept)


def problems_of(error: ValidationError, below: tuple[int | str, ...] = ()) -> list[tuple[str, str]]:
    """List a validation error's problems as (message, JSON path).

    Parameters
    ----------
    error : pydantic.ValidationError
    below : tuple of int or str
        Where in the document the part lies that was validated.
    """
    found = []
    for item in error.errors(include_url=False, include_context=False, include_input=False):
        message = item["msg"].removeprefix("Value error, ")
        message = message[:1].lower() + message[1:]
        if item["type"] == "missing":
            message = "required field missing"
        found.append((message, json_path(_location((*below, *item["loc"])))))
    return found


def _validate(model: type[M], document: dict[str, Any], *, newer: bool, where: object) -> M:
    try:
        return model.model_validate_json(json.dumps(document), context={"newer_minor": newer})
    except RecursionError:
        raise MetadataError("JSON is nested too deeply", where=where) from None
    except ValidationError as error:
        problems = tuple(f"{message} @ {path}" for message, path in problems_of(error))
        what = problems[0] if len(problems) == 1 else f"{len(problems)} problems in the metadata: "
        if len(problems) > 1:
            what += "; ".join(problems[:5]) + (
                "; ..." if len(problems) > 5 else ""
            )  # a readable line
        raise MetadataError(what, where=where, problems=problems) from None


def parse_episode(raw: bytes, where: object) -> EpisodeMetadata:
    """Parse the root ``zarr.json`` of an episode.

    Parameters
    ----------
    raw : bytes
        The document.
    where : object
        Named in errors.

    Raises
    ------
    MetadataError, UnsupportedError
        As `load_json`, `check_version`, `check_requires`; or the metadata breaks the model.
    """
    root = load_json(raw, where)
    attributes = root.get("attributes")
    document = attributes.get("exumi") if isinstance(attributes, dict) else None
    if root.get("node_type") != "group" or not isinstance(document, dict):
        raise MetadataError(
            "no `exumi` attribute on the root group: not an exUMI Episode",
            where=where,
            fix="Convert other data with: exumi convert SRC DST",
        )
    newer = check_version(document, EPISODE_FORMAT, where)
    return _validate(EpisodeMetadata, document, newer=newer, where=where)


def parse_derived(raw: bytes, where: object) -> DerivedMetadata:
    """Parse ``derived/zarr.json``."""
    attributes = load_json(raw, where).get("attributes")
    document = attributes.get("exumi") if isinstance(attributes, dict) else None
    if not isinstance(document, dict):
        raise MetadataError("no `exumi` attribute on the group", where=where)
    newer = check_version(document, "exumi-derived", where)
    return _validate(DerivedMetadata, document, newer=newer, where=where)


def parse_dataset(raw: bytes, where: object) -> DatasetMetadata:
    """Parse ``dataset.json``."""
    document = load_json(raw, where)
    newer = check_version(document, DATASET_FORMAT, where)
    return _validate(DatasetMetadata, document, newer=newer, where=where)


def parse_split(raw: bytes, where: object) -> SplitDocument:
    """Parse ``splits/<name>.json``."""
    document = load_json(raw, where, most_parts=MAX_LIST_PARTS)
    newer = check_version(document, "exumi-split", where)
    return _validate(SplitDocument, document, newer=newer, where=where)


def parse_manifest(raw: bytes, where: object) -> Manifest:
    """Parse ``manifest.json``."""
    document = load_json(raw, where, most_parts=MAX_LIST_PARTS)
    newer = check_version(document, MANIFEST_FORMAT, where)
    return _validate(Manifest, document, newer=newer, where=where)


def dump(model: Model) -> dict[str, Any]:
    """Turn a model into a JSON object; fields that were never set are left out.

    Raises
    ------
    MetadataError
        A value that JSON does not have, such as NaN or an array.
    """
    _mark_filled(model)
    try:
        document = model.model_dump(mode="json", exclude_unset=True)
        json.dumps(document, ensure_ascii=False, allow_nan=False).encode()
    except (ValueError, PydanticSerializationError) as error:
        raise MetadataError(f"cannot be written as JSON ({error})") from None
    for key in ("version", "format"):
        if key in type(model).model_fields:
            document = {key: getattr(model, key), **{k: v for k, v in document.items() if k != key}}
    return document


def _mark_filled(value: Any) -> None:
    """Mark fields as set whose default list or mapping was filled in place."""
    if isinstance(value, Model):
        for name in type(value).model_fields:
            content = getattr(value, name)
            if isinstance(content, list | dict) and content:
                value.model_fields_set.add(name)
            _mark_filled(content)
    elif isinstance(value, dict):
        for item in value.values():
            _mark_filled(item)
    elif isinstance(value, list):
        for item in value:
            _mark_filled(item)


def _to_bytes(document: dict[str, Any]) -> bytes:
    return (json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def group_document(attributes: dict[str, Any] | None = None) -> bytes:
    """Return a Zarr v3 group document."""
    return _to_bytes({"zarr_format": 3, "node_type": "group", "attributes": attributes or {}})


def episode_root_document(metadata: EpisodeMetadata) -> bytes:
    """Return the root ``zarr.json`` of an episode."""
    return group_document({"zarr_conventions": [CONVENTION], "exumi": dump(metadata)})


def derived_group_document(metadata: DerivedMetadata) -> bytes:
    """Return ``derived/zarr.json``."""
    return group_document({"exumi": dump(metadata)})
