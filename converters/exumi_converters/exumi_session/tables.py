"""The hub's JSON files: stamps of frames; stamps, counts and poses."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exumi_data.errors import SourceError
from exumi_data.model.json_limits import MAX_LIST_PARTS, is_too_deep, size_mistake

__all__ = ["Readings", "read_angles", "read_stamps"]

_FIX = "Copy it again from the hub, or leave it out."
_LAST_S = 4e9  # the year 2096


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Poses and counts as the hub stamped them.

    Attributes
    ----------
    time_ns : (N,) int64
        Unix time, in the order of arrival.
    counts : (N,) int64
        Of the encoder; whatever was written.
    poses : (N, 7) float64
        x y z qx qy qz qw.
    """

    time_ns: NDArray[np.int64]
    counts: NDArray[np.int64]
    poses: NDArray[np.float64]

    def part(self, chosen: slice | NDArray[np.bool_]) -> "Readings":
        """Return some of them."""
        return Readings(self.time_ns[chosen], self.counts[chosen], self.poses[chosen])


def read_stamps(path: Path) -> NDArray[np.int64]:
    """Read when the frames of a chunk were taken.

    Parameters
    ----------
    path : pathlib.Path
        ``left_<N>.json``: a list of seconds.

    Returns
    -------
    (N,) int64
        Unix time, nanoseconds.

    Raises
    ------
    SourceError
        The file is none such.
    """
    return _nanoseconds(_numbers(_load(path), "stamps", (), path), path)


def read_angles(path: Path) -> Readings:
    """Read a chunk of counts and poses.

    Parameters
    ----------
    path : pathlib.Path
        ``angle_<N>.json``.

    Raises
    ------
    SourceError
        The file is none such, or its lists differ in length.
    """
    document = _load(path)
    if not isinstance(document, dict):
        raise SourceError("no object of angles, data and timestamps", where=path, fix=_FIX)
    lists = {name: document.get(name) for name in ("timestamps", "angles", "data")}
    stamps = _numbers(lists["timestamps"], "timestamps", (), path)
    counts = _numbers(lists["angles"], "angles", (1,), path)[:, 0]
    poses = _numbers(lists["data"], "data", (7,), path)
    if not len(stamps) == len(counts) == len(poses):
        raise SourceError(
            f"it has {len(stamps)} timestamps, {len(counts)} angles and {len(poses)} poses: which "
            "belong together is not known",
            where=path,
            fix=_FIX,
        )
    if not np.isfinite(counts).all() or (np.abs(counts) > 1e9).any():
        raise SourceError("its angles are no counts", where=path, fix=_FIX)
    return Readings(_nanoseconds(stamps, path), np.rint(counts).astype(np.int64), poses)


def _load(path: Path) -> Any:
    try:
        raw = path.read_bytes() if path.stat().st_size <= (64 << 20) else None
    except OSError as error:
        raise SourceError(f"cannot be read ({error.strerror})", where=path, fix=_FIX) from None
    mistake = "it is larger than 64 MiB" if raw is None else None
    mistake = mistake or size_mistake(raw or b"", most_parts=MAX_LIST_PARTS)
    if mistake or raw is None:
        raise SourceError(str(mistake), where=path, fix=_FIX)
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError) as error:
        what = "it is cut short or garbled" if isinstance(error, ValueError) else "too deep"
        raise SourceError(f"no JSON: {what} ({error})", where=path, fix=_FIX) from None
    if is_too_deep(value, raw):
        raise SourceError("no JSON of a hub: nested too deeply", where=path, fix=_FIX)
    return value


def _numbers(value: Any, what: str, row: tuple[int, ...], where: Path) -> NDArray[np.float64]:
    """Return a list of numbers, or of lists of as many, as (N, *row) float64."""
    if not isinstance(value, list):
        raise SourceError(f"it has no list of {what}", where=where, fix=_FIX)
    if not value:
        return np.empty((0, *row))
    try:
        found = np.array(value)
    except (ValueError, OverflowError):
        found = np.array([None])
    if found.dtype.kind not in "iuf" or found.shape[1:] != row:
        each = f"{row[0]} numbers each" if row else "numbers"
        raise SourceError(f"its {what} are not {each}", where=where, fix=_FIX)
    return found.astype(np.float64)


def _nanoseconds(seconds: NDArray[np.float64], where: Path) -> NDArray[np.int64]:
    if not ((seconds > 0) & (seconds < _LAST_S)).all():
        raise SourceError("its stamps are no Unix times", where=where, fix=_FIX)
    return np.rint(seconds * 1e9).astype(np.int64)
