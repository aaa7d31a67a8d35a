"""Where the bytes of an episode are: a folder, or one stored zip. Reading never writes.

All stores, here or behind a URL (`exumi_data.store.remote`), offer the same calls. Every local read
is a ``pread`` at a known offset, so that a packed episode reads as fast as a folder, and one object
can be shared by threads and forked processes.
"""

import errno
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol
from weakref import WeakValueDictionary

from exumi_data.errors import (
    ChangedDataError,
    DamagedDataError,
    ExumiError,
    LimitError,
    NotAnEpisodeError,
)
from exumi_data.store.paths import check_member_path
from exumi_data.store.remote.address import is_url
from exumi_data.store.zip_directory import (
    LOCAL_HEADER_BYTES,
    LOCAL_MAGIC,
    BoundedFile,
    data_start,
    read_members,
)

if TYPE_CHECKING:
    from exumi_data.store.remote.reading import Identity

__all__ = ["FolderStore", "OpenFiles", "Store", "ZipStore", "open_store", "open_stores"]

_MAX_WHOLE_FILE = 64 << 20
_DEEPEST = 32
_ROOT_DOCUMENT = "zarr.json"
_TOGETHER = 32
_MOST_OWN = 128  # files that are open, of all stores that do not share theirs
_TOO_MANY = (errno.EMFILE, errno.ENFILE)


class Store(Protocol):
    """Read access to the files of one episode."""

    location: str
    """The path, for messages; of a URL without its secrets."""

    @property
    def source(self) -> str:
        """What opens the same store again: the path, or the URL with its secrets."""
        ...

    @property
    def is_packed(self) -> bool:
        """Whether it is one file."""
        ...

    @property
    def identity(self) -> "Identity | None":
        """Of a remote packed episode, which object it is, once that is known."""
        ...

    def read(self, path: str) -> bytes:
        """Return a whole small file. Raises `FileNotFoundError`; `LimitError` above 64 MiB."""
        ...

    def read_range(self, path: str, start: int, length: int) -> bytes:
        """Return exactly `length` bytes from `start`. Raises `DamagedDataError` if cut short."""
        ...

    def size(self, path: str) -> int:
        """Return a file's size in bytes. Raises `FileNotFoundError`."""
        ...

    def paths(self) -> list[str]:
        """List all files, sorted."""
        ...

    def close(self) -> None:
        """Close open files. Reading again opens them again."""
        ...


def _read_exactly(descriptor: int, start: int, length: int, where: str) -> bytes:
    data = _read_some(descriptor, length, start, where)
    if len(data) == length:
        return data
    parts = [data]
    got = len(data)
    while got < length:
        data = _read_some(descriptor, length - got, start + got, where)
        if not data:
            raise DamagedDataError(
                f"file is cut short: {length} bytes at {start} asked for, {got} there",
                where=where,
                fix="Copy the episode again from its source.",
            )
        parts.append(data)
        got += len(data)
    return b"".join(parts)


def _read_some(descriptor: int, length: int, start: int, where: str) -> bytes:
    try:
        return os.pread(descriptor, length, start)
    except OSError as error:
        raise _unreadable(where, error) from error


def _read_small(descriptor: int, start: int, length: int, where: str) -> bytes:
    if length > _MAX_WHOLE_FILE:
        raise LimitError(f"a metadata file of {length:,} bytes", where=where)
    return _read_exactly(descriptor, start, length, where)


def _unreadable(where: str, error: OSError) -> ExumiError:
    if error.errno in _TOO_MANY:
        return LimitError(
            "cannot be opened: too many files are open",
            where=where,
            fix="Close what is not needed any more, or allow more: ulimit -n 4096",
        )
    return DamagedDataError(f"cannot be read ({error.strerror})", where=where)


_Identity = tuple[int, int, int, int]


def _identity(info: os.stat_result) -> _Identity:
    """Return what tells a file from one that took its name."""
    return info.st_dev, info.st_ino, info.st_size, info.st_mtime_ns


def _changed(where: str) -> ChangedDataError:
    return ChangedDataError(
        "changed after its episode was opened",
        where=where,
        fix="Open the dataset again; while it is read, nothing may write to it.",
    )


