"""How large a JSON document may be: a small file must not take much memory, or the stack."""

from typing import Any

__all__ = [
    "MAX_DOCUMENT_BYTES",
    "MAX_DOCUMENT_DEPTH",
    "MAX_DOCUMENT_PARTS",
    "MAX_LIST_PARTS",
    "is_too_deep",
    "size_mistake",
]

MAX_DOCUMENT_BYTES = 32 << 20
"""Size of the largest document that is read: parsed, it can take twenty times as much."""

MAX_DOCUMENT_PARTS = 100_000
"""Most commas and opening brackets of a document.

Each can be a value, and each value can be wrong in several ways: a kilobyte each to say so.
"""

MAX_LIST_PARTS = 2_000_000
"""The same of a split or a manifest: long lists, of which the first mistake is told."""

MAX_DOCUMENT_DEPTH = 100
"""Most levels of objects and lists inside each other."""


def size_mistake(raw: bytes, *, most_parts: int = MAX_DOCUMENT_PARTS) -> str | None:
    """Return why a document is too large to be parsed; None when it is not.

    Parameters
    ----------
    raw : bytes
    most_parts : int
        `MAX_DOCUMENT_PARTS` or `MAX_LIST_PARTS`.
    """
    if len(raw) > MAX_DOCUMENT_BYTES:
        return "the document is larger than 32 MiB"
    # None of these bytes is part of another character in UTF-8.
    if len(raw) > most_parts:
        parts = raw.count(b",") + raw.count(b"[") + raw.count(b"{")
        if parts > most_parts:
            return f"the document has more than {most_parts:,} commas and opening brackets"
    return None


def is_too_deep(value: Any, raw: bytes) -> bool:
    """Whether a parsed document is nested deeper than 100 levels.

    Parameters
    ----------
    value : object
        What the document says.
    raw : bytes
        The document.
    """
    # A document with few brackets, as nearly all are, need not be walked through.
    if raw.count(b"[") + raw.count(b"{") <= MAX_DOCUMENT_DEPTH:
        return False
    level = [value]
    for _ in range(MAX_DOCUMENT_DEPTH + 1):
        level = [
            item
            for part in level
            if isinstance(part, dict | list)
            for item in (part.values() if isinstance(part, dict) else part)
            if isinstance(item, dict | list)
        ]
        if not level:
            return False
    return True
