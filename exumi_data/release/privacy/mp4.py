"""What in an MP4 or QuickTime file may be private, found in its boxes without decoding anything.

What is taken out of the table of contents becomes a box ``free`` of the same length, and samples
of metadata tracks become zeros: no byte that stays moves, so pictures and times stay what they are.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
import numpy.typing as npt

from exumi_data.clips.gpmf import MAX_PAYLOAD_BYTES
from exumi_data.errors import LimitError
from exumi_data.release.privacy.gpmf import gpmf_patches
from exumi_data.release.privacy.kinds import Kind
from exumi_data.release.privacy.patches import Patch, ReadAt, printable, zeros
from exumi_data.release.privacy.tags import Names
from exumi_data.release.privacy.text import matches_in
from exumi_data.release.privacy.xmp import xmp_patches

__all__ = ["is_mp4", "mp4_patches"]

_FIRST = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot", b"uuid")
_CONTAINERS = frozenset([
    b"moov", b"trak", b"mdia", b"minf", b"stbl", b"udta", b"ilst", b"edts", b"mvex", b"moof",
    b"traf",
])  # fmt: skip
_MAX_BOXES = 200_000
_DEEPEST = 12
_MAX_TABLE = 64 << 20
_MAX_SAMPLES = 2_000_000
_MAX_SMALL = 8 << 20
_ITEMS = "ilst"
_XMP_ID = bytes.fromhex("be7acfcb97a942e89c71999491e3afac")
_PLACES = {b"\xa9xyz": "the clip's position", b"loci": "the clip's position"}
_IDS = {
    b"CAME": "the camera's own id",
    b"LENS": "the lens's serial number",
    b"MUID": "an id of camera and clip",
    b"GUMI": "an id of camera and clip",
    b"BCID": "an id of a broadcast",
    b"SNum": "the camera's serial number",
}
_PEOPLE = frozenset((b"\xa9ART", b"\xa9aut", b"\xa9dir", b"\xa9wrt", b"\xa9prd", b"auth", b"perf"))
_KEYS: tuple[tuple[re.Pattern[str], Kind], ...] = (
    (re.compile(r"location|gps|latitude|longitude", re.IGNORECASE), "gps"),
    (re.compile(r"serial|identifier|uuid", re.IGNORECASE), "serial"),
    (re.compile(r"author|artist|director|producer", re.IGNORECASE), "operator"),
)
# Tracks whose samples are pictures, sound or plain time.
_KNOWN = frozenset((b"vide", b"soun", b"tmcd", b"hint"))
# Drones write where they are into subtitles, frame by frame.
_TEXTS = frozenset((b"text", b"sbtl", b"subt"))
_SECRET = 8


@dataclass(frozen=True, slots=True)
class _Box:
    kind: bytes
    at: int
    start: int
    end: int
    rest: bytes
    """What lies between its kind and its content: of a long length, that length."""

    @property
    def size(self) -> int:
        return self.end - self.start


@dataclass(slots=True)
class _Track:
    """What the boxes of a track say; where its tables lie."""

    handler: bytes = b""
    format: bytes = b""
    tables: dict[bytes, _Box] = field(default_factory=dict)


def is_mp4(read: ReadAt, size: int) -> bool:
    """Whether a file has the form that is understood here."""
    return size >= 8 and read(4, 4) in _FIRST


def mp4_patches(read: ReadAt, size: int, names: Names | None = None) -> Iterator[Patch]:
    """Yield what in a file may be private.

    Parameters
    ----------
    read : callable
    size : int
        Of the file, bytes.
    names : mapping of str to str, optional
        People whom the dataset names.

    Raises
    ------
    LimitError
        Its tables are larger than any camera makes them.
    """
    walk = _Walk(read, size, names or {})
    yield from walk.boxes(0, size, 0, None, b"")
    for track in walk.tracks:
        yield from _track_patches(walk, track)


class _Walk:
    def __init__(self, read: ReadAt, size: int, names: Names) -> None:
        self.read = read
        self.names = names
        self.size = size
        self.tracks: list[_Track] = []
        self.is_fragmented = False
        self._seen = 0
        self._keys: dict[int, str] = {}

    def boxes(
        self, at: int, end: int, depth: int, track: _Track | None, parent: bytes
    ) -> Iterator[Patch]:
        while at + 8 <= end:
            self._seen += 1
            if self._seen > _MAX_BOXES:
                raise LimitError(f"the video has more than {_MAX_BOXES:,} boxes")
            box = self._box(at, end)
            self.is_fragmented |= box.kind == b"moof"
            if box.kind == b"trak" and depth < _DEEPEST:
                inner = _Track()
                self.tracks.append(inner)
                yield from self.boxes(box.start, box.end, depth + 1, inner, box.kind)
            elif box.kind in _CONTAINERS and depth < _DEEPEST:
                yield from self.boxes(box.start, box.end, depth + 1, track, box.kind)
            elif box.kind == b"meta" and depth < _DEEPEST:
                # In MP4 it begins with a version, in QuickTime files with its first box.
                skip = 0 if self._piece(box, 8)[4:] == b"hdlr" else 4
                yield from self.boxes(box.start + skip, box.end, depth + 1, track, box.kind)
            else:
                self._note(track, box)
                yield from self._leaf(box, parent)
            at = box.end

    def _box(self, at: int, end: int) -> _Box:
        head = self.read(at, min(16, end - at))
        length, start, rest = int.from_bytes(head[:4], "big"), at + 8, b""
        if length == 1 and len(head) == 16:
            length, start, rest = int.from_bytes(head[8:16], "big"), at + 16, head[8:]
        elif length == 0:
            length = end - at
        stop = min(max(at + length, start), end)
        return _Box(head[4:8], at, start, stop, rest)

    def _piece(self, box: _Box, length: int) -> bytes:
        return self.read(box.start, min(length, box.size))

    def _note(self, track: _Track | None, box: _Box) -> None:
        if box.kind == b"keys":
            self._keys = dict(enumerate(_key_names(self._piece(box, _MAX_SMALL)), 1))
        elif track is None:
            return
        elif box.kind == b"hdlr" and not track.handler:
            track.handler = self._piece(box, 12)[8:12]
        elif box.kind == b"stsd":
            track.format = self._piece(box, 16)[12:16]
        elif box.kind in (b"stsz", b"stz2", b"stsc", b"stco", b"co64"):
            track.tables[box.kind] = box

    def _leaf(self, box: _Box, parent: bytes) -> Iterator[Patch]:
        if box.kind == b"GPMF":
            yield from gpmf_patches(self._piece(box, MAX_PAYLOAD_BYTES), box.start)
        elif box.kind in (b"XMP_", b"uuid"):
            skip = 0 if box.kind == b"XMP_" else 16
            if not skip or self._piece(box, 16) == _XMP_ID:
                packet = self._piece(box, _MAX_SMALL)[skip:]
                yield from xmp_patches(packet, box.start + skip, self.names)
        elif parent in (b"udta", b"ilst"):
            yield from self._said(box, parent)

    def _said(self, box: _Box, parent: bytes) -> Iterator[Patch]:
        if box.kind == b"free":
            return
        if box.size > _MAX_SMALL:
            name = printable(box.kind)
            yield _freed(box, "gps", name, "a part of the file's own description too long to read")
            return
        content = self._piece(box, _MAX_SMALL)
        kind, why = self._meaning(box, parent)
        value = _place(content) if box.kind == b"loci" else _words(content, parent)
        if kind is not None:
            if any(content):
                secret = content.strip(b"\0")
                whole = secret if kind == "serial" and len(secret) >= _SECRET else b""
                yield _freed(box, kind, value, why, whole)
            return
        for match in matches_in(value, self.names):
            part = value[match.start : match.stop]
            yield _freed(box, match.kind, part, f"{match.why} in the file's own description")

    def _meaning(self, box: _Box, parent: bytes) -> tuple[Kind | None, str]:
        if box.kind in _PLACES:
            return "gps", _PLACES[box.kind]
        if box.kind in _IDS:
            return "serial", _IDS[box.kind]
        if box.kind in _PEOPLE:
            return "operator", "who made the clip"
        name = self._keys.get(int.from_bytes(box.kind, "big"), "") if parent == b"ilst" else ""
        for pattern, kind in _KEYS:
            if pattern.search(name):
                return kind, f"the clip says {name}"
        return None, ""


def _key_names(content: bytes) -> Iterator[str]:
    at = 8
    while at + 8 <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        if length < 8:
            return
        yield content[at + 8 : at + length].decode("utf-8", "replace")
        at += length


def _place(content: bytes) -> str:
    """Return the position in a box ``loci``, rounded: after a language, a name and a role."""
    at = content.find(b"\0", 6) + 2
    if at < 8 or at + 8 > len(content):
        return "loci"
    longitude, latitude = np.frombuffer(content[at : at + 8], ">i4") / 65536
    return f"{latitude:.1f}, {longitude:.1f}"


def _words(content: bytes, parent: bytes) -> str:
    """Return what a box says: after a length and a language, or in a box ``data``."""
    if parent == b"ilst":
        content = content[16:]
    elif content[4:5].isascii() and int.from_bytes(content[:2], "big") == len(content) - 4:
        content = content[4:]
    return printable(content) if not _is_text(content) else content.strip(b"\0").decode("utf-8")


def _is_text(content: bytes) -> bool:
    try:
        text = content.strip(b"\0").decode("utf-8")
    except UnicodeDecodeError:
        return False
    return text.replace("\n", " ").isprintable()


def _freed(box: _Box, kind: Kind, value: str, why: str, secret: bytes = b"") -> Patch:
    content = zeros(box.size)
    new = b"free" + box.rest + content if len(content) == box.size else b""
    return Patch(kind, box.at + 4, new, value, why, secret)


def _track_patches(walk: _Walk, track: _Track) -> Iterator[Patch]:
    if track.handler in _KNOWN or track.format == b"tmcd":
        return
    name = track.format.decode("latin-1").strip() or "unknown"
    if walk.is_fragmented:
        why = f"a track {name!r} in fragments, which are not looked into"
        yield Patch("gps", 0, b"", name, why)
        return
    samples = _samples(walk, track)
    if samples is None:
        if track.tables:
            why = f"a track {name!r} whose tables are not understood"
            yield Patch("gps", 0, b"", name, why)
    elif track.format == b"gpmd":
        yield from _telemetry_patches(walk, samples, name)
    elif track.format == b"fdsc":
        yield from _recovery_patches(walk, samples)
    else:
        why = f"a metadata track of the form {name!r}, which is not understood"
        if track.handler in _TEXTS:
            why = f"subtitles or other text of the form {name!r}, which may say where it was"
        for start, length in samples:
            if any(walk.read(start, min(length, MAX_PAYLOAD_BYTES))):
                yield Patch("gps", start, zeros(length), name, why)


def _telemetry_patches(
    walk: _Walk, samples: Iterator[tuple[int, int]], name: str
) -> Iterator[Patch]:
    for start, length in samples:
        if length <= MAX_PAYLOAD_BYTES:
            yield from gpmf_patches(walk.read(start, length), start)
        else:
            yield Patch("gps", start, zeros(length), name, "telemetry that is too long to read")


def _recovery_patches(walk: _Walk, samples: Iterator[tuple[int, int]]) -> Iterator[Patch]:
    """Yield what is in the copy of the camera's header by which GoPro's mend broken files."""
    for start, length in samples:
        content = walk.read(start, min(length, MAX_PAYLOAD_BYTES))
        if not any(content):
            continue
        for match in matches_in(content.decode("ascii", "replace")):
            if match.kind == "gps":
                value = content[match.start : match.stop]
                yield Patch(
                    "gps",
                    start + match.start,
                    bytes(len(value)),
                    printable(value),
                    "the clip's position, in GoPro's recovery track",
                    value,
                )
        is_header = content.startswith(b"GPRO") and length >= 200
        if is_header:
            why = "camera's and lens's serial numbers, in GoPro's recovery track"
            yield Patch("serial", start, zeros(length), _serials(content), why)


def _serials(content: bytes) -> str:
    found = re.findall(rb"(?:LAE|C)\d{13,14}", content)
    return ", ".join(dict.fromkeys(one.decode() for one in found)) or "GPRO"


def _samples(walk: _Walk, track: _Track) -> Iterator[tuple[int, int]] | None:
    """Return the place and the length of each sample; None where the tables do not tell them."""
    sizes = _sizes(walk, track.tables.get(b"stsz"))
    offsets = _table(walk, track.tables.get(b"stco"), ">u4")
    if offsets is None:
        offsets = _table(walk, track.tables.get(b"co64"), ">u8")
    runs = _table(walk, track.tables.get(b"stsc"), ">u4", columns=3)
    if sizes is None or offsets is None or runs is None:
        return None
    if int(sizes.sum()) > walk.size:
        raise LimitError("samples of a track of the video overlap")
    return _placed(walk.size, sizes, offsets, runs)


def _placed(
    end: int,
    sizes: npt.NDArray[np.uint64],
    offsets: npt.NDArray[np.uint64],
    runs: npt.NDArray[np.uint64],
) -> Iterator[tuple[int, int]]:
    lengths = iter(sizes.tolist())
    for chunk, place in enumerate(offsets.tolist(), 1):
        run = int(np.searchsorted(runs[:, 0], chunk, side="right")) - 1
        if run < 0:
            return
        start = place
        for length in islice(lengths, int(runs[run, 1])):
            if start + length > end:
                return
            yield start, length
            start += length


def _sizes(walk: _Walk, box: _Box | None) -> npt.NDArray[np.uint64] | None:
    if box is None or box.size < 12:
        return None
    _, each, count = np.frombuffer(walk.read(box.start, 12), ">u4").tolist()
    if count > _MAX_SAMPLES:
        raise LimitError(f"a table of the video claims {count:,} samples")
    if each:
        return np.full(count, each, np.uint64)
    raw = walk.read(box.start + 12, min(4 * count, (box.size - 12) // 4 * 4))
    return np.frombuffer(raw, ">u4").astype(np.uint64)


def _table(
    walk: _Walk, box: _Box | None, dtype: str, *, columns: int = 1
) -> npt.NDArray[np.uint64] | None:
    if box is None or box.size < 8:
        return None
    row = np.dtype(dtype).itemsize * columns
    count = min(int.from_bytes(walk.read(box.start + 4, 4), "big"), (box.size - 8) // row)
    if count * row > _MAX_TABLE:
        raise LimitError(f"a table of the video claims {count:,} entries")
    values = np.frombuffer(walk.read(box.start + 8, count * row), dtype).astype(np.uint64)
    return values.reshape(count, columns) if columns > 1 else values
