"""An episode looked through: its documents, its video files, the heads of its JPEG frames."""

import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from exumi_data.episode import Episode
from exumi_data.errors import SourceError
from exumi_data.model.documents import load_json
from exumi_data.model.images import EncodedImages, VideoImages
from exumi_data.model.streams import images_of
from exumi_data.release.privacy.avi import avi_patches, is_avi
from exumi_data.release.privacy.documents import (
    Removal,
    private_names,
    without_private_fields,
)
from exumi_data.release.privacy.exif import jpeg_patches
from exumi_data.release.privacy.kinds import Kind, Take
from exumi_data.release.privacy.matroska import is_matroska, matroska_patches
from exumi_data.release.privacy.mp4 import is_mp4, mp4_patches
from exumi_data.release.privacy.patches import Patch, ReadAt
from exumi_data.release.privacy.tags import Names, told_by_tag
from exumi_data.store.access import Store
from exumi_data.store.shards import ArrayReader, open_array

__all__ = ["FilePatches", "Scan", "read_at", "scan_store"]

_DOCUMENT = "zarr.json"
_HEAD = 4096


@dataclass(slots=True)
class FilePatches:
    """What is to be written over a file of a stream.

    Attributes
    ----------
    stream : str
    index : int
        Which of its files, or of its frames.
    name : str
    start, size : int
        Where in the stream's bytes it begins, and how long it is.
    patches : list of Patch
    """

    stream: str
    index: int
    name: str
    start: int
    size: int
    patches: list[Patch]


@dataclass(slots=True)
class Scan:
    """What of an episode is to be taken out.

    Attributes
    ----------
    documents : dict of str to object
        Documents that change, as they are to be.
    fields : list of (str, str)
        Kind, and document and pointer, of what was taken out of them.
    videos, frames : list of FilePatches
        Of those in which something is to be overwritten.
    """

    documents: dict[str, Any] = field(default_factory=dict)
    fields: list[tuple[Kind, str]] = field(default_factory=list)
    videos: list[FilePatches] = field(default_factory=list)
    frames: list[FilePatches] = field(default_factory=list)


def scan_store(store: Store, take: Take, removal: Removal | None = None) -> Scan:
    """Look through an episode.

    Looked at are all strings of its documents; of video files the table of contents and the
    metadata tracks; of JPEG frames the segments before the picture. Pictures, sound and numbers are
    not looked at.

    Parameters
    ----------
    store : Store
    take : callable
        Told of each find; says whether it is taken out.
    removal : Removal, optional
        Makes pseudonyms.

    Returns
    -------
    Scan

    Raises
    ------
    ExumiError
        The episode cannot be read.
    """
    scan = Scan()
    document = load_json(store.read(_DOCUMENT), f"{store.location}/{_DOCUMENT}")
    # What the episode calls private is so in the heads of its files, too.
    names = {**(removal.names if removal is not None else {}), **private_names(document)}
    _scan_documents(store, take, removal, scan)
    with Episode(store) as episode:
        for name, stream in episode.streams.items():
            images = images_of(stream.metadata)
            if isinstance(images, VideoImages):
                _scan_videos(store, name, images, take, scan, names)
            elif isinstance(images, EncodedImages):
                _scan_frames(store, name, take, scan, names)
    return scan


def read_at(array: ArrayReader, start: int, size: int) -> ReadAt:
    """Return a reader of one file of a stream's bytes.

    Parameters
    ----------
    array : ArrayReader
        ``data`` of the stream.
    start, size : int
        Where the file begins, and its length.
    """

    def read(at: int, length: int) -> bytes:
        return array.bytes_at(start + at, max(0, min(length, size - at)))

    return read


