"""Taking out what may be private: of an episode, of ``dataset.json``, of a copy of a dataset.

A source is never touched: an episode without what was private is a store that lies over the other
one, to be packed or copied. That something was taken out is a lossy step on record, and a revision.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data import __version__
from exumi_data.catalog import list_episodes
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.destination import update_catalog
from exumi_data.errors import UnsupportedError, UsageError
from exumi_data.model.dataset import DatasetMetadata
from exumi_data.model.description import LossyStep
from exumi_data.model.documents import (
    MAX_DOCUMENT_BYTES,
    dump,
    episode_root_document,
    parse_dataset,
    parse_episode,
)
from exumi_data.model.images import EncodedImages, VideoImages
from exumi_data.model.streams import images_of
from exumi_data.release.privacy.documents import Removal, without_private_fields
from exumi_data.release.privacy.finding import people_of
from exumi_data.release.privacy.kinds import Kind, PrivateItem, shortened
from exumi_data.release.privacy.patched_store import PatchedStore, spread
from exumi_data.release.privacy.patches import CLEANING_COMMAND
from exumi_data.release.privacy.scanning import FilePatches, Scan, scan_store
from exumi_data.release.privacy.text import GONE
from exumi_data.store import jpeg
from exumi_data.store.access import Store, open_store
from exumi_data.store.files import claim_folder, replace_folder, sync_tree, write_atomic
from exumi_data.store.pack import pack_store
from exumi_data.store.plain_files import read_plain
from exumi_data.store.shards import crc32c, open_array
from exumi_data.store.stream_copy import copy_file, write_array

__all__ = [
    "REMOVAL_STEP",
    "Cleaned",
    "dataset_without_private",
    "remove_private",
    "without_private",
]

REMOVAL_STEP = "remove-private"
"""Name of the lossy step."""

_ROOT = "zarr.json"
_PIECE = 4 << 20


@dataclass(frozen=True, slots=True)
class Cleaned:
    """An episode without what was private.

    Attributes
    ----------
    store : Store
        To be read, packed or copied. The source itself where nothing was taken out.
    removed : list of PrivateItem
    """

    store: Store
    removed: list[PrivateItem]


def without_private(store: Store, removal: Removal, episode: str = "") -> Cleaned:
    """Return an episode without what may be private. The source stays as it is.

    Of the metadata, named fields go or become pseudonyms, and in texts a path becomes its last
    part. Bytes of video files and JPEG frames are overwritten where they lie: pictures, times and
    offsets stay what they are. Each stream's part is a lossy step, and the episode's revision
    one more; its digest is another.

    Parameters
    ----------
    store : Store
        The episode.
    removal : Removal
    episode : str, optional
        Its path, for the items.

    Returns
    -------
    Cleaned

    Raises
    ------
    UnsupportedError
        Something that is to be taken out cannot be.
    ExumiError
        The episode cannot be read.
    """
    removed: dict[PrivateItem, None] = {}

    def take(kind: Kind, where: str, value: str, why: str, *, removable: bool = True) -> bool:
        if kind not in removal.kinds:
            return False
        if not removable:
            raise UnsupportedError(
                f"{kind}: {why}; it cannot be taken out of {where}",
                where=store.location,
                fix=_advice(where),
            )
        removed[PrivateItem(kind, episode, where, shortened(value), why)] = None
        return True

    scan = scan_store(store, take, removal)
    if not removed:
        return Cleaned(store, [])
    return Cleaned(_patched(store, scan), list(removed))


def _advice(where: str) -> str:
    if "#" in where:
        return "Keep it, or give it another name: exumi dataset relabel, or where it was made."
    return (
        "Keep it, leave the stream out, or take it out of the source file "
        f"({CLEANING_COMMAND}) and convert that."
    )


def dataset_without_private(
    metadata: DatasetMetadata, removal: Removal
) -> tuple[DatasetMetadata, list[PrivateItem]]:
    """Return what ``dataset.json`` says without what may be private.

    Parameters
    ----------
    metadata : DatasetMetadata
        It stays as it is.
    removal : Removal

    Returns
    -------
    metadata : DatasetMetadata
    removed : list of PrivateItem
    """
    removed: dict[PrivateItem, None] = {}

    def take(kind: Kind, where: str, value: str, why: str, *, removable: bool = True) -> bool:
        if kind in removal.kinds and removable:
            removed[PrivateItem(kind, "", where, shortened(value), why)] = None
        return kind in removal.kinds and removable

    document = without_private_fields(dump(metadata), DATASET_DOCUMENT, take, removal)
    if not removed:
        return metadata, []
    # The address of an author is taken out with its brackets: "removed" is nobody's family name.
    authors = [author.removesuffix(f" <{GONE}>") for author in document.get("authors", [])]
    if authors:
        document["authors"] = authors
    raw = json.dumps(document, ensure_ascii=False).encode()
    return parse_dataset(raw, DATASET_DOCUMENT), list(removed)


def remove_private(
    root: str | os.PathLike[str],
    removal: Removal,
    *,
    on_done: Callable[[int], None] | None = None,
) -> list[PrivateItem]:
    """Take out of a dataset's folder what may be private: a copy's, for it cannot be undone.

    Each episode is replaced whole or not at all; the catalog is written anew. Run again, it goes
    on. Splits and other files are left alone.

    Parameters
    ----------
    root : path-like
        The dataset.
    removal : Removal
    on_done : callable, optional
        Told how many episodes are done.

    Returns
    -------
    list of PrivateItem
        What was taken out.

    Raises
    ------
    UsageError
        It is no dataset.
    UnsupportedError
        Something cannot be taken out; the episodes before are done.
    ExumiError
        Something cannot be read.
    """
    folder = Path(root)
    document = folder / DATASET_DOCUMENT
    try:
        metadata = parse_dataset(read_plain(document, MAX_DOCUMENT_BYTES), document)
    except FileNotFoundError:
        raise UsageError("no dataset.json: not a dataset", where=root) from None
    removal = replace(removal, names={**people_of(folder), **removal.names})
    changed, removed = dataset_without_private(metadata, removal)
    for number, path in enumerate(list_episodes(folder), 1):
        removed += _clean_episode(folder, path, removal)
        if on_done is not None:
            on_done(number)
    if changed is not metadata:
        text = json.dumps(dump(changed), indent=1, ensure_ascii=False) + "\n"
        write_atomic(document, text.encode())
    if removed:
        update_catalog(folder, {})
    return removed


def _clean_episode(root: Path, path: str, removal: Removal) -> list[PrivateItem]:
    target = root / path
    source = open_store(target)
    try:
        cleaned = without_private(source, removal, path)
        if not cleaned.removed:
            return []
        if not target.is_dir():
            pack_store(cleaned.store, target)
            return cleaned.removed
        partial = target.with_name(f".partial-{target.name.removesuffix('.zarr')}")
        claim = claim_folder(partial)
        try:
            for member in cleaned.store.paths():
                copy_file(cleaned.store, member, partial / member)
            sync_tree(partial)
            replace_folder(partial, target)
        finally:
            os.close(claim)
        return cleaned.removed
    finally:
        source.close()


def _patched(store: Store, scan: Scan) -> PatchedStore:
    raw = store.read(_ROOT)
    before = parse_episode(raw, f"{store.location}/{_ROOT}")
    document = scan.documents.pop(_ROOT, None)
    metadata = before if document is None else parse_episode(_bytes(document), store.location)
    replaced = {path: _bytes(changed) for path, changed in scan.documents.items()}
    over: dict[str, list[tuple[int, bytes]]] = {}
    for changed in (*scan.videos, *scan.frames):
        array = open_array(store, f"streams/{changed.stream}/data")
        pieces = _apart(changed)
        for path, found in spread(array, pieces).items():
            over.setdefault(path, []).extend(found)
    made = PatchedStore(store, replaced, over)
    for stream in dict.fromkeys(changed.stream for changed in scan.frames):
        replaced |= _checksums(made, stream, [one for one in scan.frames if one.stream == stream])
    after = metadata.model_copy(deep=True)
    for video in scan.videos:
        images = images_of(after.streams[video.stream])
        assert isinstance(images, VideoImages)  # noqa: S101  # it was scanned as one
        images.files[video.index].sha256 = _sha256(made, video)
    for stream in dict.fromkeys(changed.stream for changed in scan.frames):
        images = images_of(after.streams[stream])
        if isinstance(images, EncodedImages) and images.jpeg_comment is not None:
            images.jpeg_comment = _comment(made, stream)
    after.source.lossy = [*(after.source.lossy or []), *_steps(scan)]
    after.revision = before.revision + 1
    root = episode_root_document(after)
    parse_episode(root, store.location)  # what could not be read again is never written
    return PatchedStore(store, replaced | {_ROOT: root}, over)


def _comment(made: Store, stream: str) -> str | None:
    end = int(open_array(made, f"streams/{stream}/offset").rows(1, 2)[0])
    return jpeg.comment(open_array(made, f"streams/{stream}/data").bytes_at(0, end))


def _bytes(document: Any) -> bytes:
    return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()


def _apart(changed: FilePatches) -> list[tuple[int, bytes]]:
    """Return places in the stream's bytes, in order; where two overlap, the first holds."""
    pieces: list[tuple[int, bytes]] = []
    end = 0
    for patch in sorted(changed.patches, key=lambda patch: (patch.start, -len(patch.new))):
        skipped = max(0, end - patch.start)
        if skipped < len(patch.new):
            start = patch.start + skipped
            pieces.append((changed.start + start, patch.new[skipped:]))
            end = patch.start + len(patch.new)
    return pieces


