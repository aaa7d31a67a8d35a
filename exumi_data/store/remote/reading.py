"""Reading remote objects by blocks: from memory, from the local disk, or from the server.

Blocks that are missing are fetched in few long requests, many at a time.
"""

import os
import secrets
import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from exumi_data.errors import ChangedDataError, LimitError, UnreachableError, UsageError
from exumi_data.store.remote.address import Address
from exumi_data.store.remote.disk_cache import BLOCK_BYTES, DiskCache
from exumi_data.store.remote.fetching import Fetcher, Outcome
from exumi_data.store.remote.requests import Answer, Request
from exumi_data.store.remote.threads import DaemonThreads

__all__ = [
    "Identity",
    "Reader",
    "RemoteFile",
    "Span",
    "bytes_of",
    "memory_bytes",
    "reader",
]

_DEFAULT_CACHE_BYTES = 4 << 30
_MEMORY = 4 << 20, 64 << 20  # at least, at most
_MEMORY_SHARE = 8  # of what the disk may keep
_GAP_BLOCKS = (256 << 10) // BLOCK_BYTES  # what one request more would cost, in bytes
_MOST_BLOCKS = (4 << 20) // BLOCK_BYTES  # of a request: longer ones are sent in parts, in parallel
_AHEAD_BLOCKS = (1 << 20) // BLOCK_BYTES
_LARGEST = 256 << 30  # of an object: what is noted of its blocks goes by its size
_MOST_TOGETHER = (
    256 << 20
) // BLOCK_BYTES  # that are prefetched, however large objects claim to be


class Identity(NamedTuple):
    """What tells an object from one that took its name.

    Attributes
    ----------
    size : int
    tag : str
        Empty where the server sends neither an ETag nor when the object was last modified.
    """

    size: int
    tag: str


