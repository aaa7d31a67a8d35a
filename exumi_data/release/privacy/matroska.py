"""What in a Matroska or WebM file may be private, found in its elements without decoding anything.

A text that is taken out becomes zeros, which say nothing in Matroska, and the checksum of what it
stands in becomes an element ``Void``: no byte that stays moves.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from exumi_data.errors import LimitError
from exumi_data.release.privacy.patches import Patch, ReadAt, zeros
from exumi_data.release.privacy.tags import Names, told_by_tag

__all__ = ["is_matroska", "matroska_patches"]

_SEGMENT, _CLUSTER, _TRACKS, _SIMPLE_TAG = 0x18538067, 0x1F43B675, 0x1654AE6B, 0x67C8
# Segment, Info, Tracks, TrackEntry, Tags, Tag, SimpleTag; Chapters and what is in them;
# Attachments, AttachedFile.
_MASTERS = frozenset([
    _SEGMENT, 0x1549A966, _TRACKS, 0xAE, 0x1254C367, 0x7373, _SIMPLE_TAG,
    0x1043A770, 0x45B9, 0xB6, 0x80, 0x1941A469, 0x61A7,
])  # fmt: skip
_TRACK_TYPE = 0x83
_TEXT_TRACKS = frozenset((b"\x11", b"\x21"))  # subtitles, metadata
_TAG_NAME, _TAG_STRING, _TAG_BINARY, _FILE_DATA, _CRC = 0x45A3, 0x4487, 0x4485, 0x465C, 0xBF
# Title, names of tracks, files, programs, chapters, attached files and their descriptions.
_TEXTS = frozenset(
    (0x7BA9, 0x536E, 0x7384, 0x3C83AB, 0x3E83BB, 0x4D80, 0x5741, 0x85, 0x466E, 0x467E)
)
_MAX_ELEMENTS = 2_000_000
_MAX_TEXT = 8 << 20
_DEEPEST = 12
_VOID = b"\xec\x84" + bytes(4)


@dataclass(frozen=True, slots=True)
class _Element:
    id: int
    at: int
    start: int
    end: int
    is_open: bool

    @property
    def size(self) -> int:
        return self.end - self.start


def is_matroska(read: ReadAt, size: int) -> bool:
    """Whether a file has the form that is understood here."""
    return size >= 4 and read(0, 4) == b"\x1a\x45\xdf\xa3"


def matroska_patches(read: ReadAt, size: int, names: Names) -> Iterator[Patch]:
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
        It has more elements than any program makes.
    """
    yield from _Walk(read, names).elements(0, size, 0, ())


class _Walk:
    def __init__(self, read: ReadAt, names: Names) -> None:
        self.read, self.names, self._seen = read, names, 0

    def elements(
        self, at: int, end: int, depth: int, checksums: tuple[int, ...]
    ) -> Iterator[Patch]:
        name = ""
        while at < end:
            element = self._element(at, end)
            is_block = element.id == _CLUSTER and not element.is_open
            if element.id == _CRC and element.size == 4:
                checksums = (*checksums, element.at)
            elif (element.id in _MASTERS or element.id == _CLUSTER) and not is_block:
                if depth < _DEEPEST:
                    yield from self.elements(element.start, element.end, depth + 1, checksums)
            elif element.id == _TRACK_TYPE:
                # Drones write where they are into subtitles, frame by frame.
                if self.read(element.start, min(element.size, 8))[-1:] in _TEXT_TRACKS:
                    why = "a track of subtitles or metadata, which is not looked into"
                    yield Patch("gps", 0, b"", "subtitles", why)
            elif element.id == _TAG_NAME:
                name = self._text(element)
            elif element.id in (_TAG_STRING, _TAG_BINARY):
                yield from self._said(element, name, checksums)
            elif element.id in _TEXTS:
                yield from self._said(element, "", checksums)
            elif element.id == _FILE_DATA and any(self.read(element.start, min(element.size, 64))):
                why = "an attached file, which is not looked into"
                yield Patch("gps", element.start, zeros(element.size), "attached file", why)
                yield from self._unchecked(Patch("gps", 0, b"", "attached file", why), checksums)
            at = element.end

    def _said(self, element: _Element, name: str, checksums: tuple[int, ...]) -> Iterator[Patch]:
        for kind, value, why in told_by_tag(name, self._text(element), self.names):
            patch = Patch(kind, element.start, zeros(element.size), value, why)
            yield patch
            yield from self._unchecked(patch, checksums)

    def _unchecked(self, patch: Patch, checksums: tuple[int, ...]) -> Iterator[Patch]:
        """Yield what goes along with a patch: the checksums of what it stands in."""
        for at in checksums:
            yield Patch(patch.kind, at, _VOID, patch.value, patch.why)

    def _text(self, element: _Element) -> str:
        content = self.read(element.start, min(element.size, _MAX_TEXT))
        return content.split(b"\0")[0].decode("utf-8", "replace")

    def _element(self, at: int, end: int) -> _Element:
        self._seen += 1
        if self._seen > _MAX_ELEMENTS:
            raise LimitError(f"the video has more than {_MAX_ELEMENTS:,} elements")
        head = self.read(at, min(12, end - at))
        width = 9 - head[0].bit_length()
        if width > 4 or len(head) <= width or not head[width]:
            return _Element(0, at, end, end, is_open=False)  # damaged: nothing after it is read
        of_size = 9 - head[width].bit_length()
        start = at + width + of_size
        length = int.from_bytes(head[width : width + of_size], "big") & ((1 << 7 * of_size) - 1)
        is_open = length == (1 << 7 * of_size) - 1
        stop = end if is_open else min(start + length, end)
        return _Element(int.from_bytes(head[:width], "big"), at, min(start, end), stop, is_open)
