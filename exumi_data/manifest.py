"""The manifest of a dataset: every file with its digest, made when a dataset is released."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from exumi_data.catalog import list_episodes
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, dump, parse_episode, parse_manifest
from exumi_data.model.manifest import Manifest, ManifestEpisode, ManifestFile
from exumi_data.store.access import open_store
from exumi_data.store.digest import digest_of
from exumi_data.store.files import write_atomic
from exumi_data.store.paths import check_member_path
from exumi_data.store.plain_files import open_plain

__all__ = [
    "MANIFEST_NAME",
    "Listed",
    "build_manifest",
    "check_listable",
    "is_listed",
    "list_files",
    "sha256_of",
    "write_manifest",
]

MANIFEST_NAME = "manifest.json"
_DEEPEST = 64
_EPISODE_BYTES = 389  # of a packed episode that has a thousand bytes or more: file, and episode


@dataclass(frozen=True, slots=True)
class Listed:
    """What a manifest says of a packed episode.

    Attributes
    ----------
    file : ManifestFile
    episode : ManifestEpisode
    """

    file: ManifestFile
    episode: ManifestEpisode


def check_listable(episodes: int, where: object) -> None:
    """Refuse more packed episodes than a manifest can list, before they are packed.

    Parameters
    ----------
    episodes : int
    where : object
        The dataset, named in the error.

    Raises
    ------
    UsageError
        The manifest would be larger than a document may be.
    """
    most = MAX_DOCUMENT_BYTES // _EPISODE_BYTES
    if episodes > most:
        raise UsageError(
            f"has {episodes:,} episodes; a manifest lists {most:,} at most",
            where=where,
            fix="Release it in parts, each made with: exumi dataset select",
        )


def is_listed(path: str) -> bool:
    """Whether a manifest lists a file: all but itself, and what is hidden.

    Parameters
    ----------
    path : str
        Relative to the dataset, with ``/``.
    """
    hidden = any(part.startswith(".") for part in path.split("/"))
    return path != MANIFEST_NAME and not hidden


def sha256_of(path: Path) -> tuple[str, int]:
    """Return (sha-256, size) of a file; it is read in pieces, and no link is followed.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    FileNotFoundError
        Nothing is there.
    DamagedDataError
        It is no file, or cannot be read.
    """
    with open_plain(path) as file:
        try:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            return digest, file.tell()
        except OSError as error:
            raise DamagedDataError(f"cannot be read ({error.strerror})", where=path) from error


def build_manifest(
    root: str | os.PathLike[str], known: Mapping[str, Listed] | None = None
) -> Manifest:
    """Read a whole dataset and make its manifest; nothing is written.

    The same dataset gives the same manifest, wherever it lies.

    Parameters
    ----------
    root : path-like
        The dataset's folder.
    known : mapping of str to Listed, optional
        Packed episodes by path that whoever asks has just written: they are not read again.

    Returns
    -------
    Manifest
        Files and episodes are sorted by the bytes of their path.

    Raises
    ------
    DamagedDataError
        There is a link or an unsafe name, or a file cannot be read.
    MetadataError, UnsupportedError
        An episode's metadata cannot be read.

    Examples
    --------
    >>> from exumi_data.manifest import build_manifest
    >>> manifest = build_manifest("my-dataset")  # doctest: +SKIP
    >>> len(manifest.files)  # doctest: +SKIP
    1203
    """
    folder, there = Path(root), known or {}
    files = [
        there[path].file if path in there else _file(folder, path)
        for path in sorted(list_files(folder), key=str.encode)
    ]
    episodes = [
        there[path].episode if path in there else _episode(folder, path)
        for path in list_episodes(folder)
    ]
    return Manifest(files=files, episodes=episodes)


def write_manifest(root: str | os.PathLike[str], known: Mapping[str, Listed] | None = None) -> Path:
    """Make the manifest of a dataset and write it, whole or not at all; an older one is replaced.

    Parameters
    ----------
    root : path-like
        The dataset's folder.
    known : mapping of str to Listed, optional
        See `build_manifest`.

    Returns
    -------
    pathlib.Path
        ``manifest.json``.

    Raises
    ------
    UsageError
        A link stands there, or a folder.
    DamagedDataError
        There is a link or an unsafe name, or a file cannot be read.
    MetadataError, UnsupportedError
        An episode's metadata cannot be read, or there are more files than a manifest can list.
    """
    target = Path(root) / MANIFEST_NAME
    if target.is_symlink() or target.is_dir():
        what = "is a link" if target.is_symlink() else "is a folder"
        raise UsageError(f"{what}: it is not replaced", where=target, fix="Remove it first.")
    document = dump(build_manifest(root, known))
    raw = (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()
    parse_manifest(raw, target)  # what is too long for a reader is not written
    write_atomic(target, raw)
    return target


def _file(root: Path, path: str) -> ManifestFile:
    checksum, size = sha256_of(root / path)
    return ManifestFile(path=path, bytes=size, sha256=checksum)


def list_files(
    root: Path, on_problem: Callable[[DamagedDataError], None] | None = None
) -> Iterator[str]:
    """Walk over what a manifest of a dataset would list; what is no folder counts as a file.

    Parameters
    ----------
    root : pathlib.Path
        The dataset.
    on_problem : callable, optional
        Told what cannot be listed, which is passed over; default: it is raised.

    Yields
    ------
    str
        Paths relative to the dataset, in no order.

    Raises
    ------
    DamagedDataError
        A folder cannot be read or lies too deep, or a name is unsafe.
    """

    def tell(problem: DamagedDataError) -> None:
        if on_problem is None:
            raise problem
        on_problem(problem)

    pending = [("", 0)]
    while pending:
        folder, depth = pending.pop()
        try:
            with os.scandir(root / folder) as entries:
                found = list(entries)
        except OSError as error:
            tell(DamagedDataError(f"cannot be read ({error.strerror})", where=root / folder))
            continue
        for entry in found:
            path = f"{folder}/{entry.name}" if folder else entry.name
            try:
                check_member_path(path, root)
            except DamagedDataError as error:
                tell(error)
                continue
            if not is_listed(path):
                continue
            if not entry.is_dir(follow_symlinks=False):
                yield path
            elif depth < _DEEPEST:
                pending.append((path, depth + 1))
            else:
                tell(DamagedDataError("folders are nested too deeply", where=root / path))


def _episode(root: Path, path: str) -> ManifestEpisode:
    store = open_store(root / path)
    try:
        metadata = parse_episode(store.read("zarr.json"), f"{root / path}/zarr.json")
        return ManifestEpisode(id=metadata.id, path=path, digest=digest_of(store))
    except FileNotFoundError:
        raise DamagedDataError("the episode has no zarr.json", where=root / path) from None
    finally:
        store.close()
