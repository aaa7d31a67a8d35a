"""The documents of a store, and where its arrays lie: in a folder, or in a zip."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from exumi_converters.zarr2_files.chunks import Chunks, FolderChunks, ZipChunks, ZipFile
from exumi_converters.zarr2_files.metadata import (
    MAX_DOCUMENT,
    ArrayMeta,
    load_json,
    parse_array,
)
from exumi_converters.zarr2_files.zip_index import Member, ZipIndex, is_zip, read_index, read_member
from exumi_data.errors import ExumiError, LimitError, SourceError
from exumi_data.store.access import FolderStore

__all__ = ["EPISODE_ENDS", "Documents", "open_documents"]

EPISODE_ENDS = "meta/episode_ends"
"""The array by which a store is known for a replay buffer."""


class Documents(ABC):
    """The documents of a store.

    Attributes
    ----------
    path : pathlib.Path
        Of the folder or the zip.
    """

    path: Path

    @abstractmethod
    def read(self, name: str) -> bytes | None:
        """Return a document; None if there is none."""

    @abstractmethod
    def arrays(self) -> list[str]:
        """Return the names of the arrays in ``data``."""

    @abstractmethod
    def chunks(self, meta: ArrayMeta) -> Chunks:
        """Return where an array's chunks are."""

    def meta(self, path: str) -> ArrayMeta:
        """Return what an array says of itself.

        Parameters
        ----------
        path : str
            Within the store.

        Raises
        ------
        SourceError, UnsupportedError, LimitError
            There is none, or it cannot be read.
        """
        raw = self.read(f"{path}/.zarray")
        where = f"{self.path}: {path}"
        if raw is None:
            raise SourceError(
                "there is no such array: this is no replay buffer of UMI",
                where=where,
                fix="Name the .zarr folder or the .zarr.zip itself.",
            )
        return parse_array(raw, path, where)

    def attributes(self) -> dict[str, Any]:
        """Return the root's ``.zattrs``; empty where it is damaged."""
        try:
            raw = self.read(".zattrs") or b"{}"
            value = load_json(raw) if len(raw) <= 32 * MAX_DOCUMENT else {}
        except (ExumiError, ValueError, RecursionError):
            value = {}
        return value if isinstance(value, dict) else {}


def open_documents(path: Path) -> Documents:
    """Open a store's documents: of a folder or a zip, whatever it is called.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    SourceError, LimitError
        The zip is damaged, or cannot be read safely.
    """
    if is_zip(path):
        return _ZipDocuments(path)
    if not path.is_dir():
        raise SourceError(
            "it is neither a folder nor a zip",
            where=path,
            fix="Name the .zarr folder or the .zarr.zip itself; get a cut file again.",
        )
    return _FolderDocuments(path)


class _FolderDocuments(Documents):
    def __init__(self, path: Path) -> None:
        self.path = path
        self._store = FolderStore(path)

    def read(self, name: str) -> bytes | None:
        try:
            return self._store.read(name)
        except FileNotFoundError:
            return None

    def arrays(self) -> list[str]:
        folder = self.path / "data"
        if not folder.is_dir():
            return []
        return [p.name for p in folder.iterdir() if (p / ".zarray").is_file()]

    def chunks(self, meta: ArrayMeta) -> Chunks:
        return FolderChunks(self._store, meta)


class _ZipDocuments(Documents):
    def __init__(self, path: Path) -> None:
        self.path = path
        self._index: ZipIndex = read_index(path)
        self._file = ZipFile(path)
        self._prefix = self._find_prefix()

    def _find_prefix(self) -> str:
        """Return what comes before the names: a folder that was packed with its own name."""
        tail = f"{EPISODE_ENDS}/.zarray"
        found = [n[: -len(tail)] for n in self._index.documents if n.endswith(tail)]
        found = [prefix for prefix in found if not prefix or prefix.endswith("/")]
        if len(found) > 1:
            raise SourceError(
                f"it holds {len(found)} replay buffers",
                where=self.path,
                fix="Unpack it, and convert them one by one.",
            )
        return found[0] if found else ""

    def read(self, name: str) -> bytes | None:
        record = self._index.documents.get(self._prefix + name)
        if record is None:
            return None
        if int(record["full"][0]) > 32 * MAX_DOCUMENT:
            raise LimitError("a document of more than 32 MiB", where=f"{self.path}: {name}")
        member = Member._make(record[0].tolist())
        return read_member(self._file.descriptor, member, f"{self.path}: {name}")

    def arrays(self) -> list[str]:
        head, tail = f"{self._prefix}data/", "/.zarray"
        names = (
            n[len(head) : -len(tail)]
            for n in self._index.documents
            if n.startswith(head) and n.endswith(tail)
        )
        return [name for name in names if name and "/" not in name]

    def chunks(self, meta: ArrayMeta) -> Chunks:
        path = self._prefix + meta.path
        tables = {
            tuple(map(int, filter(None, piece.split(".")))): table
            for (array, piece), table in self._index.chunks.items()
            if array == path
        }
        return ZipChunks(self._file, meta.path, tables)