class RemoteFile:
    """One object of a server. It has to stay the one that it was when it was first asked for.

    Parameters
    ----------
    address : Address
    identity : Identity, optional
        Known already; default: asked for when it is needed.
    """

    __slots__ = ("_ahead", "_expected", "_identity", "_key", "address")

    def __init__(self, address: Address, identity: Identity | None = None) -> None:
        self.address = address
        self._identity: Identity | None = None
        self._key = ""
        self._expected = -1
        self._ahead = 0
        if identity is not None:
            self.identify(identity)

    def identify(self, identity: Identity) -> None:
        """Learn which object it is.

        Raises
        ------
        ChangedDataError
            It was another one before.
        LimitError
            It has more than 256 GiB.
        """
        if self._identity is None:
            if identity.size > _LARGEST:
                raise LimitError(
                    f"has {identity.size:,} bytes, it says; at most {_LARGEST:,} are read",
                    where=self.address.shown,
                )
            name = f"{self.address.root}/{self.address.key}\n{identity.size}\n{identity.tag}"
            # What cannot be told from another object is nothing that others may take for theirs.
            name += "" if identity.tag else secrets.token_hex()
            # Last what other threads look at.
            self._key = sha256(name.encode()).hexdigest()[:40]
            self._identity = identity
        elif self._identity != identity:
            raise ChangedDataError(
                "changed after it was opened",
                where=self.address.shown,
                fix="Open the dataset again; while it is read, nothing may write to it.",
            )

    @property
    def is_known(self) -> bool:
        """Whether the server was asked, or somebody else told."""
        return self._identity is not None

    @property
    def is_kept(self) -> bool:
        """Whether its blocks may be kept on the disk: they can be told from another object's."""
        return bool(self.identity.tag)

    @property
    def identity(self) -> Identity:
        """Which object it is. Raises `FileNotFoundError`; `UnreachableError`."""
        if self._identity is None:
            self.identify(_identity(reader().one(Request("head", self.address))))
        assert self._identity is not None  # noqa: S101  # identified above
        return self._identity

    @property
    def key(self) -> str:
        """Name of the object and its content, in the caches."""
        return self._key

    def read(self, start: int, length: int) -> bytes:
        """Return bytes; `start` and `length` have to lie in the object."""
        size = self.identity.size
        first, stop = start // BLOCK_BYTES, -(-(start + length) // BLOCK_BYTES)
        if stop - first > _MOST_BLOCKS:
            return reader().long(self, start, length)
        if not self._expected - 1 <= first <= self._expected:
            self._ahead = 0
        elif stop > self._expected:  # whoever reads on is likely to go on
            self._ahead = min(max(4, 2 * self._ahead), _AHEAD_BLOCKS)
        ahead = min(stop + self._ahead, -(-size // BLOCK_BYTES))
        self._expected = stop
        blocks = reader().blocks(self, first, stop, ahead)
        if stop - first == 1:
            return blocks[first][start - first * BLOCK_BYTES :][:length]
        data = b"".join(blocks[number] for number in range(first, stop))
        offset = start - first * BLOCK_BYTES
        return data[offset : offset + length]


class Span(NamedTuple):
    """Bytes of an object, from `start` to before `stop`."""

    file: RemoteFile
    start: int
    stop: int


class _Run(NamedTuple):
    """Blocks of an object, from `first` to before `stop`."""

    file: RemoteFile
    first: int
    stop: int

    def request(self) -> Request:
        start = self.first * BLOCK_BYTES
        length = min(self.stop * BLOCK_BYTES, self.file.identity.size) - start
        return Request("range", self.file.address, start, length)


class Reader:
    """Reads blocks of objects. One for each process: its threads and connections are shared.

    Parameters
    ----------
    folder : pathlib.Path
        Of the cache on the disk.
    cache_bytes : int
        Most bytes there; of memory each process takes an eighth of it, from 4 to 64 MiB.

    Attributes
    ----------
    fetcher : Fetcher
    memory_bytes : int
    """

    def __init__(self, folder: Path, cache_bytes: int) -> None:
        self.fetcher = Fetcher()
        self.memory_bytes = memory_bytes(cache_bytes)
        self._disk = DiskCache(folder, cache_bytes)
        self._memory: OrderedDict[tuple[str, int], bytes] = OrderedDict()
        self._lock = threading.Lock()
        self._later: DaemonThreads | None = None

    def one(self, request: Request) -> Answer:
        """Send one request. Raises what `perform` does."""
        (outcome,) = self.fetcher.fetch([request])
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def prefetch(self, spans: Iterable[Span], *, keep: bool = False) -> list[Exception]:
        """Fetch what is not at hand of some bytes, all at once, so that reading them is quick.

        Parameters
        ----------
        spans : iterable of Span
            Of files that are known; no more than half of `memory_bytes` stays at hand for sure, and
            what is beyond 256 MiB is left out.
        keep : bool
            Keep on the disk also what is in memory only.

        Returns
        -------
        list of Exception
            What went wrong; reading these bytes raises it as well.
        """
        runs: list[_Run] = []
        for file, wanted in _wanted(spans):
            there = self._at_hand(file, wanted)
            if keep and file.is_kept:
                self._disk.write(file.key, there)
            runs += _runs(file, [number for number in wanted if number not in there])
        return [found for found in self._fetch(runs) if isinstance(found, Exception)]

    def prefetch_later(self, spans: Iterable[Span]) -> Future[list[Exception]]:
        """Begin to `prefetch`, and go on meanwhile."""
        if self._later is None:
            self._later = DaemonThreads(1, "exumi-ahead")
        return self._later.submit(self.prefetch, list(spans))

    def blocks(self, file: RemoteFile, first: int, stop: int, ahead: int) -> Mapping[int, bytes]:
        """Return blocks; where one is missing, those up to `ahead` are fetched with it."""
        found = self._at_hand(file, range(first, stop))
        missing = [number for number in range(first, stop) if number not in found]
        if not missing:
            return found
        last = max(missing[-1] + 1, ahead)
        for outcome in self._fetch([_Run(file, missing[0], last)]):
            if isinstance(outcome, Exception):
                raise _told(outcome, file)
            found |= outcome
        return found

    def long(self, file: RemoteFile, start: int, length: int) -> bytes:
        """Return many bytes, fetched in parallel and not kept."""
        step = _MOST_BLOCKS * BLOCK_BYTES
        stop = start + length
        asked = [
            Request("range", file.address, at, min(step, stop - at))
            for at in range(start, stop, step)
        ]
        parts = []
        for request, outcome in zip(asked, self.fetcher.fetch(asked), strict=True):
            checked = _checked(file, request, outcome)
            if isinstance(checked, Exception):
                raise _told(checked, file)
            parts.append(checked)
        return b"".join(parts)

    def remember(self, file: RemoteFile, start: int, data: bytes) -> None:
        """Hold bytes in memory that were read otherwise: the blocks that are whole among them.

        Parameters
        ----------
        file : RemoteFile
            That is known.
        start : int
            Where in the file they begin.
        data : bytes
        """
        size, end = file.identity.size, start + len(data)
        first = -(-start // BLOCK_BYTES)
        stop = -(-end // BLOCK_BYTES) if end == size else end // BLOCK_BYTES
        blocks = {
            number: data[number * BLOCK_BYTES - start : (number + 1) * BLOCK_BYTES - start]
            for number in range(first, stop)
        }
        self._remember(file, blocks)

    def _at_hand(self, file: RemoteFile, numbers: Sequence[int]) -> dict[int, bytes]:
        """Return those blocks that are in memory or on the disk."""
        found: dict[int, bytes] = {}
        with self._lock:
            for number in numbers:
                block = self._memory.get((file.key, number))
                if block is not None:
                    self._memory.move_to_end((file.key, number))
                    found[number] = block
        missing = [number for number in numbers if number not in found]
        if missing and file.is_kept:
            read = self._disk.read(file.key, missing)
            self._remember(file, read)
            found |= read
        return found

    def _remember(self, file: RemoteFile, blocks: Mapping[int, bytes]) -> None:
        most = self.memory_bytes // BLOCK_BYTES
        with self._lock:
            for number, block in blocks.items():
                self._memory[file.key, number] = block
                self._memory.move_to_end((file.key, number))
            while len(self._memory) > most:
                self._memory.popitem(last=False)

    def _fetch(self, runs: Sequence[_Run]) -> "Iterator[dict[int, bytes] | Exception]":
        """Fetch runs of blocks, keep them, and yield them."""
        parts = [part for run in runs for part in _parts(run)]
        for group in _groups(parts, self.memory_bytes // 2):
            asked = [part.request() for part in group]
            for run, request, outcome in zip(group, asked, self.fetcher.fetch(asked), strict=True):
                data = _checked(run.file, request, outcome)
                if isinstance(data, Exception):
                    yield data
                    continue
                blocks = {
                    run.first + at // BLOCK_BYTES: data[at : at + BLOCK_BYTES]
                    for at in range(0, len(data), BLOCK_BYTES)
                }
                self._remember(run.file, blocks)
                if run.file.is_kept:
                    self._disk.write(run.file.key, blocks)
                yield blocks


def memory_bytes(cache_bytes: int) -> int:
    """Return how much memory each process takes for blocks.

    Parameters
    ----------
    cache_bytes : int
        What the disk may keep.
    """
    least, most = _MEMORY
    return min(max(cache_bytes // _MEMORY_SHARE, least), most)


def bytes_of(spans: Iterable[Span]) -> int:
    """Return how many bytes are fetched for some spans, were nothing at hand."""
    runs = [run for file, wanted in _wanted(spans) for run in _runs(file, wanted)]
    return sum(run.stop - run.first for run in runs) * BLOCK_BYTES


def _wanted(spans: Iterable[Span]) -> list[tuple[RemoteFile, list[int]]]:
    """Return the blocks that spans lie in, ascending, by file."""
    found: dict[str, tuple[RemoteFile, set[int]]] = {}
    room = _MOST_TOGETHER
    for file, start, stop in spans:
        first, end = start // BLOCK_BYTES, -(-stop // BLOCK_BYTES)
        end = min(end, first + room)
        if stop > start and end > first:
            _, numbers = found.setdefault(file.key, (file, set()))
            room += len(numbers)
            numbers.update(range(first, end))
            room -= len(numbers)
    return [(file, sorted(numbers)) for file, numbers in found.values()]


def _runs(file: RemoteFile, numbers: list[int]) -> Iterator[_Run]:
    """Join blocks to runs, across gaps that are shorter than a request is worth."""
    for at, number in enumerate(numbers):
        if at == 0 or number - numbers[at - 1] > _GAP_BLOCKS:
            first = number
        if at + 1 == len(numbers) or numbers[at + 1] - number > _GAP_BLOCKS:
            yield _Run(file, first, number + 1)


def _parts(run: _Run) -> Iterator[_Run]:
    for first in range(run.first, run.stop, _MOST_BLOCKS):
        yield _Run(run.file, first, min(first + _MOST_BLOCKS, run.stop))


def _groups(parts: list[_Run], most: int) -> Iterator[list[_Run]]:
    """Divide runs into groups of so many bytes, or of one run: so much is under way at once."""
    group: list[_Run] = []
    size = 0
    for part in parts:
        length = (part.stop - part.first) * BLOCK_BYTES
        if group and size + length > most:
            yield group
            group, size = [], 0
        group.append(part)
        size += length
    if group:
        yield group


def _checked(file: RemoteFile, request: Request, outcome: Outcome) -> bytes | Exception:
    """Return the bytes that were asked for, of the object that it was asked of."""
    if isinstance(outcome, Exception):
        return outcome
    try:
        file.identify(_identity(outcome))
    except ChangedDataError as error:
        return error
    if len(outcome.data) != request.length:
        return UnreachableError(
            f"the server sent {len(outcome.data)} of {request.length} bytes",
            where=file.address.shown,
            fix="Try again; if it stays, download the data.",
        )
    return outcome.data


def _identity(answer: Answer) -> Identity:
    return Identity(answer.size, answer.tag)


def _told(error: Exception, file: RemoteFile) -> Exception:
    """Return what an error means for an object that was there: gone is changed."""
    if not isinstance(error, FileNotFoundError):
        return error
    return ChangedDataError(
        "is gone since it was opened",
        where=file.address.shown,
        fix="Open the dataset again; while it is read, nothing may write to it.",
    )


_readers: dict[int, Reader] = {}
"""By process: what a forked one inherits has threads and locks that are not its own."""


def reader() -> Reader:
    """Return this process's reader.

    ``$EXUMI_CACHE`` is the folder of its cache, ``$EXUMI_CACHE_BYTES`` how much it may hold
    (default 4 GiB; 0 keeps nothing on the disk).

    Raises
    ------
    UsageError
        ``$EXUMI_CACHE_BYTES`` is no number.
    """
    found = _readers.get(os.getpid())
    if found is None:
        _readers.clear()
        found = _readers[os.getpid()] = Reader(_cache_folder(), _cache_bytes())
    return found


def _cache_folder() -> Path:
    import platformdirs  # used here alone

    chosen = os.environ.get("EXUMI_CACHE")
    base = Path(chosen) if chosen else platformdirs.user_cache_path("exumi-data", appauthor=False)
    return base / "remote"


def _cache_bytes() -> int:
    told = os.environ.get("EXUMI_CACHE_BYTES", "")
    if not told:
        return _DEFAULT_CACHE_BYTES
    if not told.isdecimal():
        raise UsageError(
            f"EXUMI_CACHE_BYTES is {told!r}, not a number of bytes",
            fix="Say, for 20 GiB: export EXUMI_CACHE_BYTES=21474836480",
        )
    return int(told)
