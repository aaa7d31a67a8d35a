"""Writing an index, and reading the space that belongs to it."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from exumi_data.errors import DamagedDataError, LimitError, UsageError
from exumi_data.model.documents import group_document
from exumi_data.store.access import FolderStore
from exumi_data.store.files import claim_folder, sync_folder, sync_tree
from exumi_data.store.shards import open_array
from exumi_loaders.encoder import Encoder
from exumi_loaders.retrieval.building import EncodedClips
from exumi_loaders.retrieval.document import EncoderStatement, IndexDocument, SourceStatement
from exumi_loaders.retrieval.folder import write_document
from exumi_loaders.retrieval.segments import write_segment, write_vectors
from exumi_loaders.retrieval.space import METHOD, Space, fit_space, unit

__all__ = ["check_free", "fill_index", "new_index", "read_space", "write_index"]

_SPACE = "space"
_MOST_NUMBERS = 1 << 26


def write_index(
    target: Path,
    clips: EncodedClips,
    encoder: Encoder,
    *,
    frames: int,
    source: SourceStatement | None = None,
) -> None:
    """Write an index of clips that are encoded; it appears when it is complete.

    Parameters
    ----------
    target : pathlib.Path
        A new folder.
    clips : EncodedClips
    encoder : Encoder
    frames : int
    source : SourceStatement, optional
    """
    with new_index(target) as partial:
        fill_index(partial, clips, encoder, frames=frames, source=source)


@contextmanager
def new_index(target: Path) -> Iterator[Path]:
    """Yield the folder to write an index in; at the end it gets its name, or is removed.

    The place is claimed at once: nobody else builds there meanwhile, and a folder that cannot be
    written to is found out before anything is encoded.

    Parameters
    ----------
    target : pathlib.Path
        A new folder.

    Raises
    ------
    UsageError
        Something of that name is there; it lies inside an episode; another process builds it.
    """
    check_free(target)
    partial = target.with_name(f".partial-{target.name}")
    claim = claim_folder(partial)
    try:
        yield partial
        sync_tree(partial)
        check_free(target)
        partial.rename(target)
        sync_folder(target.parent)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    finally:
        os.close(claim)


def fill_index(
    partial: Path,
    clips: EncodedClips,
    encoder: Encoder,
    *,
    frames: int,
    source: SourceStatement | None = None,
) -> None:
    """Write the files of an index.

    Parameters
    ----------
    partial : pathlib.Path
        An empty folder.
    clips : EncodedClips
    encoder : Encoder
    frames : int
    source : SourceStatement, optional
    """
    space = None if encoder.whitening is None else fit_space(clips.vectors, encoder.whitening)
    placed = unit(clips.vectors) if space is None else space.place(clips.vectors)
    (partial / "zarr.json").write_bytes(group_document())
    if space is not None:
        _write_space(partial / _SPACE, space)
    document = IndexDocument(
        encoder=EncoderStatement(
            name=encoder.name, digest=encoder.digest, dimension=encoder.dimension
        ),
        frames=frames,
        dimension=placed.shape[1],
        space=None if space is None else METHOD,
        source=source,
        segments=[write_segment(partial, placed, clips.entries)],
    )
    write_document(partial, document)


def _write_space(folder: Path, space: Space) -> None:
    folder.mkdir()
    (folder / "zarr.json").write_bytes(group_document())
    write_vectors(folder / "mean", space.mean[None], mapped=False)
    write_vectors(folder / "matrix", space.matrix, mapped=False)


def check_free(target: Path) -> None:
    """Raise `UsageError` if something of that name is there, or it lies inside a Zarr store."""
    if target.exists() or target.is_symlink():
        raise UsageError(
            "is there already", where=target, fix="Remove it first, or name another folder."
        )
    parent = Path(os.path.realpath(target.parent))  # a link may lead into one
    for folder in (parent, *parent.parents):
        if (folder / "zarr.json").is_file():
            raise UsageError(
                f"lies inside {folder}, an episode or another index, to which it would be damage",
                where=target,
                fix="Name a folder beside it.",
            )


def read_space(root: Path, document: IndexDocument) -> Space | None:
    """Read the space of an index; None where vectors are compared as the encoder gives them.

    Raises
    ------
    DamagedDataError
        It is missing, damaged, or does not fit.
    LimitError
        It asks for more memory than it may.
    """
    if document.space is None:
        if document.dimension != document.encoder.dimension:
            raise DamagedDataError("the index has another dimension than its encoder", where=root)
        return None
    shapes = {
        "mean": (1, document.encoder.dimension),
        "matrix": (document.encoder.dimension, document.dimension),
    }
    store = FolderStore(root)
    arrays = {}
    try:
        for name, shape in shapes.items():
            array = open_array(store, f"{_SPACE}/{name}")
            if array.shape != shape or array.dtype != np.float32:
                raise DamagedDataError(
                    f"{array.shape} {array.dtype}, expected {shape} float32",
                    where=root / _SPACE / name,
                )
            if shape[0] * shape[1] > _MOST_NUMBERS:
                raise LimitError(f"a matrix of {shape}", where=root / _SPACE / name)
            arrays[name] = array.read()
    finally:
        store.close()
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise DamagedDataError("numbers are not finite", where=root / _SPACE)
    return Space(arrays["mean"][0], arrays["matrix"])
