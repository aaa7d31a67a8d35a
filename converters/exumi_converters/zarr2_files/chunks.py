"""Where the chunks of an array are: in a folder, or in a zip by its directory."""

import os
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from exumi_converters.zarr2_files.metadata import ArrayMeta
from exumi_converters.zarr2_files.zip_index import Member, read_member
from exumi_data.store.access import FolderStore

__all__ = ["Chunks", "FolderChunks", "Piece", "ZipChunks", "ZipFile"]

Piece = tuple[int, ...]
"""The numbers, but the first, of a chunk: which part of a row it holds."""


class Chunks(Protocol):
    """Where the chunks of an array are."""

    def read(self, row: int, piece: Piece) -> bytes | None:
        """Return a chunk as stored; None if there is none."""
        ...

    def part(self, first: int, last: int) -> "Chunks":
        """Return the same of some rows of chunks only."""
        ...


@dataclass(frozen=True, slots=True)
class FolderChunks:
    """Chunks that are files of a folder.

    Attributes
    ----------
    store : FolderStore
    meta : ArrayMeta
    """

    store: FolderStore
    meta: ArrayMeta

    def read(self, row: int, piece: Piece) -> bytes | None:
        """Return a chunk as stored; None if there is none."""
        try:
            return self.store.read(f"{self.meta.path}/{self.meta.chunk_name(row, piece)}")
        except FileNotFoundError:
            return None

    def part(self, first: int, last: int) -> "FolderChunks":
        """Return itself: nothing is held."""
        return self


class ZipFile:
    """A descriptor of a zip: opened when first read, not sent to other processes.

    Parameters
    ----------
    path : pathlib.Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None

    def __getstate__(self) -> Path:
        return self.path

    def __setstate__(self, path: Path) -> None:
        self.__init__(path)  # type: ignore[misc]  # descriptors do not cross processes

    @property
    def descriptor(self) -> int:
        """Of the open file."""
        if self._descriptor is None:
            self._descriptor = os.open(self.path, os.O_RDONLY)
            weakref.finalize(self, os.close, self._descriptor)
        return self._descriptor


class ZipChunks:
    """Chunks in a zip.

    Parameters
    ----------
    file : ZipFile
    path : str
        Of the array, for errors.
    tables : mapping of tuple to ndarray
        For each piece of a row, the records of its chunks, ascending.
    """

    def __init__(self, file: ZipFile, path: str, tables: Mapping[Piece, np.ndarray]) -> None:
        self._file = file
        self._path = path
        self._tables = tables
        # The same as a dictionary, when it is asked for: looked up in a tenth of the time.
        self._found: dict[Piece, dict[int, Member]] = {}

    def __getstate__(self) -> tuple[ZipFile, str, Mapping[Piece, np.ndarray]]:
        return self._file, self._path, self._tables

    def __setstate__(self, state: tuple[ZipFile, str, Mapping[Piece, np.ndarray]]) -> None:
        self.__init__(*state)  # type: ignore[misc]  # without what was found

    def read(self, row: int, piece: Piece) -> bytes | None:
        """Return a chunk as stored; None if there is none."""
        found = self._found.get(piece)
        if found is None:
            table = self._tables.get(piece)
            members = () if table is None else map(Member._make, table.tolist())
            found = self._found[piece] = {member.row: member for member in members}
        member = found.get(row)
        if member is None:
            return None
        return read_member(self._file.descriptor, member, f"{self._path} {row}")

    def part(self, first: int, last: int) -> "ZipChunks":
        """Return the same of some rows of chunks only."""
        tables = {}
        for piece, table in self._tables.items():
            start, stop = np.searchsorted(table["row"], (first, last + 1))
            # A view: what is sent to a worker is this part alone.
            tables[piece] = table[start:stop]
        return ZipChunks(self._file, self._path, tables)
