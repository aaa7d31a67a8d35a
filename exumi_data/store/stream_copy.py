"""A stream of another episode, taken over file by file: nothing is decoded or written anew."""

from collections.abc import Collection
from pathlib import Path

from exumi_data.model.streams import StreamModel
from exumi_data.store.access import Store

__all__ = ["CopiedStream", "copy_files"]

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
        Its metadata, taken over as they are.

    Raises
    ------
    DamagedDataError
        A file is cut short.
    """

    def __init__(self, folder: Path, store: Store, path: str, model: StreamModel) -> None:
        self.name = folder.name
        self.model = model.model_copy(deep=True)
        copy_files(store, path, folder)

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
        _copy(store, member, folder / member.removeprefix(prefix))


def _less(members: set[str], without: Collection[str]) -> set[str]:
    kept = {m for m in members if not any(m.startswith(f"{array}/") for array in without)}
    groups = {array.rsplit("/", depth)[0] for array in without for depth in range(1, 64)}
    for group in sorted(groups, key=len, reverse=True):
        if not any(m.startswith(f"{group}/") and m != f"{group}/zarr.json" for m in kept):
            kept.discard(f"{group}/zarr.json")
    return kept


def _copy(store: Store, member: str, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    size = store.size(member)
    with target.open("xb") as file:
        for start in range(0, size, _PIECE):
            file.write(store.read_range(member, start, min(_PIECE, size - start)))
