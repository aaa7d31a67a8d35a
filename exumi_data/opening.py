"""``exumi_data.open``: a dataset, an episode's folder or a packed episode, here or at a URL."""

import os
from pathlib import Path

from exumi_data.dataset import DATASET_DOCUMENT, Dataset, is_unfinished, open_dataset, unfinished
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import NotAnEpisodeError, UsageError
from exumi_data.store.remote.address import is_url

__all__ = ["check_outside", "not_an_episode", "open"]


def open(path: str | os.PathLike[str]) -> Dataset | Episode:  # as in tarfile.open
    """Open a dataset or an episode for reading. Reading never writes.

    Parameters
    ----------
    path : path-like
        A dataset's folder, an episode's ``.zarr`` folder, or a packed ``.zarr.zip`` (which is
        always one episode, never a dataset). Or the URL of one, as text: ``s3://``, ``gs://``,
        ``az://``, ``https://`` (extra ``cloud``).

    Returns
    -------
    Dataset or Episode

    Raises
    ------
    NotAnEpisodeError
        Neither is there.
    MetadataError, UnsupportedError, DamagedDataError
        What is there cannot be read.
    UnreachableError
        The server of a URL does not answer, does not let us in, or cannot send parts of files.

    Examples
    --------
    >>> import exumi_data
    >>> ds = exumi_data.open("my-dataset")  # doctest: +SKIP
    >>> ds[0]["tactile_left"].frames[10].shape  # doctest: +SKIP
    (240, 320, 3)
    """
    text = os.fsdecode(path)
    if not text:
        raise NotAnEpisodeError("an empty path was given")
    if is_url(path):
        return _open_url(text)
    target = Path(text)
    try:
        is_folder = target.is_dir()
        is_dataset = is_folder and (target / DATASET_DOCUMENT).is_file()
        is_episode = not is_folder or (target / "zarr.json").is_file()
    except OSError as error:  # such as a name that is too long, or no permission
        raise NotAnEpisodeError(f"cannot be opened ({error.strerror})", where=text) from error
    if is_dataset:
        return open_dataset(text)
    if is_episode or target.name.endswith(".zarr"):
        return open_episode(text)
    raise not_an_episode(text)


def _open_url(url: str) -> Dataset | Episode:
    from exumi_data.store.remote.address import Address

    address = Address.parse(url)
    if not address.key.endswith((".zip", ".zarr")):
        try:
            return open_dataset(url)
        except NotAnEpisodeError:
            pass
    try:
        return open_episode(url)
    except NotAnEpisodeError as error:
        if address.key.endswith(".zip"):
            raise
        raise NotAnEpisodeError(
            "neither a dataset (no dataset.json) nor an episode (no zarr.json)",
            where=url,
            fix="Give the URL of the dataset's folder, or of a .zarr.zip.",
        ) from error


def not_an_episode(path: str) -> NotAnEpisodeError:
    """Return the error for a file or folder that is neither, with what to give instead.

    Parameters
    ----------
    path : str
        A file or folder that is there.
    """
    if is_unfinished(Path(path)):
        return unfinished(path)
    what = "neither a dataset (no dataset.json) nor an episode (no zarr.json)"
    fix = "Convert other data with: exumi convert SRC DST"
    if Path(path).is_file():
        what = "a file that is no packed episode (no zip)"
        fix = "Give the folder of the dataset or the episode, or a .zarr.zip."
    around = _around(Path(path))
    if around is not None:
        what = f"a part of {'an episode' if around.suffix == '.zarr' else 'a dataset'}"
        fix = f"Give all of it: {around}"
    return NotAnEpisodeError(what, where=path, fix=fix)


def check_outside(file: Path) -> None:
    """Refuse to write a file that is no part of the data into a dataset or an episode.

    Parameters
    ----------
    file : pathlib.Path
        Which is to be written.

    Raises
    ------
    UsageError
        It lies in one.
    """
    if _around(file.resolve()) is not None:
        raise UsageError(
            "lies inside the data, which would no longer be what it was",
            where=file,
            fix="Name a file outside of it.",
        )


def _around(path: Path) -> Path | None:
    """Return the episode or dataset that a path lies in."""
    for place in (*path.parents, *path.absolute().parents):
        is_episode = place.suffix == ".zarr" and (place / "zarr.json").is_file()
        if is_episode or (place / DATASET_DOCUMENT).is_file():
            return place
    return None
