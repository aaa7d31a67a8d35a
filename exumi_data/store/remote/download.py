"""A remote file, copied to the local disk."""

from pathlib import Path

from exumi_data.errors import NotAnEpisodeError
from exumi_data.store.remote.address import Address
from exumi_data.store.remote.reading import RemoteFile, reader

__all__ = ["download"]

_PIECE = 32 << 20


def download(url: str, target: Path) -> Path:
    """Copy a remote file; memory stays at some tens of MiB.

    Parameters
    ----------
    url : str
    target : pathlib.Path
        A new file. Of one that cannot be copied whole nothing stays.

    Returns
    -------
    pathlib.Path
        `target`.

    Raises
    ------
    NotAnEpisodeError
        There is nothing of that name.
    ChangedDataError
        It changed meanwhile.
    UnreachableError
        The server does not answer, does not let us in, or cannot send parts of files.
    """
    file = RemoteFile(Address.parse(url))
    try:
        size = file.identity.size
    except FileNotFoundError:
        raise NotAnEpisodeError("there is nothing of that name", where=url) from None
    try:
        with target.open("xb") as out:
            for start in range(0, size, _PIECE):
                out.write(reader().long(file, start, min(_PIECE, size - start)))
    except BaseException:
        target.unlink(missing_ok=True)
        raise
    return target
