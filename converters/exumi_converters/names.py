"""Names that a source gives become names of the format."""

import re
from collections.abc import Iterable

__all__ = ["free_stream_name", "one_line", "printed"]

# A stream's name has at most 64 letters; a number may come behind it.
_LONGEST_STREAM, _LONGEST_NAME = 56, 200


def free_stream_name(wanted: str, taken: Iterable[str]) -> str:
    """Make a stream's name that is not taken yet.

    Parameters
    ----------
    wanted : str
        Whatever the source calls it.
    taken : iterable of str
    """
    name = re.sub(r"[^a-z0-9]+", "_", wanted.lower()).strip("_")
    name = (name if name[:1].isalpha() else f"stream_{name}".rstrip("_"))[:_LONGEST_STREAM]
    known = set(taken)
    number, free = 2, name
    while free in known:
        free, number = f"{name}_{number}", number + 1
    return free


def printed(text: str) -> str:
    """Return a text without what no file in UTF-8 can hold: halves of characters."""
    return text.encode("utf-8", "replace").decode("utf-8")


def one_line(text: str) -> str | None:
    """Return a text as a name: on one line, not too long; None where nothing is left of it."""
    plain = "".join(letter if letter.isprintable() else " " for letter in printed(text))
    return " ".join(plain.split())[:_LONGEST_NAME].strip() or None
