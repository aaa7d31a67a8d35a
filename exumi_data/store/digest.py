"""The digest of an episode: the same for a folder and for its packed form (spec: Identity)."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from exumi_data.store.access import Store

__all__ = ["digest_of", "sha256_file", "sha256_store_file"]

_PIECE = 4 << 20


def sha256_file(path: Path) -> str:
    """Return the sha-256 of a file, read in pieces."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sha256_store_file(store: Store, path: str) -> tuple[str, int]:
    """Return (sha-256, size) of one file of a store, read in pieces."""
    size = store.size(path)
    if size <= _PIECE:
        return hashlib.sha256(store.read(path)).hexdigest(), size
    state = hashlib.sha256()
    for start in range(0, size, _PIECE):
        state.update(store.read_range(path, start, min(_PIECE, size - start)))
    return state.hexdigest(), size


def digest_of(store: Store, *, derived: bool = False, paths: Iterable[str] | None = None) -> str:
    r"""Return an episode's digest.

    It is the sha-256 over lines ``sha256 size path\n`` of all files outside ``derived/``, sorted
    by the bytes of their paths. Directory entries and the order in an archive play no part.

    Parameters
    ----------
    store : Store
    derived : bool
        Digest the files in ``derived/`` instead: what a cache of derived values depends on.
    paths : iterable of str, optional
        All files of the store, where they are known: it is not listed again.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    state = hashlib.sha256()
    for path in sorted(store.paths() if paths is None else paths, key=str.encode):
        if path.startswith("derived/") != derived:
            continue
        checksum, size = sha256_store_file(store, path)
        state.update(f"{checksum} {size} {path}\n".encode())
    return state.hexdigest()
