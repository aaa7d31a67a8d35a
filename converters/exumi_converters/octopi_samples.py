"""Frames that lie in a folder as numbered files: Octopi-1.5's samples, ObjectFolder's trials."""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from exumi_converters.frame_files import FrameFile
from exumi_converters.source_folder import may_be_read
from exumi_data.errors import SourceError

__all__ = ["FRAME_SUFFIXES", "frame_paths", "read_frames"]

_NUMBER = re.compile(r"0*[0-9]{1,9}")  # more would lie beyond the times that can be stored

FRAME_SUFFIXES = (".jpg", ".jpeg", ".png")


def frame_paths(folder: Path) -> list[Path]:
    """List the frames of a folder, by their numbers.

    Raises
    ------
    SourceError
        There is none, a name is no number, a number comes twice, or JPEG and PNG are mixed.
    """
    paths = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in FRAME_SUFFIXES and may_be_read(path)
    ]
    if not paths:
        raise SourceError("the folder holds no frames", where=folder)
    unnumbered = sorted(path.name for path in paths if not _NUMBER.fullmatch(path.stem))
    if unnumbered:
        raise SourceError(
            f"{unnumbered[0]} is not the number of a frame",
            where=folder,
            fix="Rename or remove it.",
        )
    paths.sort(key=lambda path: int(path.stem))
    numbers = [int(path.stem) for path in paths]
    twice = [a for a, b in pairwise(numbers) if a == b]
    if twice:
        raise SourceError(f"there are two frames {twice[0]}", where=folder)
    if len({path.suffix.lower() == ".png" for path in paths}) > 1:
        raise SourceError("the folder holds both JPEG and PNG frames", where=folder)
    return paths


def read_frames(paths: Sequence[Path]) -> Iterator[FrameFile]:
    """Yield (number, file)."""
    for path in paths:
        try:
            yield int(path.stem), path.read_bytes()
        except OSError as error:
            raise SourceError(f"cannot be read ({error.strerror})", where=path) from None
