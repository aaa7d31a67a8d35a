"""Comparing canonical dumps: see ``spec/readers/README.md``."""

from collections.abc import Iterator
from typing import Any

__all__ = ["TOLERANCE", "differences"]

TOLERANCE = 2
"""Grey levels by which the means of a decoded frame's blocks may differ."""
_LATER = ("digest",)
"""Keys that the oldest stored dumps lack."""


def differences(expected: Any, found: Any, at: str = "$") -> Iterator[str]:
    """Yield where two dumps differ, each as one line.

    Everything has to be equal but ``blocks``, for which decoders may differ by `TOLERANCE`. A
    ``digest`` is compared where the expected dump has one.
    """
    if at.endswith(".blocks"):
        if not _close(expected, found):
            yield f"{at}: {found} is not {expected} to {TOLERANCE} levels"
    elif isinstance(expected, dict) and isinstance(found, dict):
        for key in [*expected, *(key for key in found if key not in expected)]:
            if key in _LATER and key not in expected:
                continue
            if key not in found or key not in expected:
                yield f"{at}.{key}: {'missing' if key in expected else 'not expected'}"
            else:
                yield from differences(expected[key], found[key], f"{at}.{key}")
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for index, (one, other) in enumerate(zip(expected, found, strict=True)):
            yield from differences(one, other, f"{at}[{_label(one, index)}]")
    elif type(expected) is not type(found) or expected != found:
        yield f"{at}: expected {expected!r}, found {found!r}"


def _label(value: Any, index: int) -> str:
    """Name an element of a list, such as a stream, so that a message can be understood."""
    name = value.get("name", value.get("path")) if isinstance(value, dict) else None
    return str(index if name is None else name)


def _close(expected: Any, found: Any) -> bool:
    if isinstance(expected, list) and isinstance(found, list):
        return len(expected) == len(found) and all(map(_close, expected, found))
    if isinstance(expected, int) and isinstance(found, int):
        return abs(expected - found) <= TOLERANCE
    return False
