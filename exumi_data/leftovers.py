"""What a command that was killed while it wrote into a dataset left behind.

An episode is written under ``.partial-<id>`` and takes its place by two renames: the old one waits
under ``.replaced-<name>`` meanwhile (see `exumi_data.store.files.replace_folder`).
"""

import os
import shutil
import time
from pathlib import Path

from exumi_data.catalog import EPISODES_FOLDER
from exumi_data.errors import UsageError
from exumi_data.store.files import claim_folder

__all__ = ["clean_leftovers", "settle"]

_PARTIAL = ".partial-"
_REPLACED = ".replaced-"
_PATIENCE_S = 60.0  # a worker whose run was killed finishes the episode it is at


def clean_leftovers(root: Path) -> list[str]:
    """Remove what a killed run left half-written, and bring back what it had put aside.

    Parameters
    ----------
    root : pathlib.Path
        The dataset. No other process may be writing into it: see `exumi_data.destination.only_run`.

    Returns
    -------
    list of str
        What was done, for the report.
    """
    removed, restored = _remove_files(root), 0
    for folder in sorted((root / EPISODES_FOLDER).glob("*/")):
        for path in sorted(folder.glob(f"{_REPLACED}*")):
            restored += settle(path.with_name(path.name.removeprefix(_REPLACED)))
        for path in sorted(folder.glob(f"{_PARTIAL}*")):
            removed += _give_up(path)
    notices = []
    if removed:
        notices.append(f"{removed} half-written episode(s) of an earlier run were removed")
    if restored:
        notices.append(f"{restored} episode(s) that an earlier run had put aside were brought back")
    return notices


def settle(path: Path) -> bool:
    """Bring an episode back that was put aside, or remove what its replacement left.

    Parameters
    ----------
    path : pathlib.Path
        The episode's name, whether there is one or not.

    Returns
    -------
    bool
        Whether it was brought back.
    """
    aside = path.parent / f"{_REPLACED}{path.name}"
    if not path.name.endswith(".zarr") or not aside.exists():
        return False
    if not path.exists():
        # The command died between two renames: this is the last complete state.
        aside.rename(path)
        return True
    _remove(aside)
    return False


def _remove_files(root: Path) -> int:
    """Remove documents and packed episodes that were never finished."""
    found = [
        path
        for pattern in (f"{_PARTIAL}*", f"splits/{_PARTIAL}*", f"{EPISODES_FOLDER}/*/{_PARTIAL}*")
        for path in root.glob(pattern)
        if path.is_file()
    ]
    for path in found:
        path.unlink(missing_ok=True)
    return len(found)


def _give_up(path: Path) -> int:
    """Remove a half-written episode, once no worker of a killed run is busy with it any more."""
    deadline = time.monotonic() + _PATIENCE_S
    while path.is_dir():
        try:
            claim = claim_folder(path)
        except UsageError:
            if time.monotonic() > deadline:
                return 0
            time.sleep(0.02)
            continue
        shutil.rmtree(path)
        os.close(claim)
        return 1
    return 0


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
