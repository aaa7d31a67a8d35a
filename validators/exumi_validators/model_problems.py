"""From a model's complaints to problems: one rule and one JSON pointer each."""

import json
import re
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from exumi_validators.findings import problem
from exumi_validators.report import Problem

__all__ = ["parse_leniently", "problems_of_model"]

Pointer = tuple[int | str, ...]

_EXTENSION_FIELDS = ("extension_version", "schema_url")
_MISSING = ("missing", "union_tag_not_found")


def parse_leniently(adapter: TypeAdapter[Any], value: object, *, strictly: bool = False) -> Any:
    """Return the model that a value is; None when it is none.

    Parameters
    ----------
    adapter : pydantic.TypeAdapter
    value : object
        A part of a document.
    strictly : bool
        Allow no unknown keys.
    """
    try:
        return adapter.validate_json(json.dumps(value), context={"newer_minor": not strictly})
    except (ValidationError, RecursionError):
        return None


def problems_of_model(
    model: type[BaseModel], document: dict[str, Any], path: str, base: Pointer
) -> Iterator[Problem]:
    """Yield what a model has to say about a document, unknown keys apart.

    Parameters
    ----------
    model : type
        A model of `exumi_data.model`.
    document : dict
    path : str
        File of the document.
    base : tuple
        Where in the file the document is.
    """
    try:
        text = json.dumps(document)
    except RecursionError:
        yield problem("META-002", path, pointer=base, detail="nested too deeply")
        return
    try:
        model.model_validate_json(text, context={"newer_minor": True})
    except ValidationError as error:
        for item in error.errors(include_url=False, include_context=False):
            yield _problem(item, document, path, base)


def _problem(item: Any, document: dict[str, Any], path: str, base: Pointer) -> Problem:
    kind = str(item["type"])
    inner = _pointer(item["loc"], document, missing=kind == "missing")
    pointer = (*base, *inner)
    field = inner[-1] if inner else None
    if kind == "json_invalid":  # its own limit of depth, lower than Python's
        return problem("META-002", path, pointer=base, detail="nested too deeply")
    if kind == "unknown_kind":
        return _unknown_kind(item["input"], path, pointer)
    if field in _EXTENSION_FIELDS and kind in _MISSING:
        return problem("EXT-001", path, pointer=pointer, found=field)
    if kind in _MISSING:
        if kind == "union_tag_not_found":
            pointer = (*pointer, "encoding")
        return problem("META-001", path, pointer=pointer)
    if inner == ("id",) and path == "zarr.json":
        return problem("ID-001", path, pointer=pointer, found=item["input"])
    message = re.sub(r"^Value error, ", "", str(item["msg"]))
    value = item["input"]
    found = None if isinstance(value, dict | list) else json.dumps(value)
    detail = message[:1].lower() + message[1:] + (f", found {found}" if found else "")
    return problem("META-002", path, pointer=pointer, detail=detail, found=found)


def _unknown_kind(stream: object, path: str, pointer: Pointer) -> Problem:
    if not isinstance(stream, dict):
        return problem("META-002", path, pointer=pointer, detail="expected an object")
    pointer = (*pointer, "kind")
    if "kind" not in stream:
        return problem("META-001", path, pointer=pointer)
    from exumi_data.standard import kinds

    core = ", ".join(kind.name for kind in kinds().values() if kind.status == "core")
    return problem("KIND-001", path, pointer=pointer, expected=core, found=stream["kind"])


def _pointer(location: Pointer, document: object, *, missing: bool) -> Pointer:
    """Drop from pydantic's location what is no key of the document: names of union branches."""
    kept: list[int | str] = []
    here = document
    for part in location:
        in_object = isinstance(here, dict) and part in here
        in_list = isinstance(here, list) and isinstance(part, int) and 0 <= part < len(here)
        if in_object or in_list:
            here = here[part]  # type: ignore[index]  # one of the two
            kept.append(part)
    if missing:
        kept.append(location[-1])
    return tuple(kept)
