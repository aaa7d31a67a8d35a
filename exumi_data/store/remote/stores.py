"""Remote episodes as stores: packed in one object, or a folder of objects. Reading never writes."""

import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import pairwise

from exumi_data.errors import DamagedDataError, LimitError, NotAnEpisodeError, UnreachableError
from exumi_data.lazy import unlocked
from exumi_data.store.paths import check_member_path
from exumi_data.store.remote.address import Address
from exumi_data.store.remote.reading import Identity, RemoteFile, Span, reader
from exumi_data.store.remote.requests import Answer, Request
from exumi_data.store.zip_directory import (
    LOCAL_HEADER_BYTES,
    MAX_DIRECTORY,
    data_start,
    read_members,
)

__all__ = [
    "MAX_WHOLE_FILE",
    "RemoteFolderStore",
    "RemoteZipStore",
    "open_remote",
    "open_remotes",
    "read_document",
]

MAX_WHOLE_FILE = 64 << 20
_TAIL_BYTES = 64 << 10  # of a first request: most directories, and what lies before them
_END_BYTES = 16 << 10
_LARGE = 4 << 20
_INDEX_ROOM = 1 << 10
_BYTES_PER_INDEX_BYTE = 4096  # 16 bytes for a chunk of 64 KiB
_CHUNK = re.compile(r"(?P<array>.+)/c/\d+(?P<rest>(/0)*)")
_FRAME_AXES = 4


@unlocked
class RemoteZipStore:
    """A remote episode that is one stored zip. Its directory is read when it is first needed.

    Parameters
    ----------
    url : str
    identity : Identity, optional
        Which object it has to be; default: the one that is there.
    """

    is_packed = True

    def __init__(self, url: str, identity: Identity | None = None) -> None:
        address = Address.parse(url)
        self.source = url
        self.location = address.shown
        self.file = RemoteFile(address, identity)
        self._starts: dict[str, int] = {}

    @property
    def identity(self) -> Identity | None:
        """Which object it is, once that is known."""
        return self.file.identity if self.file.is_known else None

    def tail(self) -> Request:
        """Return the request for its end, where the directory is."""
        return Request("tail", self.file.address, 0, _TAIL_BYTES)

    def learn(self, answer: Answer) -> None:
        """Take the answer to `tail`. Raises `ChangedDataError`."""
        self.file.identify(Identity(answer.size, answer.tag))
        reader().remember(self.file, answer.size - len(answer.data), answer.data)

    @cached_property
    def _members(self) -> dict[str, tuple[int, int]]:
        if not self.file.is_known:
            try:
                self.learn(reader().one(self.tail()))
            except FileNotFoundError:
                raise _nothing(self.location) from None
        size = self.file.identity.size
        return read_members(_Seekable(self.file), size, self.location)  # type: ignore[arg-type]  # a RawIOBase reads bytes

    @cached_property
    def _following(self) -> dict[int, int]:
        """Where the next member begins, by where one does."""
        headers = sorted(header for header, _ in self._members.values())
        return dict(pairwise(headers))

    def _locate(self, path: str) -> tuple[int, int]:
        try:
            header, size = self._members[path]
        except KeyError:
            raise FileNotFoundError(path) from None
        start = self._starts.get(path)
        if start is None:
            room = LOCAL_HEADER_BYTES + len(path.encode())
            start = self._following.get(header, 0) - size
            # Where the header has just the room that it needs without an extra field, it has none,
            # and need not be fetched.
            if start != header + room:
                end = self.file.identity.size - size
                raw = self._read_at(header, room, path)
                start = data_start(raw, header, path, end, self.location)
            self._starts[path] = start
        return start, size

    def _read_at(self, start: int, length: int, path: str) -> bytes:
        if start + length > self.file.identity.size:
            raise DamagedDataError("lies beyond the end of the file", where=self._where(path))
        return self.file.read(start, length)

    def _where(self, path: str) -> str:
        return f"{self.location}!{path}"

    def read(self, path: str) -> bytes:
        """Return a whole member."""
        start, size = self._locate(path)
        if size > MAX_WHOLE_FILE:
            raise LimitError(f"a metadata file of {size:,} bytes", where=self._where(path))
        return self._read_at(start, size, path) if size else b""

    def read_range(self, path: str, start: int, length: int) -> bytes:
        """Return exactly `length` bytes from `start`."""
        member, size = self._locate(path)
        if start + length > size:
            raise DamagedDataError(
                f"{length} bytes at {start} asked for, the member has {size}",
                where=self._where(path),
            )
        return self._read_at(member + start, length, path) if length else b""

    def size(self, path: str) -> int:
        """Return a member's size in bytes."""
        try:
            return self._members[path][1]
        except KeyError:
            raise FileNotFoundError(path) from None

    def paths(self) -> list[str]:
        """List all members, sorted by path."""
        return sorted(self._members)

    def close(self) -> None:
        """Do nothing: connections are shared."""

    def span(self, path: str, start: int, length: int) -> Span:
        """Return where some bytes of a member are."""
        member, size = self._locate(path)
        stop = min(start + length, size)
        return Span(self.file, member + start, member + stop)

    def head(self) -> list[Span]:
        """Return where all is but the frames, of which there is the index of their shards."""
        spans = []
        end = self.file.identity.size
        for path, (header, size) in self._members.items():
            stop = min(self._following.get(header, end), end)
            start = header
            if _is_bulk(path, size, self._members):
                start = max(header, stop - _index_room(size))
            spans.append(Span(self.file, start, stop))
        return spans

    def __getstate__(self) -> dict[str, object]:
        return {"source": self.source, "identity": self.identity}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__init__(state["source"], state["identity"])  # type: ignore[misc]  # as __getstate__ wrote


