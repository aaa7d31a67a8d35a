"""Where a demonstration is written: all of it, or nothing."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from exumi_data.demo.dataset import clear_earlier
from exumi_data.errors import UsageError

__all__ = ["DemoFolder", "demo_folder"]


@dataclass(frozen=True, slots=True)
class DemoFolder:
    """Paths of a demonstration.

    Attributes
    ----------
    dataset, training, picture : pathlib.Path
    """

    dataset: Path
    training: Path
    picture: Path


@contextmanager
def demo_folder(out: Path) -> Iterator[DemoFolder]:
    """Make room for a demonstration; if the block fails, nothing of it is left.

    Parameters
    ----------
    out : pathlib.Path
        An earlier demonstration there is removed.

    Raises
    ------
    UsageError
        It holds data that the demonstration did not make.
    """
    folder = DemoFolder(out / "dataset", out / "training", out / "contact-sheet.png")
    datasets = (folder.dataset, folder.training)
    for root in datasets:
        if clear_earlier(root):
            folder.picture.unlink(missing_ok=True)
        _check_free(root)
    is_new = not out.exists()
    try:
        yield folder
    except BaseException:
        for root in datasets:
            shutil.rmtree(root, ignore_errors=True)
        if is_new:
            with suppress(OSError):
                out.rmdir()
        raise


def _check_free(root: Path) -> None:
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise UsageError(
            "holds something that the demonstration did not make",
            where=root,
            fix="Name another folder with --out.",
        )
