"""Walking a source: every file is either converted or named."""

import os
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from exumi_converters.identity import relative_name
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.errors import SourceError

__all__ = ["count_names", "may_be_read", "source_files"]

_NAMED = 5


def source_files(root: Path) -> Iterator[Path]:
    """Yield all files below a folder, in a stable order.

    Hidden files and folders are passed over, and so are exUMI datasets (the destination may lie
    inside the source), pipes, sockets and devices: reading these may never end.

    Raises
    ------
    SourceError
        There is no such folder.
    """
    if not root.is_dir():
        raise SourceError(
            "not a folder" if root.exists() else "no such folder",
            where=root,
            fix="Name the folder that holds the recordings.",
        )
    seen: set[tuple[int, int]] = set()
    # Data is often linked in from another disk; a link to a folder above must not be followed
    # for ever.
    for folder, folders, files in os.walk(root, followlinks=True):
        info = os.stat(folder)  # noqa: PTH116  # os.walk gives strings
        if (info.st_dev, info.st_ino) in seen or (
            DATASET_DOCUMENT in files and folder != str(root)
        ):
            folders.clear()
            continue
        seen.add((info.st_dev, info.st_ino))
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            path = Path(folder, name)
            if not name.startswith(".") and may_be_read(path):
                yield path


def may_be_read(path: Path) -> bool:
    """Whether a file is an ordinary one, or a link to nothing: that fails by its name."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return True


def count_names(what: str, root: Path, paths: Sequence[Path]) -> str:
    """Say how many files there are of a sort, and name the first few."""
    named = ", ".join(relative_name(path, root) for path in paths[:_NAMED])
    more = ", ..." if len(paths) > _NAMED else ""
    return f"{len(paths)} {what}: {named}{more}"