@unlocked
class RemoteFolderStore:
    """A remote episode that is a folder: an object for each file.

    Parameters
    ----------
    url : str
    """

    is_packed = False
    identity = None

    def __init__(self, url: str) -> None:
        self._address = Address.parse(url)
        self.source = url
        self.location = self._address.shown
        self._files: dict[str, RemoteFile] = {}
        self._can_list = self._address.scheme not in ("http", "https")

    @cached_property
    def _listed(self) -> dict[str, RemoteFile]:
        answer = reader().one(Request("list", self._address))
        prefix = f"{self._address.key}/"
        found = {}
        listed = json.loads(answer.data)
        folders = {key[:end] for key, _, _ in listed for end in _slashes(key)}
        for key, size, tag in listed:
            # Consoles put an empty object where they show a folder: "<key>/", listed as "<key>".
            if not size and (key in folders or not key.startswith(prefix)):
                continue
            path = check_member_path(key.removeprefix(prefix), self.location)
            found[path] = RemoteFile(self._address.below(path), Identity(size, tag))
        return found

    def _file(self, path: str) -> RemoteFile:
        if self._can_list:
            try:
                return self._listed[path]
            except KeyError:
                raise FileNotFoundError(path) from None
        found = self._files.get(path)
        if found is None:
            address = self._address.below(check_member_path(path, self.location))
            found = self._files[path] = RemoteFile(address)
        return found

    def read(self, path: str) -> bytes:
        """Return a whole file."""
        file = self._file(path)
        where = file.address.shown
        if not file.is_known:
            answer = reader().one(Request("whole", file.address, 0, MAX_WHOLE_FILE))
            file.identify(Identity(answer.size, answer.tag))
            reader().remember(file, 0, answer.data)
            return answer.data
        size = file.identity.size
        if size > MAX_WHOLE_FILE:
            raise LimitError(f"a metadata file of {size:,} bytes", where=where)
        return file.read(0, size) if size else b""

    def read_range(self, path: str, start: int, length: int) -> bytes:
        """Return exactly `length` bytes from `start`."""
        file = self._file(path)
        size = file.identity.size
        if start + length > size:
            raise DamagedDataError(
                f"file is cut short: {length} bytes at {start} asked for, it has {size}",
                where=file.address.shown,
            )
        return file.read(start, length) if length else b""

    def size(self, path: str) -> int:
        """Return a file's size in bytes."""
        return self._file(path).identity.size

    def paths(self) -> list[str]:
        """List all files, sorted by path. Raises `UnreachableError` of a web server."""
        return sorted(self._listed)

    def close(self) -> None:
        """Do nothing: connections are shared."""

    def span(self, path: str, start: int, length: int) -> Span:
        """Return where some bytes of a file are."""
        file = self._file(path)
        return Span(file, start, min(start + length, file.identity.size))

    def head(self) -> list[Span]:
        """Return where all is but the frames; of a web server nothing is known beforehand."""
        if not self._can_list:
            return []
        sizes = {path: (0, file.identity.size) for path, file in self._listed.items()}
        spans = []
        for path, file in self._listed.items():
            size = file.identity.size
            start = max(0, size - _index_room(size)) if _is_bulk(path, size, sizes) else 0
            spans.append(Span(file, start, size))
        return spans

    def __getstate__(self) -> dict[str, object]:
        return {"source": self.source}

    def __setstate__(self, state: dict[str, str]) -> None:
        self.__init__(state["source"])  # type: ignore[misc]  # as __getstate__ wrote


