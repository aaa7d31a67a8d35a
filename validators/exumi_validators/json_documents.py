"""JSON documents as a validator reads them: strictly, and without stopping at the first mistake."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from exumi_data.model.json_limits import MAX_DOCUMENT_PARTS, is_too_deep, size_mistake

__all__ = ["LoadedDocument", "load_document"]

_SMALL_BYTES = 2048

Pointer = tuple[int | str, ...]


class _Object(dict[str, Any]):
    """A JSON object that remembers which of its keys stood twice."""

    twice: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LoadedDocument:
    """A document, or why there is none.

    Attributes
    ----------
    path : str
        Relative to the episode or dataset.
    value : dict or None
        The object.
    mistake : str or None
        Why it could not be parsed.
    duplicates : tuple of tuple
        Pointers of the keys that stand twice.
    """

    path: str
    value: dict[str, Any] | None = None
    mistake: str | None = None
    duplicates: tuple[Pointer, ...] = ()


def load_document(raw: bytes, path: str, *, most_parts: int = MAX_DOCUMENT_PARTS) -> LoadedDocument:
    """Parse a JSON object; what is wrong is returned, never raised.

    Parameters
    ----------
    raw : bytes
    path : str
        Where it is, for messages.
    most_parts : int
        See `exumi_data.model.json_limits`.
    """
    mistake = size_mistake(raw, most_parts=most_parts)
    if mistake:
        return LoadedDocument(path, mistake=mistake)
    return replace(_parsed_again(raw) if len(raw) <= _SMALL_BYTES else _parsed(raw), path=path)


def _parsed(raw: bytes) -> LoadedDocument:
    """Parse; the place is added by the caller."""
    try:
        text = raw.decode("utf-8")
        objects = _Objects()
        value = json.loads(text, object_pairs_hook=objects, parse_constant=_no_constant)
        if "\\u" in text:  # a lone surrogate is valid as an escape, and no text
            json.dumps(value, ensure_ascii=False).encode("utf-8")
    except (RecursionError, ValueError) as error:
        return LoadedDocument("", mistake=_mistake(error))
    if not isinstance(value, dict):
        return LoadedDocument("", mistake="expected a JSON object")
    if is_too_deep(value, raw):
        return LoadedDocument("", mistake=_mistake(RecursionError()))
    twice = tuple(_duplicates(value, ())) if objects.found_twice else ()
    return LoadedDocument("", value, duplicates=twice)


# The documents of arrays are small, and the same in episode after episode. Nobody changes them.
_parsed_again = lru_cache(maxsize=256)(_parsed)


def _mistake(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return "the JSON is nested too deeply"
    if isinstance(error, UnicodeDecodeError):
        return f"not UTF-8: byte {error.start} ({error.reason})"
    if isinstance(error, UnicodeEncodeError):
        return "a string holds half a surrogate pair"
    return f"not valid JSON: {error}"


def _no_constant(name: str) -> Any:
    msg = f"{name} is no JSON number"
    raise ValueError(msg)


class _Objects:
    """Makes the objects of one document; knows whether any key of any of them stood twice."""

    found_twice = False

    def __call__(self, pairs: list[tuple[str, Any]]) -> _Object:
        found = _Object(pairs)
        if len(found) < len(pairs):
            seen: set[str] = set()
            twice = []
            for key, _ in pairs:
                if key in seen:
                    twice.append(key)
                seen.add(key)
            found.twice = tuple(twice)
            self.found_twice = True
        return found


def _duplicates(value: object, pointer: Pointer) -> Iterator[Pointer]:
    if isinstance(value, _Object):
        for key in value.twice:
            yield (*pointer, key)
        for key, item in value.items():
            yield from _duplicates(item, (*pointer, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _duplicates(item, (*pointer, index))
