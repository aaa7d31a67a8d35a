"""What in an AVI file may be private, found in its lists without decoding anything.

A text that is taken out becomes a chunk ``JUNK`` of the same length: no byte that stays moves.
"""

from collections.abc import Iterator

from exumi_data.errors import LimitError
from exumi_data.release.privacy.patches import Patch, ReadAt
from exumi_data.release.privacy.tags import Names, told_by_tag
from exumi_data.release.privacy.xmp import xmp_patches

__all__ = ["avi_patches", "is_avi"]

_LISTS = frozenset((b"hdrl", b"strl", b"odml", b"INFO"))
# https://www.robotplanet.dk/audio/wav_meta_data: what INFO chunks are for.
_NAMES = {
    b"IART": "artist",
    b"ICMS": "director",
    b"IENG": "engineer",
    b"IPRO": "producer",
    b"ISTR": "performer",
    b"ITCH": "technician",
    b"IWRI": "author",
    b"ILOC": "location",
}
_TEXTS = frozenset((b"strn", b"ISMP", b"IDIT"))
_XMP = b"_PMX"
_MAX_CHUNKS = 200_000
_MAX_TEXT = 8 << 20
_DEEPEST = 6


def is_avi(read: ReadAt, size: int) -> bool:
    """Whether a file has the form that is understood here."""
    return size >= 12 and read(0, 4) == b"RIFF" and read(8, 4) == b"AVI "


def avi_patches(read: ReadAt, size: int, names: Names) -> Iterator[Patch]:
    """Yield what in a file may be private.

    Parameters
    ----------
    read : callable
    size : int
        Of the file, bytes.
    names : mapping of str to str
        People whom the dataset names.

    Raises
    ------
    LimitError
        It has more chunks than any camera makes.
    """
    pending = [(0, size, b"", 0)]
    seen = 0
    while pending:
        at, end, inside, depth = pending.pop()
        while at + 8 <= end:
            seen += 1
            if seen > _MAX_CHUNKS:
                raise LimitError(f"the video has more than {_MAX_CHUNKS:,} chunks")
            head = read(at, min(12, end - at))
            name, length, form = head[:4], int.from_bytes(head[4:8], "little"), head[8:12]
            stop = min(at + 8 + length, end)
            if name in (b"RIFF", b"LIST"):
                if depth < _DEEPEST and (name == b"RIFF" or form in _LISTS):
                    pending.append((at + 12, stop, form, depth + 1))
            elif name == _XMP:
                yield from xmp_patches(read(at + 8, min(stop - at - 8, _MAX_TEXT)), at + 8)
            elif name == b"strh" and read(at + 8, min(4, stop - at - 8)) == b"txts":
                why = "a stream of subtitles, which is not looked into"
                yield Patch("gps", 0, b"", "subtitles", why)
            elif inside == b"INFO" or name in _TEXTS:
                yield from _text(read, at, stop, name, names)
            at = stop + length % 2


def _text(read: ReadAt, at: int, stop: int, name: bytes, names: Names) -> Iterator[Patch]:
    content = read(at + 8, min(stop - at - 8, _MAX_TEXT)).strip(b"\0")
    try:
        text = content.decode()
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    new = b"JUNK" + read(at + 4, 4) + bytes(stop - at - 8)
    for kind, value, why in told_by_tag(_NAMES.get(name, ""), text, names):
        yield Patch(kind, at, new, value, why)