def _scan_documents(store: Store, take: Take, removal: Removal | None, scan: Scan) -> None:
    for path in store.paths():
        if path.rpartition("/")[2] != _DOCUMENT:
            continue
        document = load_json(store.read(path), f"{store.location}/{path}")

        def noted(kind: Kind, where: str, value: str, why: str, *, removable: bool = True) -> bool:
            taken = take(kind, where, value, why, removable=removable)
            if taken:
                scan.fields.append((kind, where))
            return taken

        changed = without_private_fields(document, path, noted, removal)
        if changed != document:
            scan.documents[path] = changed


def _scan_videos(  # of one stream
    store: Store, name: str, images: VideoImages, take: Take, scan: Scan, names: Names
) -> None:
    array = open_array(store, f"streams/{name}/data")
    offset = open_array(store, f"streams/{name}/offset").read().tolist()
    for index, file in enumerate(images.files):
        start, size = offset[index], offset[index + 1] - offset[index]
        where = f"streams/{name}: {file.name}"
        found = _taken(_video_patches(read_at(array, start, size), size, where, names), where, take)
        if found:
            scan.videos.append(FilePatches(name, index, file.name, start, size, found))


def _scan_frames(store: Store, name: str, take: Take, scan: Scan, names: Names) -> None:
    array = open_array(store, f"streams/{name}/data")
    offset = open_array(store, f"streams/{name}/offset").read().tolist()
    decided: dict[tuple[Kind, str, bool], bool] = {}
    for index in range(len(offset) - 1):
        start, size = offset[index], offset[index + 1] - offset[index]
        # One read for nearly all frames: they have no such segments, or short ones.
        head = array.bytes_at(start, min(size, _HEAD))
        read = _with_head(head, read_at(array, start, size))
        where = f"streams/{name}: JPEG frames"
        found = _taken(jpeg_patches(read, size, names), where, take, decided)
        if found:
            scan.frames.append(FilePatches(name, index, f"frame {index}", start, size, found))


def _with_head(head: bytes, read: ReadAt) -> ReadAt:
    def of(at: int, length: int) -> bytes:
        return head[at : at + length] if at + length <= len(head) else read(at, length)

    return of


def _taken(
    patches: Iterator[Patch],
    where: str,
    take: Take,
    decided: dict[tuple[Kind, str, bool], bool] | None = None,
) -> list[Patch]:
    """Return those patches that are taken; each kind of find is told once a file."""
    known = {} if decided is None else decided
    found = []
    for patch in patches:
        removable = bool(patch.new)
        key = (patch.kind, patch.why, removable)
        if key not in known:
            taken = take(patch.kind, where, patch.value, patch.why, removable=removable)
            known[key] = taken and removable
        if known[key]:
            found.append(patch)
    return found


def _video_patches(read: ReadAt, size: int, where: str, names: Names) -> Iterator[Patch]:
    if is_mp4(read, size):
        yield from mp4_patches(read, size, names)
    elif is_avi(read, size):
        yield from avi_patches(read, size, names)
    elif is_matroska(read, size):
        yield from matroska_patches(read, size, names)
    else:
        yield from _tag_patches(read, size, where, names)


def _tag_patches(read: ReadAt, size: int, where: str, names: Names) -> Iterator[Patch]:
    """Yield what other containers say in words. It cannot be taken out of what is not known."""
    from exumi_data.store.video import VideoDecoder  # PyAV is slow to import

    try:
        with VideoDecoder(io.BufferedReader(_File(read, size)), where) as decoder:
            tags = dict(decoder.tags)
    except SourceError as error:
        yield Patch("gps", 0, b"", "unreadable", f"the file cannot be looked into: {error.what}")
        return
    for key, value in tags.items():
        for kind, part, why in told_by_tag(key, value, names):
            yield Patch(kind, 0, b"", part, why)


class _File(io.RawIOBase):
    """One file of a stream, to read and seek in."""

    def __init__(self, read: ReadAt, size: int) -> None:
        self._read, self._size, self._at = read, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        self._at = max(0, base + offset)
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        data = self._read(self._at, len(buffer)) if self._at < self._size else b""
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)
