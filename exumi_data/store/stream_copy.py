"""A stream of another episode, taken over file by file: nothing is decoded or written anew."""

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from exumi_data.model.streams import StreamModel
from exumi_data.store.access import Store
from exumi_data.store.shards import ArrayWriter

__all__ = ["CopiedStream", "copy_file", "copy_files", "write_array"]

_PIECE = 4 << 20


class CopiedStream:
    """Stands where a stream's writer would, with a stream that is complete already.

    Parameters
    ----------
    folder : pathlib.Path
        ``streams/<name>`` of the episode that is being written.
    store : Store
        The other episode.
    path : str
        The stream's path in it.
    model : StreamModel
        Its metadata, taken over as they are, but for `arrays`.
    changed : mapping of str to ndarray, optional
        Arrays that are written instead of those of the same names, or beside them.

    Raises
    ------
    DamagedDataError
        A file is cut short.
    """

    def __init__(
        self,
        folder: Path,
        store: Store,
        path: str,
        model: StreamModel,
        changed: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        self.name = folder.name
        self.model = model.model_copy(deep=True)
        anew = changed or {}
        copy_files(store, path, folder, [f"{path}/{name}" for name in anew])
        for name, values in anew.items():
            names = ("time", *(f"{name}_{i}" for i in range(values.ndim - 1)))
            write_array(folder / name, values, names)
        added = [name for name in anew if name not in self.model.arrays]
        self.model.arrays = [*self.model.arrays, *added]

    def finish(self) -> StreamModel:
        """Return the stream's metadata."""
        return self.model

    def abort(self) -> None:
        """Do nothing: no file is open."""


def copy_files(store: Store, path: str, folder: Path, without: Collection[str] = ()) -> None:
    """Copy all files below a path of an episode.

    Parameters
    ----------
    store : Store
    path : str
    folder : pathlib.Path
        Where they go; made if there is one to copy.
    without : collection of str, optional
        Paths of arrays to leave out, and with them groups that hold nothing else.

    Raises
    ------
    DamagedDataError
        A file is cut short.
    """
    prefix = f"{path}/"
    members = {member for member in store.paths() if member.startswith(prefix)}
    for member in sorted(_less(members, without)):
        copy_file(store, member, folder / member.removeprefix(prefix))


def _less(members: set[str], without: Collection[str]) -> set[str]:
    kept = {m for m in members if not any(m.startswith(f"{array}/") for array in without)}
    groups = {array.rsplit("/", depth)[0] for array in without for depth in range(1, 64)}
    for group in sorted(groups, key=len, reverse=True):
        if not any(m.startswith(f"{group}/") and m != f"{group}/zarr.json" for m in kept):
            kept.discard(f"{group}/zarr.json")
    return kept


def copy_file(store: Store, member: str, target: Path) -> None:
    """Copy one file of an episode, piece by piece.

    Parameters
    ----------
    store : Store
    member : str
        Its path in the episode.
    target : pathlib.Path
        A new file; folders above it are made.

    Raises
    ------
    DamagedDataError
        It is cut short.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    size = store.size(member)
    with target.open("xb") as file:
        for start in range(0, size, _PIECE):
            file.write(store.read_range(member, start, min(_PIECE, size - start)))


def write_array(path: Path, values: np.ndarray, names: tuple[str, ...]) -> None:
    """Write a whole array of low dimension.

    Parameters
    ----------
    path : pathlib.Path
        Its folder; made here.
    values : ndarray
    names : tuple of str
        Of the axes.
    """
    writer = ArrayWriter(
        path, values.dtype, values.shape[1:], chunk_rows=8192, zstd=True, dimension_names=names
    )
    try:
        writer.append(values)
        writer.finish()
    finally:
        writer.abort()