class _OpenFile:
    """An open descriptor; closed when its last user drops it."""

    __slots__ = ("descriptor", "identity", "size")

    def __init__(self, path: str) -> None:
        # A link could lead anywhere, also out of the store.
        # Opening a pipe would wait for ever for its writer.
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        self.descriptor = os.open(path, flags)
        info = os.fstat(self.descriptor)
        self.size = info.st_size
        self.identity = _identity(info)
        if not stat.S_ISREG(info.st_mode):
            raise FileNotFoundError(path)

    def __del__(self) -> None:
        # Not clean-up of convenience: a reader in another thread may still hold this object
        # when the cache drops it, and a descriptor closed under it could name another file.
        if hasattr(self, "descriptor"):
            os.close(self.descriptor)


class OpenFiles:
    """A bounded set of open files, the least recently used closed first.

    Stores can share one, so that a dataset of any size keeps few descriptors open.

    Parameters
    ----------
    limit : int
        How many files stay open.
    """

    def __init__(self, limit: int = 8) -> None:
        self._limit = limit
        self._files: dict[str, _OpenFile] = {}

    def get(self, path: str) -> _OpenFile:
        """Open a file, or return it if it is open. Raises `OSError`."""
        # Threads may come between any two lines: a file is then opened twice, and nothing worse.
        found = self._files.pop(path, None) or self.open(path)
        self._files[path] = found
        if len(self._files) > self._limit:
            with suppress(StopIteration, RuntimeError):
                self._files.pop(next(iter(self._files)), None)
        return found

    def open(self, path: str) -> _OpenFile:
        """Open a file, which is not kept. Raises `OSError`."""
        return _OpenFile(path)

    def clear(self) -> None:
        """Close all files that nobody is reading."""
        self._files.clear()


class _OwnFiles(OpenFiles):
    """The open files of one store, which thousands of others may be kept beside.

    All such sets together hold few: those that opened nothing for longest are cleared.
    """

    # A descriptor is the process's, and so is what bounds their number.
    _sets: ClassVar["WeakValueDictionary[int, _OwnFiles]"] = WeakValueDictionary()

    def open(self, path: str) -> _OpenFile:
        """Open a file, which is not kept; where there are too many, others are closed."""
        self._sets.pop(id(self), None)
        self._sets[id(self)] = self
        self._make_room(_MOST_OWN - 1)
        try:
            return _OpenFile(path)
        except OSError as error:
            if error.errno not in _TOO_MANY:
                raise
            self._make_room(0)  # others took the rest: with none of ours it may do
            return _OpenFile(path)

    def _make_room(self, most: int) -> None:
        there = list(self._sets.values())
        held = sum(len(one._files) for one in there)
        for one in there:
            if held <= most:
                return
            held -= len(one._files)
            one.clear()


