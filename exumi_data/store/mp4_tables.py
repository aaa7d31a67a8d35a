"""The sample tables of MP4 and QuickTime files, asked before FFmpeg believes them.

A table can claim any number of samples of one size, or of none, in a dozen bytes: FFmpeg takes a
hundred bytes of memory for each of them, and tries to read them all.
"""

from dataclasses import dataclass
from typing import IO

__all__ = ["MAX_SAMPLES", "tables_mistake"]

MAX_SAMPLES = 2_000_000
"""Samples of one track that are believed: nine hours of 60 frames a second."""
_MAX_BOXES = 200_000
_CONTAINERS = frozenset(
    (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"moof", b"traf", b"mvex", b"edts", b"udta")
)
_HEAD = 32
_DEEPEST = 12


@dataclass
class _Track:
    """What the tables of a track claim, the largest of each."""

    samples: int = 0
    is_audio: bool = False
    is_even: bool = False
    """Every sample has one tick: FFmpeg then reads chunks of them."""


def tables_mistake(file: IO[bytes]) -> str | None:
    """Return why a file's tables are not to be believed; None where they are, or there are none.

    Parameters
    ----------
    file : binary file
        Any video file; it is left at its beginning.
    """
    size = file.seek(0, 2)
    file.seek(4)
    is_mp4 = file.read(4) in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")
    mistake = _walk(file, size) if is_mp4 else None
    file.seek(0)
    return mistake


def _walk(file: IO[bytes], size: int) -> str | None:
    tracks = [_Track()]
    pending = [(0, size, 0, tracks[0])]
    seen = 0
    while pending:
        at, end, depth, track = pending.pop()
        while at + 8 <= end:
            seen += 1
            if seen > _MAX_BOXES:
                return f"it has more than {_MAX_BOXES:,} boxes"
            file.seek(at)
            head = file.read(_HEAD)
            if len(head) < 8:
                break
            length, start = _length(head, at, end)
            kind = head[4:8]
            if kind == b"cmov":
                return "its table of contents is compressed"
            _note(track, kind, head[start - at :])
            if kind in _CONTAINERS and depth < _DEEPEST:
                inner = _Track() if kind in (b"trak", b"traf") else track
                tracks.append(inner)
                pending.append((start, min(at + length, end), depth + 1, inner))
            at += length
    for track in tracks:
        # Uncompressed sound has a sample for each of its ticks, and is not read one by one.
        if track.samples > MAX_SAMPLES and not (track.is_audio and track.is_even):
            return f"a table claims {track.samples:,} samples"
    return None


def _length(head: bytes, at: int, end: int) -> tuple[int, int]:
    """Return a box's length, and where its content begins."""
    length = int.from_bytes(head[:4], "big")
    if length == 1 and len(head) >= 16:
        return max(16, int.from_bytes(head[8:16], "big")), at + 16
    if length == 0:
        return end - at, at + 8
    return max(8, length), at + 8


def _note(track: _Track, kind: bytes, content: bytes) -> None:
    words = [int.from_bytes(content[at : at + 4], "big") for at in range(0, 16, 4)]
    if kind in (b"stsz", b"stz2"):
        track.samples = max(track.samples, words[2])
    elif kind == b"trun":
        track.samples = max(track.samples, words[1])
    elif kind == b"hdlr" and content[8:12] in (b"soun", b"vide"):
        track.is_audio = content[8:12] == b"soun"
    elif kind == b"stts":
        track.is_even = words[1] == 1 and words[3] == 1
