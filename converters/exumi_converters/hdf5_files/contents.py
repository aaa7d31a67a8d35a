"""Reading HDF5 files of strangers: no link is followed, no object built, memory is bounded."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exumi_converters.names import printed
from exumi_data.errors import LimitError, SourceError

if TYPE_CHECKING:
    import h5py

__all__ = [
    "Contents",
    "blocks",
    "child",
    "count_numbers",
    "damage_named",
    "opened",
    "read_whole",
    "walk",
]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_BLOCK_BYTES = 16 * 1024**2
_PIECE_BYTES = 256 * 1024**2
_MOST_ROWS = 20_000_000
_MOST_ENTRIES = 10_000
_DEEPEST = 16


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Turn what the library says of a damaged file into a `SourceError`.

    Only to be put around calls of the library: what else raises such errors is no fault of the
    file.
    """
    try:
        yield
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        if any(word in str(error) for word in ("not registered", "plugin")):
            raise SourceError(
                f"is compressed in a way that the library cannot read ({error})",
                where=path,
                fix="Write it again with a common filter: h5repack -f GZIP=4 OLD NEW.",
            ) from None
        raise SourceError(
            f"is damaged or cut short ({error})", where=path, fix="Get it again from its source."
        ) from None


@contextmanager
def opened(path: Path) -> Iterator["h5py.File"]:
    """Open a file for reading.

    Raises
    ------
    SourceError
        It is none, or damaged.
    """
    import h5py

    try:
        with path.open("rb") as raw:
            is_hdf5 = raw.read(len(_SIGNATURE)) == _SIGNATURE
    except OSError as error:
        raise SourceError(f"cannot be read ({error.strerror})", where=path) from None
    if not is_hdf5:
        raise SourceError("is no HDF5 file: it begins otherwise", where=path)
    with damage_named(path):
        file = h5py.File(path, "r", locking=False)
    with file:
        yield file


def child(group: object, name: str) -> "h5py.Group | h5py.Dataset | None":
    """Return what lies in a group under a name; None if that is nothing, or a link to elsewhere."""
    import h5py

    if not isinstance(group, h5py.Group):
        return None
    with damage_named(Path(group.file.filename)):
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            return None
        found = group.get(name)
    return found if isinstance(found, h5py.Group | h5py.Dataset) else None


@dataclass(slots=True)
class Contents:
    """What a group and the groups in it hold.

    Attributes
    ----------
    numbers : dict of str to h5py.Dataset
        The datasets of plain numbers, by path, in a stable order.
    others : list of str
        Everything else: links, texts, objects, and data that is kept in other files.
    """

    numbers: dict[str, "h5py.Dataset"] = field(default_factory=dict)
    others: list[str] = field(default_factory=list)


def walk(group: "h5py.Group") -> Contents:
    """List what a group holds. A group that lies in itself is walked through once.

    Raises
    ------
    SourceError
        The file is damaged, or its groups are too many.
    """
    import h5py

    found: list[tuple[str, h5py.Dataset]] = []
    contents = Contents()
    left: list[tuple[str, h5py.Group]] = [("", group)]
    seen: set[int] = set()
    entries = 0
    with damage_named(Path(group.file.filename)):
        while left:
            prefix, at = left.pop()
            address = int(h5py.h5o.get_info(at.id).addr)
            if address in seen or prefix.count("/") > _DEEPEST:
                contents.others.append(prefix.rstrip("/"))
                continue
            seen.add(address)
            for name in at:
                entries += 1
                if entries > _MOST_ENTRIES:
                    raise SourceError(
                        f"{group.name} holds more than {_MOST_ENTRIES:,} entries",
                        where=group.file.filename,
                    )
                item, path = child(at, name), f"{prefix}{printed(name)}"
                if isinstance(item, h5py.Group):
                    left.append((f"{path}/", item))
                elif isinstance(item, h5py.Dataset) and _is_plain(item):
                    found.append((path, item))
                else:
                    contents.others.append(path)
    contents.numbers = dict(sorted(found, key=lambda pair: pair[0]))
    contents.others.sort()
    return contents


def _is_plain(data: "h5py.Dataset") -> bool:
    # Strings, objects and references are no numbers; external and virtual data is not this file's.
    try:
        kind = data.dtype.kind
    except TypeError:  # of a type that NumPy does not have
        return False
    return bool(data.shape and kind in "iufb" and not data.external and not data.is_virtual)


def count_numbers(data: "h5py.Dataset") -> int:
    """Return how many numbers a dataset claims: h5py's own count can overflow."""
    return math.prod(map(int, data.shape))


def read_whole(data: "h5py.Dataset") -> np.ndarray:
    """Return all values of a dataset of few numbers a row.

    Raises
    ------
    SourceError, LimitError
        It is damaged, was never written, or would take more than 256 MiB.
    """
    count = count_numbers(data)
    if count * data.dtype.itemsize > _PIECE_BYTES:
        raise LimitError(
            f"{data.name} has {count:,} numbers: more than are read at once",
            where=data.file.filename,
        )
    _check_written(data)
    with damage_named(Path(data.file.filename)):
        return np.asarray(data[:])


def blocks(data: "h5py.Dataset") -> Iterator[tuple[int, np.ndarray]]:
    """Yield first index and values of some rows at a time: memory is flat.

    Raises
    ------
    SourceError, LimitError
        It is damaged, was never written, has too many rows, or is stored in pieces of more than
        256 MiB.
    """
    path = Path(data.file.filename)
    row = math.prod(map(int, data.shape[1:])) * data.dtype.itemsize
    piece = math.prod(map(int, data.chunks or (0,))) * data.dtype.itemsize
    if max(row, piece) > _PIECE_BYTES:
        raise LimitError(
            f"{data.name} is stored in pieces of {max(row, piece) >> 20} MiB", where=path
        )
    if data.shape[0] > _MOST_ROWS:
        raise LimitError(f"{data.name} has {data.shape[0]:,} samples", where=path)
    _check_written(data)
    rows = max(1, _BLOCK_BYTES // max(1, row))
    if data.chunks:
        # Whole pieces, where they are not larger: each of them is unpacked once.
        rows = max(rows // data.chunks[0] * data.chunks[0], min(rows, data.chunks[0]))
    for start in range(0, data.shape[0], rows):
        with damage_named(path):
            block = data[start : start + rows]
        yield start, block


def _check_written(data: "h5py.Dataset") -> None:
    """Refuse what was announced and never written: the library would make it up."""
    if not count_numbers(data):
        return
    with damage_named(Path(data.file.filename)):
        if data.chunks:
            shapes = zip(data.shape, data.chunks, strict=True)
            wanted = math.prod(-(-int(size) // int(chunk)) for size, chunk in shapes)
            there = int(data.id.get_num_chunks())
        else:
            wanted, there = 1, int(data.id.get_storage_size() > 0)
    if there < wanted:
        raise SourceError(
            f"{wanted - there:,} of the {wanted:,} pieces of {data.name} were never written",
            where=data.file.filename,
            fix="Finish or cut the file with the program that wrote it.",
        )