class FolderStore:
    """An episode that is a folder.

    Parameters
    ----------
    path : path-like
    files : OpenFiles, optional
        Shared with other stores; default one of its own.
    """

    def __init__(self, path: str | os.PathLike[str], files: OpenFiles | None = None) -> None:
        self.root = Path(path)
        self.location = str(path)
        self._files = files or _OwnFiles()
        self._folders: set[str] = {""}
        # What is read piece by piece has to stay the same file, however often it is opened.
        self._known: dict[str, tuple[str, _Identity]] = {}
        self._root: _Identity | None = None

    @property
    def source(self) -> str:
        """The path."""
        return self.location

    @property
    def is_packed(self) -> bool:
        """Whether it is one file."""
        return False

    @property
    def identity(self) -> None:
        """None: local files are told apart by what the file system says."""
        return

    def _check(self, path: str) -> None:
        """Refuse unsafe paths and folders that are links. Each folder is asked once."""
        check_member_path(path, self.location)
        folder = path.rpartition("/")[0]
        if folder in self._folders:
            return
        parts = folder.split("/")
        for depth in range(1, len(parts) + 1):
            part = "/".join(parts[:depth])
            if part in self._folders:
                continue
            self._stat(part)
            self._folders.add(part)

    def _stat(self, path: str) -> os.stat_result:
        try:
            info = os.lstat(f"{self.location}/{path}")
        except (FileNotFoundError, NotADirectoryError):
            raise FileNotFoundError(path) from None
        except OSError as error:
            raise _unreadable(f"{self.location}/{path}", error) from error
        if stat.S_ISLNK(info.st_mode):
            raise _link_error(path, self.location)
        return info

    def _file(self, path: str) -> _OpenFile:
        self._check(path)
        return self._opened(path, self._files.get)

    def _opened(
        self, path: str, opener: Callable[[str], _OpenFile], name: str | None = None
    ) -> _OpenFile:
        try:
            return opener(name or f"{self.location}/{path}")
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            raise FileNotFoundError(path) from None
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise _link_error(path, self.location) from None
            raise _unreadable(f"{self.location}/{path}", error) from error

    def read(self, path: str) -> bytes:
        """Return a whole file."""
        self._check(path)
        # Whole reads are of small files that are read once: their descriptor is not kept.
        file = self._opened(path, self._files.open)
        if path == _ROOT_DOCUMENT and self._root is None:
            self._root = file.identity
        return _read_small(file.descriptor, 0, file.size, f"{self.location}/{path}")

    def read_range(self, path: str, start: int, length: int) -> bytes:
        """Return exactly `length` bytes from `start`."""
        known = self._known.get(path)
        if known is None:
            file = self._file(path)
            where = f"{self.location}/{path}"
            self._check_root(where)
            self._known[path] = where, file.identity
        else:  # checked before: frames are read by the hundred from one file
            where, identity = known
            try:
                file = self._opened(path, self._files.get, where)
            except FileNotFoundError:
                raise _changed(where) from None
            if file.identity != identity:
                raise _changed(where)
        return _read_exactly(file.descriptor, start, length, where)

    def _check_root(self, where: str) -> None:
        """Refuse a file of an episode that took the place of this one: it has another root."""
        if self._root is None:
            return
        try:
            now = _identity(os.lstat(f"{self.location}/{_ROOT_DOCUMENT}"))
        except OSError:
            raise _changed(where) from None
        if now != self._root:
            raise _changed(where)

    def size(self, path: str) -> int:
        """Return a file's size in bytes."""
        self._check(path)
        info = self._stat(path)
        if not stat.S_ISREG(info.st_mode):
            raise FileNotFoundError(path)
        return info.st_size

    def paths(self) -> list[str]:
        """List all files, sorted by path."""
        try:
            return sorted(_walk(self.location, ""))
        except OSError as error:
            raise _unreadable(self.location, error) from error

    def close(self) -> None:
        """Close open files."""
        self._files.clear()

    def __getstate__(self) -> dict[str, object]:
        return {"location": self.location}

    def __setstate__(self, state: dict[str, str]) -> None:
        self.__init__(state["location"])  # type: ignore[misc]  # descriptors do not cross processes


def _link_error(path: str, where: str) -> DamagedDataError:
    return DamagedDataError(f"{path} is a link; links are not followed", where=where)


def _walk(root: str, prefix: str, depth: int = 0) -> Iterator[str]:
    if depth > _DEEPEST:
        raise DamagedDataError("folders are nested too deeply", where=f"{root}/{prefix}")
    with os.scandir(f"{root}/{prefix}" if prefix else root) as entries:
        for entry in entries:
            path = f"{prefix}/{entry.name}" if prefix else entry.name
            check_member_path(path, root)
            if entry.is_symlink():
                raise _link_error(path, root)
            if entry.is_dir():
                yield from _walk(root, path, depth + 1)
            elif entry.is_file():
                yield path
            else:
                raise DamagedDataError(f"{path} is neither a file nor a folder", where=root)


