"""Texts among bytes: what in them may be private, and what can be written over it.

A text that is taken out becomes blanks, as many bytes as it had: nothing moves.
"""

import re
from collections.abc import Iterator
from functools import lru_cache

from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.names import named_in
from exumi_data.release.privacy.patches import Patch, printable
from exumi_data.release.privacy.tags import Names
from exumi_data.release.privacy.text import Match, matches_in

__all__ = ["iptc_patches", "is_text", "name_patches", "text_patches"]

_PASSAGE = re.compile("[^\0]+")
_CONTROL = re.compile(rb"[\x01-\x08\x0b\x0c\x0e-\x1f\x7f]")
# Among bytes that are no text, shorter ones are there by chance.
_LEAST_NAME = 5
_NO_TEXT = bytes(range(0x80)) + b"\0" * 0x80

# IPTC: 0x1c, record 2, the data set, and the length of its value.
_IPTC = re.compile(rb"\x1c\x02([\x00-\xff])([\x00-\x7f][\x00-\xff])", re.DOTALL)
_TOLD: dict[int, tuple[Kind, str]] = {
    80: ("operator", "who made the picture"),
    85: ("operator", "who made the picture"),
    90: ("site", "where the picture was made"),
    92: ("site", "where the picture was made"),
    95: ("site", "where the picture was made"),
    110: ("operator", "whom the picture is owed to"),
    115: ("operator", "whom the picture is owed to"),
    118: ("operator", "whom to ask about the picture"),
    122: ("operator", "who described the picture"),
}


def is_text(content: bytes) -> bool:
    """Whether bytes are a text, or several with zeros between them.

    Parameters
    ----------
    content : bytes
    """
    return not _CONTROL.search(content) and _is_utf8(content)


def text_patches(
    content: bytes, start: int, names: Names, encoding: str | None = None
) -> Iterator[Patch]:
    """Yield what in a text may be private.

    Parameters
    ----------
    content : bytes
    start : int
        Where it begins in the file.
    names : mapping of str to str
        People whom the dataset names.
    encoding : str, optional
        Default: UTF-8, and Latin-1 of what is none.
    """
    if encoding is None:
        encoding = "utf-8" if _is_utf8(content) else "latin-1"
    if encoding.startswith("utf-16"):
        content = content[: len(content) // 2 * 2]
    text = content.decode(encoding, "replace")
    if text.encode(encoding, "replace") != content:  # damaged: no place in it is sure
        encoding, text = "latin-1", content.decode("latin-1")
    blank, told = " ".encode(encoding), tuple(names.items())
    for passage in _PASSAGE.finditer(text):
        for match in _matches(passage[0], told):
            before = len(text[: passage.start() + match.start].encode(encoding))
            found = passage[0][match.start : match.stop]
            length = len(found.encode(encoding))
            new = blank * (length // len(blank))
            yield Patch(match.kind, start + before, new, found, match.why)


def name_patches(content: bytes, start: int, names: Names) -> Iterator[Patch]:
    """Yield names among bytes that are no text.

    Parameters
    ----------
    content : bytes
    start : int
        Where they begin in the file.
    names : mapping of str to str
    """
    long = {name: kind for name, kind in names.items() if len(name) >= _LEAST_NAME}
    if not long:
        return
    text = content.translate(_NO_TEXT).decode("ascii")
    end = 0
    for first, stop, kind, why in sorted(named_in(text, long), key=lambda one: (one[0], -one[1])):
        if first < end:
            continue
        end = stop
        yield Patch(kind, start + first, b" " * (stop - first), text[first:stop], why)


def iptc_patches(content: bytes, start: int, names: Names) -> Iterator[Patch]:
    """Yield what of IPTC may be private: who made a picture, where, and what texts say.

    Parameters
    ----------
    content : bytes
        Of a segment APP13.
    start : int
        Where it begins in the file.
    names : mapping of str to str
    """
    at = 0
    while (one := _IPTC.search(content, at)) is not None:
        length = int.from_bytes(one[2], "big")
        value = content[one.end() : one.end() + length]
        at = one.end()
        if len(value) < length:
            continue
        told = _TOLD.get(one[1][0])
        if told is None:
            yield from text_patches(value, start + at, names)
        elif value.strip(b" \0"):
            yield Patch(told[0], start + at, b" " * length, printable(value), told[1])
        at += length
    yield from name_patches(content, start, names)


@lru_cache(maxsize=256)  # the frames of a stream say much the same
def _matches(text: str, names: tuple[tuple[str, Kind], ...]) -> tuple[Match, ...]:
    return tuple(matches_in(text, dict(names)))


def _is_utf8(content: bytes) -> bool:
    try:
        content.decode()
    except UnicodeDecodeError:
        return False
    return True
