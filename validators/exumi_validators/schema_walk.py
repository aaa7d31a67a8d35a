"""Keys that the schema does not know, found also where other fields are wrong."""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from exumi_data.model.base import EXTENSION_KEY
from exumi_data.model.schema import json_schema

__all__ = ["extension_keys", "unknown_keys"]

_EXTENSION = re.compile(EXTENSION_KEY)

Pointer = tuple[int | str, ...]
Schema = dict[str, Any]


@cache
def _schema(name: str) -> Schema:
    return json_schema(name)


def unknown_keys(name: str, document: dict[str, Any]) -> Iterator[Pointer]:
    """Yield the pointers of all keys that are neither in the schema nor named ``vendor:name``.

    Parameters
    ----------
    name : str
        Of the document: see `exumi_data.model.schema.DOCUMENTS`.
    document : dict
        It need not be valid.
    """
    found = _strange_keys(name, document)
    return (pointer for pointer in found if not _EXTENSION.fullmatch(str(pointer[-1])))


def extension_keys(name: str, document: dict[str, Any]) -> Iterator[Pointer]:
    """Yield the pointers of all keys of third parties.

    Parameters
    ----------
    name : str
        Of the document: see `exumi_data.model.schema.DOCUMENTS`.
    document : dict
        It need not be valid.
    """
    found = _strange_keys(name, document)
    return (pointer for pointer in found if _EXTENSION.fullmatch(str(pointer[-1])))


def _strange_keys(name: str, document: dict[str, Any]) -> Iterator[Pointer]:
    schema = _schema(name)
    return _walk(document, schema, schema.get("$defs", {}), ())


def _walk(value: object, schema: Schema, known: Schema, pointer: Pointer) -> Iterator[Pointer]:
    """Yield the pointers of all keys that the schema does not name."""
    schema = _resolve(value, schema, known)
    if isinstance(value, list):
        for index, item in enumerate(value):
            yield from _walk(item, schema.get("items", {}), known, (*pointer, index))
    elif isinstance(value, dict):
        for key, item in value.items():
            child = _property(key, schema)
            if child is not None:
                yield from _walk(item, child, known, (*pointer, key))
            elif _is_closed(schema):
                yield (*pointer, key)


def _is_closed(schema: Schema) -> bool:
    """Whether this is an object with fields: the keys of a map are the model's to judge."""
    return "properties" in schema and schema.get("additionalProperties") is False


def _property(key: str, schema: Schema) -> Schema | None:
    if key in schema.get("properties", {}):
        found: Schema = schema["properties"][key]
        return found
    if "properties" in schema:
        return None
    for pattern, child in schema.get("patternProperties", {}).items():
        if re.search(pattern, key):
            return dict(child)
    more = schema.get("additionalProperties")
    return dict(more) if isinstance(more, dict) else None


def _resolve(value: object, schema: Schema, known: Schema) -> Schema:
    """Follow references, and of alternatives choose the one that the value means to be."""
    while True:
        if "$ref" in schema:
            schema = known[schema["$ref"].rpartition("/")[2]]
            continue
        branches = schema.get("anyOf") or schema.get("oneOf")
        if not branches:
            return schema
        chosen = [b for b in (_resolve(value, b, known) for b in branches) if _means(value, b)]
        if not chosen:
            return {}
        schema = chosen[0]


def _means(value: object, schema: Schema) -> bool:
    if not isinstance(value, dict):
        return schema.get("type") == "array" and isinstance(value, list)
    if schema.get("type") != "object":
        return False
    for key, child in schema.get("properties", {}).items():
        if "const" in child and key in ("kind", "encoding") and value.get(key) != child["const"]:
            return False
        if key == "kind" and "pattern" in child and not _matches(child["pattern"], value.get(key)):
            return False
    return True


def _matches(pattern: str, value: object) -> bool:
    return isinstance(value, str) and re.search(pattern, value) is not None
