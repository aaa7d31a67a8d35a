"""Paths inside stores and archives are checked before they are used."""

import re

from exumi_data.errors import DamagedDataError

__all__ = ["check_member_path"]

_MAX_LENGTH = 1024
# What nearly all paths are like: found to be safe in one step.
_PLAIN = re.compile(r"[A-Za-z0-9_][\w.-]*(?:/[A-Za-z0-9_][\w.-]*)*", re.ASCII)


def check_member_path(path: str, where: object) -> str:
    """Return `path` if it is safe: relative, ``/``-separated, without ``.`` or ``..`` parts.

    Parameters
    ----------
    path : str
        A path inside an episode or an archive.
    where : object
        The store, named in the error.

    Raises
    ------
    DamagedDataError
        The path could lead out of the store.
    """
    if len(path) <= _MAX_LENGTH and _PLAIN.fullmatch(path):
        return path
    parts = path.split("/")
    unsafe = (
        not path
        or len(path) > _MAX_LENGTH
        or path.startswith("/")
        or "\\" in path
        or "\0" in path
        or any(part in ("", ".", "..") for part in parts)
        or (len(path) > 1 and path[1] == ":")
        or any("\ud800" <= letter <= "\udfff" for letter in path)  # a name that is not UTF-8
    )
    if unsafe:
        raise DamagedDataError(
            f"unsafe path {path[:80]!r} inside the store",
            where=where,
            fix="Nothing was read from it. Do not unpack this file; get it again from its source.",
        )
    return path
