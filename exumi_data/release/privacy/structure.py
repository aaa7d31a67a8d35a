"""Which words of a document are its structure: taken out of them, it would be no document."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, Literal, get_args

from exumi_data.model.base import EXTENSION_KEY, Identifier, Model
from exumi_data.model.dataset import DATASET_FORMAT, DatasetMetadata, SplitDocument
from exumi_data.model.episode import EPISODE_FORMAT, DerivedMetadata, EpisodeMetadata

__all__ = ["Role", "fitted", "is_name_chosen", "role_of", "vocabulary"]

Role = Literal["text", "name", "fixed", "id"]
"""Text may be changed; a name too, as long as it stays one. What is fixed means what the standard
says, and nobody by it. An id was chosen by people and can tell of them, but things are found by it.
"""

_ROOTS: dict[str, type[Model]] = {
    EPISODE_FORMAT: EpisodeMetadata,
    "exumi-derived": DerivedMetadata,
    DATASET_FORMAT: DatasetMetadata,
    "exumi-split": SplitDocument,
}
_IN_ATTRIBUTES = ["attributes", "exumi"]
_MOST = 255  # letters of an identifier
_IDENTIFIER = get_args(Identifier)[1].pattern
_ADDRESS = r"^https?://\S+$"
# Identifiers that are words of a vocabulary: of the standard, of a program, or of physics.
_VOCABULARY = frozenset(
    [
        "algorithm",
        "code",
        "codec",
        "converter",
        "extension_version",
        "inputs",
        "licence",
        "pixel_format",
        "procedure",
        "requires",
        "source",
        "step",
        "time_device_unit",
        "tool",
        "tool_version",
        "unit",
    ]
)
_IDS = frozenset(
    ["child", "instance_id", "object_id", "parent", "part_id", "reference_frame", "transform"]
)


def role_of(document: Any, pointer: str, *, is_key: bool = False) -> Role:
    """Return what a string of a document is.

    Parameters
    ----------
    document : JSON value
        The whole of it: ``zarr.json``, ``dataset.json`` or a split.
    pointer : str
        JSON pointer of the string, or of the value whose key it is.
    is_key : bool
    """
    steps = [one.replace("~1", "/").replace("~0", "~") for one in pointer.split("/")[1:]]
    schemas = _at(document, steps[:-1] if is_key else steps)
    if schemas is None:
        return "fixed"
    if is_key:
        return "text" if ":" in steps[-1] else _role_of_key(schemas)
    return _role_of_text(schemas, [one for one in steps if not one.isdecimal()])


def is_name_chosen(document: Any, pointer: str) -> bool:
    """Whether a key is the name of a thing, such as of a stream, and not that of a field.

    Parameters
    ----------
    document : JSON value
    pointer : str
        Of the value.
    """
    steps = [one.replace("~1", "/").replace("~0", "~") for one in pointer.split("/")[1:]]
    schemas = _at(document, steps[:-1])
    return any("patternProperties" in one and "properties" not in one for one in schemas or ())


@cache
def vocabulary() -> frozenset[str]:
    """Return the words of which the standard says that they stand there: nobody's name by it."""
    return frozenset(word for root in _ROOTS.values() for word in _words(_schema_of(root)))


def fitted(text: str) -> str:
    """Return a text as a name may be: without blanks around it, and not too long."""
    return text.strip()[:_MOST].strip()


def _role_of_text(schemas: Sequence[dict[str, Any]], names: Sequence[str]) -> Role:
    for schema in schemas:
        is_plain = schema.get("pattern", _IDENTIFIER) in (_IDENTIFIER, _ADDRESS)
        if "enum" in schema or "const" in schema or not is_plain:
            return "fixed"
    if not names or not any("pattern" in schema for schema in schemas):
        return "text"
    if names[-1] in _VOCABULARY:
        return "fixed"
    return "id" if names[-1] in _IDS else "name"


def _role_of_key(schemas: Sequence[dict[str, Any]]) -> Role:
    for schema in schemas:
        patterns = schema.get("patternProperties", {}).keys()
        if "properties" in schema or patterns - {_IDENTIFIER}:
            return "fixed"
        if patterns:
            return "id"
    return "text"


def _at(document: Any, steps: Sequence[str]) -> list[dict[str, Any]] | None:
    """Return the schemas of a place: none where people write what they like; None: of Zarr."""
    if isinstance(document, dict) and "zarr_format" in document:
        if steps[:2] != _IN_ATTRIBUTES:
            is_free = steps[:1] == ["attributes"] and steps[1:2] != ["zarr_conventions"]
            return [] if is_free else None
        steps = steps[2:]
        attributes = document.get("attributes")
        document = attributes.get("exumi") if isinstance(attributes, dict) else None
    form = document.get("format") if isinstance(document, dict) else None
    root = _ROOTS.get(form) if isinstance(form, str) else None
    if root is None:
        return []
    schema = _schema_of(root)
    found = list(_plain(schema, schema))
    for step in steps:
        found = [one for each in found for one in _below(each, step, schema)]
    return found


@cache
def _schema_of(model: type[Model]) -> dict[str, Any]:
    return model.model_json_schema()


def _words(schema: Any) -> Iterator[str]:
    if isinstance(schema, list):
        for item in schema:
            yield from _words(item)
    elif isinstance(schema, dict):
        said = [*schema.get("enum", ()), schema.get("const")]
        yield from (word for word in said if isinstance(word, str))
        for item in schema.values():
            yield from _words(item)


def _below(schema: dict[str, Any], step: str, root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield what the value of a key, or of a place of a list, may be."""
    if step in schema.get("properties", {}):
        yield from _plain(schema["properties"][step], root)
        return
    for key in ("additionalProperties", "items"):
        if isinstance(schema.get(key), dict):
            yield from _plain(schema[key], root)
    for pattern, inner in schema.get("patternProperties", {}).items():
        if pattern != EXTENSION_KEY:
            yield from _plain(inner, root)
    for inner in schema.get("prefixItems", ()):
        yield from _plain(inner, root)


def _plain(schema: dict[str, Any], root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the schemas that a schema is one of."""
    if "$ref" in schema:
        yield from _plain(root["$defs"][schema["$ref"].rpartition("/")[2]], root)
        return
    several = [*schema.get("anyOf", ()), *schema.get("oneOf", ())]
    for one in several:
        yield from _plain(one, root)
    if not several:
        yield schema
