"""Packing an episode into one stored zip (spec: Packing). Deterministic: same bytes every time."""

import stat
import zipfile
from collections.abc import Mapping
from pathlib import Path

from exumi_data.errors import EpisodeExistsError, UsageError
from exumi_data.store.access import FolderStore, Store
from exumi_data.store.files import atomic_file

__all__ = ["pack", "pack_store", "packing_order"]

_EPOCH = (1980, 1, 1, 0, 0, 0)
_ZIP64_FROM = 1 << 31
_PIECE = 4 << 20


def packing_order(paths: list[str]) -> list[str]:
    """Sort paths: root ``zarr.json``, the other ``zarr.json`` breadth-first, then the rest."""

    def key(path: str) -> tuple[int, int, bytes]:
        is_metadata = path.rpartition("/")[2] == "zarr.json"
        return (0, path.count("/"), path.encode()) if is_metadata else (1, 0, path.encode())

    return sorted(paths, key=key)


def pack(folder: Path, target: Path | None = None, *, overwrite: bool = False) -> Path:
    """Copy a finished episode folder into one stored zip.

    Parameters
    ----------
    folder : pathlib.Path
        The episode, ``<name>.zarr``. It stays.
    target : pathlib.Path, optional
        Default: ``<name>.zarr.zip`` beside it.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    pathlib.Path
        The zip.

    Raises
    ------
    EpisodeExistsError
        The target exists.
    UsageError
        `folder` is no finished episode, or holds the target.
    """
    target = target or folder.with_name(folder.name + ".zip")
    if not (folder / "zarr.json").is_file():
        raise UsageError("not a finished episode folder", where=folder)
    if target.resolve().is_relative_to(folder.resolve()):
        raise UsageError("a packed episode cannot lie in its own folder", where=target)
    if target.exists() and not overwrite:
        raise EpisodeExistsError("already exists", where=target)
    store = FolderStore(folder)
    try:
        pack_store(store, target)
    finally:
        store.close()
    return target


def pack_store(store: Store, target: Path, *, replaced: Mapping[str, bytes] | None = None) -> None:
    """Write what a store holds into one stored zip, which then takes its final name.

    Parameters
    ----------
    store : Store
        Of a finished episode, in a folder or packed already.
    target : pathlib.Path
        The zip; one that is there is replaced.
    replaced : mapping of str to bytes, optional
        Files with other content than the store's, by path.

    Raises
    ------
    DamagedDataError
        A file is cut short.
    """
    anew = replaced or {}
    with (
        atomic_file(target) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive,
    ):
        for path in packing_order(store.paths()):
            content = anew.get(path)
            info = zipfile.ZipInfo(path, _EPOCH)
            info.external_attr = (stat.S_IFREG | 0o644) << 16
            info.create_system = 3
            info.file_size = store.size(path) if content is None else len(content)
            large = info.file_size >= _ZIP64_FROM
            with archive.open(info, "w", force_zip64=large) as writer:
                if content is not None:
                    writer.write(content)
                    continue
                for start in range(0, info.file_size, _PIECE):
                    length = min(_PIECE, info.file_size - start)
                    writer.write(store.read_range(path, start, length))
