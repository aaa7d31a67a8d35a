"""The table beside a clip: one row a frame, columns recognised by their header.

==========================  =====================================================
``force_N``                 grip force, stream ``force``, component ``f_grip``
``fx_N fy_N fz_N``          force, newtons, stream ``wrench``
``tx_Nm ty_Nm tz_Nm``       torque, newton metres, stream ``wrench``
``width_m``                 gripper opening, metres, stream ``width``
``frame``                   0, 1, 2 ...: checked, not stored
==========================  =====================================================
"""

import csv
import math
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exumi_data.errors import SourceError

__all__ = ["ClipTable", "TableStream", "read_header", "read_table"]

_UNDERSTOOD = "frame, force_N, fx_N, fy_N, fz_N, tx_Nm, ty_Nm, tz_Nm, width_m"
_INDEX = "frame"
_MOST_BYTES = 64 << 20
# column -> (stream, kind, component)
_COLUMNS = {
    "force_N": ("force", "wrench", "f_grip"),
    "fx_N": ("wrench", "wrench", "fx"),
    "fy_N": ("wrench", "wrench", "fy"),
    "fz_N": ("wrench", "wrench", "fz"),
    "tx_Nm": ("wrench", "wrench", "tx"),
    "ty_Nm": ("wrench", "wrench", "ty"),
    "tz_Nm": ("wrench", "wrench", "tz"),
    "width_m": ("width", "width", None),
}
_FIX = "Mend the table, or take it away to convert the video alone."


@dataclass(frozen=True, slots=True)
class TableStream:
    """One stream of a table.

    Attributes
    ----------
    name, kind : str
    components : tuple of str
        Of a wrench, one a column.
    data : (N,) or (N, C) float64
        As the table says.
    """

    name: str
    kind: str
    components: tuple[str, ...]
    data: np.ndarray


@dataclass(frozen=True, slots=True)
class ClipTable:
    """A table, read and checked.

    Attributes
    ----------
    rows : int
    streams : tuple of TableStream
    dropped : tuple of str
        Columns that are not understood.
    rounded : tuple of str
        Columns whose numbers float32 does not hold to the last digit.
    """

    rows: int
    streams: tuple[TableStream, ...]
    dropped: tuple[str, ...]
    rounded: tuple[str, ...]


def read_header(path: Path) -> list[str]:
    """Return the columns' names.

    Raises
    ------
    SourceError
        The file cannot be read, or has no header.
    """
    return next(_rows(path))


def _rows(path: Path) -> Iterator[list[str]]:
    """Yield the header, checked, and the rows."""
    header = None
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise SourceError(f"the table is larger than {_MOST_BYTES >> 20} MiB", where=path)
        with path.open(newline="", encoding="utf-8-sig") as file:
            for cells in csv.reader(file, strict=True):
                if not any(cell.strip() for cell in cells):
                    continue
                row = [cell.strip() for cell in cells]
                if header is None:
                    header = row
                    _check_header(header, path)
                yield row
    except OSError as error:
        raise SourceError(f"cannot be read ({error.strerror})", where=path) from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise SourceError(f"not a CSV table in UTF-8 ({error})", where=path, fix=_FIX) from None
    if header is None:
        raise SourceError("the table is empty", where=path, fix=_FIX)


def _check_header(header: list[str], path: Path) -> None:
    separator = next((mark for mark in ";\t|" if mark in header[0]), None)
    if len(header) == 1 and separator is not None:
        raise SourceError(
            f"the columns are separated by {separator!r}, not by commas", where=path, fix=_FIX
        )
    twice = [name for name, count in Counter(header).items() if count > 1]
    if twice:
        raise SourceError(f"column {min(twice)!r} for the second time", where=path, fix=_FIX)


def unknown_columns(header: list[str]) -> list[str]:
    """Return the columns that are not understood."""
    return [name for name in header if name not in _COLUMNS and name != _INDEX]


def describe_unknown(columns: list[str]) -> str:
    """Say in one sentence what is wrong with columns that are not understood."""
    return (
        f"column(s) {', '.join(columns)} not converted: their kind or unit is not known. "
        f"Understood are: {_UNDERSTOOD}"
    )


def read_table(path: Path) -> ClipTable:
    """Read a table.

    Raises
    ------
    SourceError
        A row is malformed, a value is no finite number, or the frames are not numbered in order.
        Names line and column.
    """
    rows = _rows(path)
    header = next(rows)
    known = [name for name in header if name in _COLUMNS]
    columns = {name: array("d") for name in known}
    rounded, count = set(), 0
    for index, cells in enumerate(rows):
        count = index + 1
        where = f"{path}, row {index + 1}"
        if len(cells) != len(header):
            raise SourceError(
                f"{len(cells)} cells, the header has {len(header)}", where=where, fix=_FIX
            )
        row = dict(zip(header, cells, strict=True))
        if _INDEX in row and row[_INDEX] != str(index):
            raise SourceError(
                f"{_INDEX} is {row[_INDEX]!r}, expected {index}: rows are missing or in disorder",
                where=where,
                fix=_FIX,
            )
        for name in known:
            value = _number(row[name], name, where)
            columns[name].append(value)
            if not _survives_float32(row[name], value):
                rounded.add(name)
    return ClipTable(
        count,
        _streams(columns),
        tuple(unknown_columns(header)),
        tuple(name for name in known if name in rounded),
    )


def _number(text: str, column: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SourceError(f"{column} is {text!r}, not a number", where=where, fix=_FIX)
    return value


def _survives_float32(text: str, value: float) -> bool:
    """Whether float32 gives the same decimals again."""
    decimals = len(text.partition(".")[2]) if "e" not in text.lower() else None
    if decimals is None:
        return float(np.float32(value)) == value
    return f"{float(np.float32(value)):.{decimals}f}" == f"{value:.{decimals}f}"


def _streams(columns: Mapping[str, Sequence[float]]) -> tuple[TableStream, ...]:
    streams = []
    for stream in ("force", "wrench", "width"):
        names = [name for name in _COLUMNS if _COLUMNS[name][0] == stream and name in columns]
        if not names:
            continue
        kind = _COLUMNS[names[0]][1]
        components = tuple(c for name in names if (c := _COLUMNS[name][2]) is not None)
        data = np.array([columns[name] for name in names], dtype=np.float64).T
        streams.append(TableStream(stream, kind, components, data if components else data[:, 0]))
    return tuple(streams)
