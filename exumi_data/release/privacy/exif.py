"""What in the head of a JPEG may be private: in Exif, XMP, IPTC, comments and other texts."""

import struct
from collections.abc import Iterator

from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.passages import (
    iptc_patches,
    is_text,
    name_patches,
    text_patches,
)
from exumi_data.release.privacy.patches import Patch, ReadAt, printable
from exumi_data.release.privacy.tags import Names
from exumi_data.release.privacy.xmp import xmp_patches

__all__ = ["jpeg_patches"]

_EXIF, _XMP = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"
_MORE_XMP = b"http://ns.adobe.com/xmp/extension/\0"
_MORE_XMP_HEAD = len(_MORE_XMP) + 32 + 8  # its digest, the whole length, and where this part is
# What decoders read: a picture without it may look otherwise.
_DECODING = (b"JFIF\0", b"JFXX\0", b"Adobe\0", b"ICC_PROFILE\0")
_APP0, _APP1, _APP13, _APP15, _COM, _SOS = 0xE0, 0xE1, 0xED, 0xEF, 0xFE, 0xDA
_FILL = 0xFF
_MOST_SEGMENTS = 256
_MOST_ENTRIES = 512
_MOST_TABLES = 16
_GPS, _CAMERA = 0x8825, 0x8769
_ASCII, _UTF8 = 2, 129
_MAKERS_NOTE, _COMMENT = 0x927C, 0x9286
_XP = range(0x9C9B, 0x9CA0)
_CHARSET = 8  # bytes that name it, before a comment
_TAGS: dict[int, tuple[Kind, str]] = {
    0x013B: ("operator", "who made the picture"),
    0x013C: ("host", "the computer that made the picture"),
    0x9C9D: ("operator", "who made the picture"),
    0xA430: ("operator", "the camera's owner"),
    0xA431: ("serial", "the camera's serial number"),
    0xA435: ("serial", "the lens's serial number"),
}
_SIZES = (0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8)


def jpeg_patches(read: ReadAt, size: int, names: Names | None = None) -> Iterator[Patch]:
    """Yield what the segments before the picture say that may be private.

    Parameters
    ----------
    read : callable
    size : int
        Of the file, bytes.
    names : mapping of str to str, optional
        People whom the dataset names.
    """
    at = 2
    for _ in range(_MOST_SEGMENTS):
        if at + 4 > size:
            return
        prefix, marker, length = struct.unpack(">BBH", read(at, 4))
        if prefix == _FILL and marker == _FILL:
            at += 1
            continue
        if prefix != 0xFF or marker == _SOS or length < 2 or at + 2 + length > size:
            return
        if _APP0 <= marker <= _APP15 or marker == _COM:
            yield from _segment(marker, read(at + 4, length - 2), at + 4, names or {})
        at += 2 + length


def _segment(marker: int, content: bytes, start: int, names: Names) -> Iterator[Patch]:
    if content.startswith(_DECODING) and marker != _COM:
        return
    if marker == _APP1 and content.startswith(_EXIF):
        yield from _exif(content[len(_EXIF) :], start + len(_EXIF), names)
    elif marker == _APP1 and content.startswith((_XMP, _MORE_XMP)):
        head = len(_XMP) if content.startswith(_XMP) else _MORE_XMP_HEAD
        yield from xmp_patches(content[head:], start + head, names)
    elif marker == _APP13:
        yield from iptc_patches(content, start, names)
    elif marker == _COM or is_text(content):
        yield from text_patches(content, start, names)
    else:
        yield from name_patches(content, start, names)


def _exif(tiff: bytes, start: int, names: Names) -> Iterator[Patch]:
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    if order is None or len(tiff) < 8:
        return
    pending = [int(struct.unpack_from(f"{order}I", tiff, 4)[0])]
    seen: set[int] = set()
    while pending and len(seen) < _MOST_TABLES:
        at = pending.pop()
        if at in seen or at + 2 > len(tiff):
            continue
        seen.add(at)
        pending += _next_table(tiff, at, order)
        for tag, form, place, length in _entries(tiff, at, order):
            if tag in (_GPS, _CAMERA):
                inner = int(struct.unpack_from(f"{order}I", tiff, place)[0])
                if tag == _CAMERA:
                    pending.append(inner)
                else:
                    yield from _position(tiff, inner, order, start)
            elif tag in _TAGS and any(tiff[place : place + length]):
                kind, why = _TAGS[tag]
                value = tiff[place : place + length]
                told = _told_in_xp(value) if tag in _XP else printable(value)
                yield Patch(kind, start + place, bytes(length), told, why)
            else:
                value = tiff[place : place + length]
                yield from _value(tag, form, value, start + place, names)


def _value(tag: int, form: int, value: bytes, start: int, names: Names) -> Iterator[Patch]:
    """Yield what the texts of a table say."""
    if tag in _XP:
        yield from text_patches(value, start, names, "utf-16-le")
    elif tag == _COMMENT:
        # Programs do not agree in which order the bytes of a letter lie here.
        is_wide = value.startswith(b"UNICODE\0")
        for encoding in ("utf-16-le", "utf-16-be") if is_wide else (None,):
            yield from text_patches(value[_CHARSET:], start + _CHARSET, names, encoding)
    elif form in (_ASCII, _UTF8):
        yield from text_patches(value, start, names)
    elif tag == _MAKERS_NOTE:
        yield from name_patches(value, start, names)


def _told_in_xp(value: bytes) -> str:
    return value.decode("utf-16-le", "replace").rstrip("\0")


def _next_table(tiff: bytes, at: int, order: str) -> Iterator[int]:
    """Yield where the next table is, such as that of the small picture."""
    end = at + 2 + 12 * int(struct.unpack_from(f"{order}H", tiff, at)[0])
    if end + 4 <= len(tiff):
        following = int(struct.unpack_from(f"{order}I", tiff, end)[0])
        if following:
            yield following


def _position(tiff: bytes, at: int, order: str, start: int) -> Iterator[Patch]:
    """Yield the values of the table of positions; an empty table stays."""
    entries = list(_entries(tiff, at, order))
    if not entries:
        return
    why = "the picture's position"
    yield Patch("gps", start + at, bytes(2 + 12 * len(entries)), "Exif GPS", why)
    for _, _, place, length in entries:
        is_inside = at + 2 <= place < at + 2 + 12 * len(entries)
        if not is_inside and any(tiff[place : place + length]):
            yield Patch("gps", start + place, bytes(length), "Exif GPS", why)


def _entries(tiff: bytes, at: int, order: str) -> Iterator[tuple[int, int, int, int]]:
    """Yield tag, form, place and length of the values of a table."""
    if at + 2 > len(tiff):
        return
    count = min(int(struct.unpack_from(f"{order}H", tiff, at)[0]), _MOST_ENTRIES)
    for number in range(count):
        entry = at + 2 + 12 * number
        if entry + 12 > len(tiff):
            return
        tag, kind, values = struct.unpack_from(f"{order}HHI", tiff, entry)
        length = (_SIZES[kind] if kind < len(_SIZES) else 1) * values
        place = entry + 8
        if length > 4:
            place = int(struct.unpack_from(f"{order}I", tiff, entry + 8)[0])
        if place + length <= len(tiff):
            yield tag, kind, place, length
