"""What in the head of a JPEG may be private: Exif's position and serial numbers, XMP packets."""

import struct
from collections.abc import Iterator

from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.patches import Patch, ReadAt, printable
from exumi_data.release.privacy.text import matches_in
from exumi_data.release.privacy.xmp import xmp_patches

__all__ = ["jpeg_patches"]

_EXIF, _XMP = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"
_APP0, _APP1, _APP15, _COM, _SOS = 0xE0, 0xE1, 0xEF, 0xFE, 0xDA
_MOST_SEGMENTS = 256
_MOST_ENTRIES = 512
_MOST_TABLES = 16
_GPS, _CAMERA = 0x8825, 0x8769
_TAGS: dict[int, tuple[Kind, str]] = {
    0x013B: ("operator", "who made the picture"),
    0x013C: ("host", "the computer that made the picture"),
    0xA430: ("operator", "the camera's owner"),
    0xA431: ("serial", "the camera's serial number"),
    0xA435: ("serial", "the lens's serial number"),
}
_SIZES = (0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8)


def jpeg_patches(read: ReadAt, size: int) -> Iterator[Patch]:
    """Yield what the segments before the picture say that may be private.

    Parameters
    ----------
    read : callable
    size : int
        Of the file, bytes.
    """
    at = 2
    for _ in range(_MOST_SEGMENTS):
        if at + 4 > size:
            return
        prefix, marker, length = struct.unpack(">BBH", read(at, 4))
        if prefix != 0xFF or marker == _SOS or length < 2 or at + 2 + length > size:
            return
        if marker in (_APP1, _COM):
            yield from _segment(marker, read(at + 4, length - 2), at + 4)
        at += 2 + length


def _segment(marker: int, content: bytes, start: int) -> Iterator[Patch]:
    if marker == _COM:
        for match in matches_in(content.decode("latin-1")):
            value = content[match.start : match.stop]
            new = b" " * len(value)
            yield Patch(match.kind, start + match.start, new, printable(value), match.why)
    elif content.startswith(_EXIF):
        yield from _exif(content[len(_EXIF) :], start + len(_EXIF))
    elif content.startswith(_XMP):
        yield from xmp_patches(content[len(_XMP) :], start + len(_XMP))


def _exif(tiff: bytes, start: int) -> Iterator[Patch]:
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
        for tag, place, length in _entries(tiff, at, order):
            if tag in (_GPS, _CAMERA):
                inner = int(struct.unpack_from(f"{order}I", tiff, place)[0])
                if tag == _CAMERA:
                    pending.append(inner)
                else:
                    yield from _position(tiff, inner, order, start)
            elif tag in _TAGS and any(tiff[place : place + length]):
                kind, why = _TAGS[tag]
                value = tiff[place : place + length]
                yield Patch(kind, start + place, bytes(length), printable(value), why)


def _position(tiff: bytes, at: int, order: str, start: int) -> Iterator[Patch]:
    """Yield the values of the table of positions; an empty table stays."""
    entries = list(_entries(tiff, at, order))
    if not entries:
        return
    why = "the picture's position"
    yield Patch("gps", start + at, bytes(2 + 12 * len(entries)), "Exif GPS", why)
    for _, place, length in entries:
        is_inside = at + 2 <= place < at + 2 + 12 * len(entries)
        if not is_inside and any(tiff[place : place + length]):
            yield Patch("gps", start + place, bytes(length), "Exif GPS", why)


def _entries(tiff: bytes, at: int, order: str) -> Iterator[tuple[int, int, int]]:
    """Yield tag, place and length of the values of a table."""
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
            yield tag, place, length
