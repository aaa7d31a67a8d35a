"""The digest of what a calibration was made from: so that it can be found again, and told apart."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from exumi_data.episode import open_episode
from exumi_data.store.digest import sha256_file

__all__ = ["digest_of_sources"]


def digest_of_sources(paths: Sequence[Path]) -> str | None:
    """Return one digest of files, episodes and folders.

    Parameters
    ----------
    paths : sequence of pathlib.Path

    Returns
    -------
    str or None
        Of a file its sha-256, of an episode its digest, of another folder that of the lines
        ``sha256 name`` of its files, sorted; of several the sha-256 of their digests, a line each.
        None of none.
    """
    found = [_digest(path) for path in paths]
    if not found:
        return None
    return found[0] if len(found) == 1 else _of_lines(found)


def _digest(path: Path) -> str:
    is_packed = path.name.endswith(".zarr.zip")
    if is_packed or (path / "zarr.json").exists():
        with open_episode(path) as episode:
            return episode.digest()
    if not path.is_dir():
        return sha256_file(path)
    files = {each.relative_to(path).as_posix(): each for each in path.rglob("*") if each.is_file()}
    return _of_lines([f"{sha256_file(file)} {name}" for name, file in sorted(files.items())])


def _of_lines(lines: Sequence[str]) -> str:
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()
