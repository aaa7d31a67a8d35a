"""Reading all of an index to see whether it is sound."""

import os
from pathlib import Path

from exumi_data.errors import (
    DamagedDataError,
    ExumiError,
    LimitError,
    MetadataError,
    UnsupportedError,
)
from exumi_loaders.retrieval.document import IndexDocument
from exumi_loaders.retrieval.folder import read_document
from exumi_loaders.retrieval.segments import open_segment
from exumi_loaders.retrieval.writing import read_space

__all__ = ["verify_index"]


# What one flipped byte makes of a sound file.
_DAMAGE = (DamagedDataError, LimitError, MetadataError, UnsupportedError)


def verify_index(path: str | os.PathLike[str]) -> list[ExumiError]:
    """Read all files of an index, and compare their checksums.

    Opening reads no vectors, and searching checks only those that it computes with; here nothing
    is left out. Memory: as much as the largest table of entries.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    list of ExumiError
        One for each damaged file, with its path as ``where``; none if all is sound.

    Raises
    ------
    NotAnEpisodeError
        There is no index.
    UnsupportedError
        It is of a newer version.
    """
    root = Path(path)
    while True:
        try:
            document = read_document(root)
        except (DamagedDataError, LimitError, MetadataError) as error:
            return [error]
        found = _damages(root, document)
        # Where another process changed it meanwhile, files may be gone that it no longer names.
        if not found or read_document(root).generation == document.generation:
            return found


def _damages(root: Path, document: IndexDocument) -> list[ExumiError]:
    found: list[ExumiError] = []
    try:
        read_space(root, document)
    except _DAMAGE as error:
        found.append(error)
    for statement in document.segments:
        try:
            segment = open_segment(root, statement, document.dimension)
        except _DAMAGE as error:
            found.append(error)
            continue
        for block in segment.blocks:
            try:
                block.check()
            except DamagedDataError as error:
                found.append(error)
    return found