def _sha256(made: Store, video: FilePatches) -> str:
    """Return the digest of a file as it is now; what was secret in it must be nowhere left."""
    array = open_array(made, f"streams/{video.stream}/data")
    secrets = {patch.secret for patch in video.patches if patch.secret}
    longest = max((len(secret) for secret in secrets), default=1)
    state, tail = hashlib.sha256(), b""
    for start in range(0, video.size, _PIECE):
        piece = array.bytes_at(video.start + start, min(_PIECE, video.size - start))
        state.update(piece)
        window = tail + piece
        if any(secret in window for secret in secrets):
            raise UnsupportedError(
                "what was to be taken out is also elsewhere in the file, among pictures or sound",
                where=f"{made.location}: {video.stream}, {video.name}",
                fix="Keep it, or leave the stream out.",
            )
        tail = window[-(longest - 1) :] if longest > 1 else b""
    return state.hexdigest()


def _checksums(made: Store, stream: str, frames: list[FilePatches]) -> dict[str, bytes]:
    """Return the files of a stream's array of checksums, with those of changed frames."""
    path = f"streams/{stream}/crc32c"
    values = open_array(made, path).read().copy()
    data = open_array(made, f"streams/{stream}/data")
    for frame in frames:
        values[frame.index] = crc32c(data.bytes_at(frame.start, frame.size))
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "crc32c")
        write_array(target, values.astype(np.uint32), ("time",))
        files = {file: file.relative_to(target).as_posix() for file in _files(target)}
        return {f"{path}/{name}": file.read_bytes() for file, name in files.items()}


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.is_file())


def _steps(scan: Scan) -> Iterator[LossyStep]:
    by = f"exumi-data {__version__}"
    if scan.fields:
        yield LossyStep(
            step=REMOVAL_STEP,
            detail="taken out of the metadata before release",
            parameters={
                "kinds": _kinds(kind for kind, _ in scan.fields),
                # Not which: a place has names of keys in it.
                "fields": len({where for _, where in scan.fields}),
            },
            by=by,
        )
    for what, changes in (("video files", scan.videos), ("JPEG frames", scan.frames)):
        for stream in dict.fromkeys(change.stream for change in changes):
            mine = [change for change in changes if change.stream == stream]
            patches = [patch for change in mine for patch in change.patches]
            yield LossyStep(
                step=REMOVAL_STEP,
                stream=stream,
                detail=f"overwritten in {what} before release; pictures and times are as they were",
                parameters={
                    "kinds": _kinds(patch.kind for patch in patches),
                    "bytes": sum(len(new) for change in mine for _, new in _apart(change)),
                },
                by=by,
            )


def _kinds(kinds: Iterable[Kind]) -> list[str]:
    return sorted(set(kinds))
