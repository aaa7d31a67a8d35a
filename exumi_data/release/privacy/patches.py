"""Places in a file's bytes that may be private, and what can be written there instead."""

from collections.abc import Callable
from dataclasses import dataclass

from exumi_data.release.privacy.kinds import Kind

__all__ = ["CLEANING_COMMAND", "Patch", "ReadAt", "printable", "zeros"]

CLEANING_COMMAND = (
    "ffmpeg -i IN -map 0:v -map '0:a?' -c copy -map_metadata -1 -fflags +bitexact OUT"
)
"""Makes a video of nothing but its pictures and sound, without tags and subtitles."""

_MOST_BYTES = 64 << 20

ReadAt = Callable[[int, int], bytes]
"""From a place and a length to exactly that many bytes."""


@dataclass(frozen=True, slots=True)
class Patch:
    """A place that may be private.

    Attributes
    ----------
    kind : str
    start : int
        Where it begins, bytes from the beginning of the file.
    new : bytes
        What can be written there: as long as what is there. Empty: it cannot be taken out.
    value : str
        What is there.
    why : str
    secret : bytes
        What must be nowhere in the file when this is taken out; may be empty.
    """

    kind: Kind
    start: int
    new: bytes
    value: str
    why: str
    secret: bytes = b""


def zeros(length: int) -> bytes:
    """Return what is written over so many bytes; nothing where they are too many to be held.

    Then they cannot be taken out: no camera writes so much in one piece.
    """
    return bytes(length) if length <= _MOST_BYTES else b""


def printable(content: bytes) -> str:
    """Return the text that bytes begin with, or else the bytes in hexadecimal digits."""
    text = content.split(b"\0")[0].decode("latin-1").strip()
    return text if text and text.isprintable() else content.rstrip(b"\0").hex()