class _Seekable(io.RawIOBase):
    """A remote file as `zipfile` reads directories; never gives more than one."""

    def __init__(self, file: RemoteFile) -> None:
        self._file = file
        self._size = file.identity.size
        self._at = 0

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        if base + offset < 0:
            msg = "before the beginning"
            raise OSError(msg)
        self._at = base + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, size: int | None = -1) -> bytes:
        rest = max(0, self._size - self._at)
        length = rest if size is None or size < 0 else min(size, rest)
        if length > MAX_DIRECTORY:
            msg = f"a directory of {length:,} bytes"
            raise ValueError(msg)
        data = self._file.read(self._at, length) if length else b""
        self._at += len(data)
        return data


def _slashes(key: str) -> Iterator[int]:
    return (place for place, letter in enumerate(key) if letter == "/")


def _is_bulk(path: str, size: int, members: Mapping[str, tuple[int, int]]) -> bool:
    """Whether a file holds frames or sound, or is so large that it is read when it is needed."""
    found = _CHUNK.fullmatch(path)
    if found is None or size <= _INDEX_ROOM:
        return False
    array = found["array"]
    stream, _, name = array.rpartition("/")
    is_data = name == "data" and stream.startswith("streams/")
    has_frames = f"{stream}/offset/zarr.json" in members
    is_frames = found["rest"].count("/") + 1 >= _FRAME_AXES
    return size > _LARGE or (is_data and (has_frames or is_frames))


def _index_room(size: int) -> int:
    """Return how much of a shard's end surely holds its index, if its chunks are not tiny."""
    return _INDEX_ROOM + size // _BYTES_PER_INDEX_BYTE


def open_remote(url: str, identity: Identity | None = None) -> RemoteZipStore | RemoteFolderStore:
    """Open a remote episode: a packed one by its name, which ends in ``.zip``.

    Parameters
    ----------
    url : str
    identity : Identity, optional
        Which object a packed one has to be.

    Raises
    ------
    NotAnEpisodeError
        There is no such object.
    DamagedDataError
        It is no stored zip, or holds unsafe names.
    UnreachableError
        The server does not answer, does not let us in, or cannot do what it has to.
    """
    if not Address.parse(url).key.endswith(".zip"):
        return RemoteFolderStore(url)
    store = RemoteZipStore(url, identity)
    store.paths()  # what is no zip is said at once
    return store


def open_remotes(
    urls: Sequence[str], known: Mapping[str, Identity]
) -> list[RemoteZipStore | RemoteFolderStore]:
    """Open remote episodes together, with what their metadata and streams need of them.

    What is wrong with one of them is said when it is read.

    Parameters
    ----------
    urls : sequence of str
    known : mapping of str to Identity
        Which objects the packed ones have to be, as far as that is known.

    Raises
    ------
    UnreachableError
        The server does not answer, does not let us in, or cannot do what it has to.
    """
    stores: list[RemoteZipStore | RemoteFolderStore] = []
    for url in urls:
        is_packed = Address.parse(url).key.endswith(".zip")
        stores.append(RemoteZipStore(url, known.get(url)) if is_packed else RemoteFolderStore(url))
    packed = [store for store in stores if isinstance(store, RemoteZipStore)]
    new = [store for store in packed if not store.file.is_known]
    for store, outcome in zip(new, reader().fetcher.fetch([s.tail() for s in new]), strict=True):
        if isinstance(outcome, Answer):
            with suppress(LimitError):  # said when read
                store.learn(outcome)
        elif isinstance(outcome, UnreachableError):
            raise outcome
    told = {store: store.file.identity.size for store in packed if store not in new}
    reader().prefetch(
        Span(store.file, max(0, size - _END_BYTES), size) for store, size in told.items()
    )
    spans: list[Span] = []
    for opened in stores:
        # Said when it is read:
        with suppress(DamagedDataError, LimitError, NotAnEpisodeError, FileNotFoundError):
            spans += opened.head()
    reader().prefetch(spans, keep=True)
    return stores


def read_document(url: str, limit: int) -> bytes:
    """Return a small remote file, as it is now.

    Parameters
    ----------
    url : str
    limit : int
        Most bytes that it may have.

    Raises
    ------
    FileNotFoundError
        There is none.
    LimitError
        It is larger.
    UnreachableError
        The server does not answer or does not let us in.
    """
    return reader().one(Request("whole", Address.parse(url), 0, limit)).data


def _nothing(where: str) -> NotAnEpisodeError:
    return NotAnEpisodeError("there is nothing of that name", where=where)
