"""Which layout a file has, and the episodes in it. Reads names, shapes and attributes only."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from exumi_data.errors import LimitError, SourceError

if TYPE_CHECKING:
    import h5py

__all__ = [
    "Demonstration",
    "Hdf5Members",
    "demonstrations",
    "layout_of",
    "opened",
    "plain_datasets",
]

Layout = Literal["robomimic", "freetacman"]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_DEMO = re.compile(r"demo_(\d{1,9})")
_BLOCK_BYTES = 16 * 1024**2
_CHUNK_BYTES = 256 * 1024**2


@dataclass(frozen=True, slots=True)
class Demonstration:
    """One episode of a file.

    Attributes
    ----------
    path : pathlib.Path
    group : str
        Where it is in the file; empty for the whole file.
    number : int
    length : int
        Samples.
    layout : {"robomimic", "freetacman"}
    rate : str or None
        As the file states it, a rational number.
    task : str or None
    split : str or None
        Mask of robomimic that it is in.
    """

    path: Path
    group: str
    number: int
    length: int
    layout: Layout
    rate: str | None = None
    task: str | None = None
    split: str | None = None


@dataclass(frozen=True, slots=True)
class Hdf5Members:
    """The numbers of one episode, block by block: what its id is made from."""

    path: Path
    group: str

    def __iter__(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and bytes of each block of each dataset."""
        with opened(self.path) as file:
            root = file[self.group] if self.group else file
            for name, data in plain_datasets(root).items():
                yield f"{name} {data.dtype.str} {data.shape}", b""
                for start, block in blocks(data):
                    yield f"{name}[{start}]", block.tobytes()


@contextmanager
def opened(path: Path) -> Iterator["h5py.File"]:
    """Open a file for reading; what the library says of a damaged one becomes a `SourceError`."""
    import h5py

    try:
        with path.open("rb") as raw:
            is_hdf5 = raw.read(len(_SIGNATURE)) == _SIGNATURE
    except OSError as error:
        raise SourceError(f"cannot be read ({error.strerror})", where=path) from None
    if not is_hdf5:
        raise SourceError("is no HDF5 file: it begins otherwise", where=path)
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except (OSError, RuntimeError, KeyError) as error:
        raise SourceError(
            f"is damaged or cut short ({error})",
            where=path,
            fix="Get it again from its source.",
        ) from None


def plain_datasets(group: "h5py.Group", *, below: str = "") -> dict[str, "h5py.Dataset"]:
    """Return the datasets of numbers in a group and its groups, by path, in a stable order.

    Links that lead out of the file are not followed, and data that is kept elsewhere is not read.

    Parameters
    ----------
    group : h5py.Group
    below : str
        Put before the names.
    """
    import h5py

    found: dict[str, h5py.Dataset] = {}
    for name in sorted(group):
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group.get(name)
        if isinstance(item, h5py.Group):
            found |= plain_datasets(item, below=f"{below}{name}/")
        elif isinstance(item, h5py.Dataset) and _is_plain(item):
            found[f"{below}{name}"] = item
    return found


def _is_plain(data: "h5py.Dataset") -> bool:
    # Strings, objects and references are no numbers; external files are not this file.
    return bool(data.dtype.kind in "iufb" and data.ndim >= 1 and not data.external)


def blocks(data: "h5py.Dataset") -> Iterator[tuple[int, np.ndarray]]:
    """Yield first index and values of some rows at a time: memory is flat.

    Raises
    ------
    LimitError
        A chunk of the file would take more than 256 MiB.
    """
    row = int(np.prod(data.shape[1:], dtype=np.int64)) * data.dtype.itemsize
    chunk = int(np.prod(data.chunks, dtype=np.int64)) * data.dtype.itemsize if data.chunks else 0
    if max(row, chunk) > _CHUNK_BYTES:
        raise LimitError(
            f"{data.name} is stored in pieces of {max(row, chunk) >> 20} MiB",
            where=data.file.filename,
        )
    rows = max(1, _BLOCK_BYTES // max(1, row))
    for start in range(0, data.shape[0], rows):
        yield start, data[start : start + rows]


def layout_of(path: Path) -> Layout | None:
    """Recognise the layout of a file; None if it has none of the two."""
    with opened(path) as file:
        data = file.get("data")
        if data is not None and hasattr(data, "keys") and any(map(_DEMO.fullmatch, data)):
            return "robomimic"
        images = file.get("observations/images")
        if images is not None and hasattr(images, "keys") and len(images) > 0:
            return "freetacman"
    return None


def demonstrations(path: Path) -> list[Demonstration]:
    """List the episodes of a file.

    Raises
    ------
    SourceError
        It is damaged, or has none of the layouts.
    """
    layout = layout_of(path)
    if layout is None:
        raise SourceError(
            "has neither robomimic's data/demo_<n> nor FreeTacMan's observations/images",
            where=path,
        )
    with opened(path) as file:
        if layout == "robomimic":
            return _of_robomimic(path, file)
        length = max((d.shape[0] for d in plain_datasets(file["observations"]).values()), default=0)
        return [Demonstration(path, "", 0, length, layout)]


def _of_robomimic(path: Path, file: "h5py.File") -> list[Demonstration]:
    about = _environment(file["data"])
    splits = _masks(file)
    found = []
    for name in file["data"]:
        number = _DEMO.fullmatch(name)
        if number is None:
            continue
        group = file["data"][name]
        samples = plain_datasets(group.get("obs", group))
        length = max((data.shape[0] for data in samples.values()), default=0)
        found.append(
            Demonstration(
                path,
                f"data/{name}",
                int(number[1]),
                length,
                "robomimic",
                rate=about.get("rate"),
                task=about.get("task"),
                split=splits.get(name),
            )
        )
    return sorted(found, key=lambda demo: demo.number)


def _environment(data: "h5py.Group") -> dict[str, str]:
    """Return task and control rate, as ``env_args`` says them."""
    try:
        document = json.loads(data.attrs["env_args"])
    except (KeyError, ValueError, TypeError):
        return {}
    if not isinstance(document, dict):
        return {}
    found: dict[str, str] = {}
    if isinstance(document.get("env_name"), str):
        found["task"] = document["env_name"]
    arguments = document.get("env_kwargs")
    rate: Any = arguments.get("control_freq") if isinstance(arguments, dict) else None
    if isinstance(rate, bool):
        rate = None
    if isinstance(rate, int | float) and 0 < rate < 10_000 and float(rate).is_integer():  # Hz
        found["rate"] = f"{int(rate)}/1"
    return found


def _masks(file: "h5py.File") -> dict[str, str]:
    """Return demonstration to the list it is in: train or valid."""
    masks = file.get("mask")
    found: dict[str, str] = {}
    for word, name in (("train", "train"), ("valid", "val")):
        if masks is not None and word in masks:
            for entry in masks[word][:]:
                found[entry.decode() if isinstance(entry, bytes) else str(entry)] = name
    return found
