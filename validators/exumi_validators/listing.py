"""The files of an episode, with links and special files told apart and never followed."""

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from exumi_data.store.access import ZipStore

__all__ = ["Listing", "list_folder", "list_zip"]

_MAX_DEPTH = 32


@dataclass(frozen=True)
class Listing:
    """What an episode consists of.

    Attributes
    ----------
    files : dict
        Path to size in bytes.
    links : tuple of str
        Links and special files.
    unsafe : tuple of str
        Names that could lead out of the store when it is copied or unpacked elsewhere.
    closed : dict
        Folders that cannot be listed, with the reason.
    """

    files: dict[str, int] = field(default_factory=dict)
    links: tuple[str, ...] = ()
    unsafe: tuple[str, ...] = ()
    closed: dict[str, str] = field(default_factory=dict)

    @cached_property
    def chunk_files(self) -> dict[str, list[str]]:
        """Array to the files below its folder ``c``, by what follows that."""
        found: dict[str, list[str]] = {}
        for path in self.files:
            array, slash, rest = path.partition("/c/")
            if slash:
                found.setdefault(array, []).append(rest)
        return found


def _is_unsafe(name: str) -> bool:
    return "\\" in name or not name.isprintable() or (len(name) > 1 and name[1] == ":")


def _walk(root: str, closed: dict[str, str]) -> Iterator[tuple[str, os.stat_result]]:
    folders = [("", 0)]
    while folders:
        prefix, depth = folders.pop()
        try:
            entries = os.scandir(f"{root}/{prefix}")
        except OSError as error:
            closed[prefix.rstrip("/") or "."] = error.strerror or str(error)
            continue
        with entries:
            for entry in entries:
                path = prefix + entry.name
                is_folder = entry.is_dir(follow_symlinks=False)
                if is_folder and depth < _MAX_DEPTH and not _is_unsafe(entry.name):
                    folders.append((f"{path}/", depth + 1))
                else:
                    yield path, entry.stat(follow_symlinks=False)


def list_folder(root: str) -> Listing:
    """List a folder's files. Nothing is opened and no link is followed.

    Parameters
    ----------
    root : str
    """
    files, links, unsafe = {}, [], []
    closed: dict[str, str] = {}
    for path, info in _walk(root, closed):
        if _is_unsafe(path.rpartition("/")[2]):
            unsafe.append(path)
        elif stat.S_ISREG(info.st_mode):
            files[path] = info.st_size
        else:
            links.append(path)
    return Listing(files, tuple(sorted(links)), tuple(sorted(unsafe)), closed)


def list_zip(store: ZipStore) -> Listing:
    """List a packed episode's members, which the store has checked.

    Parameters
    ----------
    store : ZipStore
    """
    return Listing({path: store.size(path) for path in store.paths()})