class ZipStore:
    """An episode that is one stored (uncompressed) zip.

    Parameters
    ----------
    path : path-like
    files : OpenFiles, optional
        Shared with other stores; default one of its own.
    """

    def __init__(self, path: str | os.PathLike[str], files: OpenFiles | None = None) -> None:
        self.location = str(path)
        # A packed episode itself may be reached through a link; only links inside are refused.
        self._real = os.path.realpath(path)
        self._files = files or _OwnFiles(1)
        opened = self._files.get(self._real)
        self._file_size, self._identity = opened.size, opened.identity
        self._members = self._read_directory()
        self._starts: dict[str, int] = {}

    @property
    def source(self) -> str:
        """The path."""
        return self.location

    @property
    def is_packed(self) -> bool:
        """Whether it is one file."""
        return True

    @property
    def identity(self) -> None:
        """None: local files are told apart by what the file system says."""
        return

    def _read_directory(self) -> dict[str, tuple[int, int]]:
        try:
            with BoundedFile(self._real) as file:
                return read_members(file, self._file_size, self.location)
        except OSError as error:
            raise _unreadable(self.location, error) from error

    def _locate(self, path: str) -> tuple[int, int]:
        try:
            header, size = self._members[path]
        except KeyError:
            raise FileNotFoundError(path) from None
        start = self._starts.get(path)
        if start is None:
            name = path.encode()
            raw = self._read_at(header, LOCAL_HEADER_BYTES + len(name), self.location)
            end = self._file_size - size
            start = self._starts[path] = data_start(raw, header, path, end, self.location)
        return start, size

    def _read_at(self, start: int, length: int, where: str) -> bytes:
        return _read_exactly(self._descriptor(where), start, length, where)

    def _descriptor(self, where: str) -> int:
        file = self._files.get(self._real)
        if file.identity != self._identity:
            raise _changed(where)
        return file.descriptor

    def read(self, path: str) -> bytes:
        """Return a whole member."""
        start, size = self._locate(path)
        where = f"{self.location}!{path}"
        return _read_small(self._descriptor(where), start, size, where)

    def read_range(self, path: str, start: int, length: int) -> bytes:
        """Return exactly `length` bytes from `start`."""
        member_start, size = self._locate(path)
        if start + length > size:
            raise DamagedDataError(
                f"{length} bytes at {start} asked for, the member has {size}",
                where=f"{self.location}!{path}",
            )
        return self._read_at(member_start + start, length, f"{self.location}!{path}")

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
        """Close the file; reading again opens it again."""
        self._files.clear()

    def __getstate__(self) -> dict[str, object]:
        return {"location": self.location}

    def __setstate__(self, state: dict[str, str]) -> None:
        self.__init__(state["location"])  # type: ignore[misc]  # descriptors do not cross processes


def open_store(path: str | os.PathLike[str], files: OpenFiles | None = None) -> Store:
    """Open a folder or a zip for reading, here or behind a URL.

    Parameters
    ----------
    path : path-like
        Or a URL.
    files : OpenFiles, optional
        Share open files with other stores.

    Raises
    ------
    NotAnEpisodeError
        Nothing is there.
    DamagedDataError
        The zip is not a stored zip, is cut short, or holds unsafe names.
    UnreachableError
        The server of a URL does not answer, does not let us in, or cannot do what it has to.
    """
    if is_url(path):
        from exumi_data.store.remote.stores import open_remote  # nobody else needs it

        return open_remote(os.fsdecode(path))
    target = Path(path)
    try:
        if target.is_dir():
            return FolderStore(target, files)
        if target.is_file():
            return _open_zip(target, files)
    except OSError as error:
        raise _unreadable(str(path), error) from error
    raise NotAnEpisodeError("no such file or folder", where=path)


def open_stores(
    paths: Sequence[str], known: "Mapping[str, Identity] | None" = None
) -> Iterator[Store]:
    """Open folders and zips one after the other; those behind URLs many at a time.

    Parameters
    ----------
    paths : sequence of str
        Or URLs.
    known : mapping of str to Identity, optional
        Of packed episodes behind URLs which objects they have to be.

    Yields
    ------
    Store

    Raises
    ------
    ExumiError
        As `open_store` does, or whatever is first read of a remote one.
    """
    for start in range(0, len(paths), _TOGETHER):
        group = paths[start : start + _TOGETHER]
        if not any(is_url(path) for path in group):
            yield from map(open_store, group)
            continue
        from exumi_data.store.remote.stores import open_remotes  # nobody else needs it

        yield from open_remotes(group, known or {})


def _open_zip(path: Path, files: OpenFiles | None) -> ZipStore:
    with path.open("rb") as file:
        beginning = file.read(4)
    if beginning != LOCAL_MAGIC:
        raise NotAnEpisodeError(
            "neither an episode's folder nor a packed episode",
            where=path,
            fix="Give the folder of a dataset or an episode, or a .zarr.zip. "
            "Convert other data with: exumi convert SRC DST",
        )
    return ZipStore(path, files)
