"""The calibration file: items by name in JSON, their arrays in an ``.npz`` beside it.

``{"format": "exumi-calibration", "version": "1.0", "items": {name: item}, "arrays": {"file",
"sha256"}}``. The file of arrays has a part of its digest in its name and is written first: so the
JSON always names arrays that are there, whenever the power fails.
"""

import hashlib
import io
import json
import os
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from exumi_data.episode import CALIBRATION_PATH
from exumi_data.errors import DamagedDataError, LimitError, MetadataError, UsageError
from exumi_data.model.base import Identifier, Model, Sha256, Version
from exumi_data.model.description import CalibrationItem
from exumi_data.model.documents import check_version, dump, load_json, problems_of
from exumi_data.store.files import write_atomic

__all__ = [
    "Calibration",
    "array_path",
    "check_name",
    "merge",
    "read_calibration",
    "update",
    "write_calibration",
]

FORMAT = "exumi-calibration"

_MOST_ARRAY_BYTES = 256 << 20
_MOST_JSON_BYTES = 16 << 20
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*\.json")
_FIX = "Calibrate again, or restore the file."


class _Arrays(Model):
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*\.npz$")]
    sha256: Sha256


class _Document(Model):
    format: Literal["exumi-calibration"] = "exumi-calibration"
    version: Version = "1.0"
    items: dict[Identifier, CalibrationItem] = Field(default_factory=dict)
    arrays: _Arrays | None = None


@dataclass(frozen=True)
class Calibration:
    """Calibration items and their arrays.

    Attributes
    ----------
    items : dict of str to CalibrationItem
    arrays : dict of str to ndarray
        By the name of the item, for the items that have one.
    """

    items: dict[str, CalibrationItem] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        stated = {name for name, item in self.items.items() if item.array is not None}
        if stated != set(self.arrays):
            odd = sorted(stated ^ set(self.arrays))
            msg = f"items and arrays do not fit together: {', '.join(odd)}"
            raise ValueError(msg)


def array_path(name: str) -> str:
    """Return where the array of an item is in an episode.

    Parameters
    ----------
    name : str
        Of the item.

    Raises
    ------
    ValueError
        Names of items with arrays are lower-case letters, digits and ``_``, joined by ``/``.
    """
    path = f"calibration/{name}"
    if not CALIBRATION_PATH.fullmatch(path):
        msg = f"{name!r} cannot have an array: lower-case letters, digits, _ and / only"
        raise ValueError(msg)
    return path


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration file.

    Parameters
    ----------
    path : path-like
        The JSON file; its arrays lie beside it.

    Raises
    ------
    UsageError
        There is no such file.
    MetadataError
        It is no calibration file; all its problems are named.
    UnsupportedError
        It is of a newer version.
    DamagedDataError
        Its arrays are missing, or are not those that it was written with.
    LimitError
        It is larger than a calibration is.
    """
    place = Path(path)
    document = _document(place)
    arrays = {} if document.arrays is None else _read_arrays(place, document.arrays)
    try:
        return Calibration(document.items, arrays)
    except ValueError as error:
        raise DamagedDataError(str(error), where=place, fix=_FIX) from None


def _document(place: Path) -> _Document:
    try:
        if place.stat().st_size > _MOST_JSON_BYTES:
            raise LimitError(f"larger than {_MOST_JSON_BYTES:,} bytes", where=place)
        raw = place.read_bytes()
    except FileNotFoundError:
        raise UsageError("no such calibration file", where=place) from None
    except OSError as error:
        raise UsageError(f"cannot be read ({error.strerror})", where=place) from None
    value = load_json(raw, place)
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise MetadataError("holds half of a letter", where=place, fix=_FIX) from None
    newer = check_version(value, FORMAT, place)
    try:
        return _Document.model_validate(value, context={"newer_minor": newer})
    except ValidationError as error:
        problems = tuple(f"{message} @ {where}" for message, where in problems_of(error))
        raise MetadataError(
            "; ".join(problems), where=place, fix="Correct it.", problems=problems
        ) from None


def _read_arrays(place: Path, stated: _Arrays) -> dict[str, np.ndarray]:
    beside = place.with_name(stated.file)
    try:
        if beside.stat().st_size > _MOST_ARRAY_BYTES:
            raise LimitError(f"larger than {_MOST_ARRAY_BYTES:,} bytes", where=beside)
        raw = beside.read_bytes()
    except OSError as error:
        raise DamagedDataError(
            f"the arrays of {place.name} cannot be read ({error.strerror})", where=beside, fix=_FIX
        ) from None
    if hashlib.sha256(raw).hexdigest() != stated.sha256:
        raise DamagedDataError(
            f"not the arrays that {place.name} was written with", where=beside, fix=_FIX
        )
    try:
        _check_sizes(raw, beside)
        with np.load(io.BytesIO(raw), allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise DamagedDataError(f"no arrays ({error})", where=beside, fix=_FIX) from None


def _check_sizes(raw: bytes, where: Path) -> None:
    """Refuse a zip that grows beyond the limit when it is unpacked."""
    with zipfile.ZipFile(io.BytesIO(raw)) as file:
        if sum(member.file_size for member in file.infolist()) > _MOST_ARRAY_BYTES:
            raise LimitError(f"larger than {_MOST_ARRAY_BYTES:,} bytes unpacked", where=where)


def check_name(path: Path) -> None:
    """Refuse what is no name of a calibration file.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    UsageError
        It is none.
    """
    if not _NAME.fullmatch(path.name):
        raise UsageError(
            "no name for a calibration file",
            where=path,
            fix="It is letters, digits, ., _ and -, and ends in .json.",
        )


def write_calibration(path: str | os.PathLike[str], calibration: Calibration) -> Path:
    """Write a calibration file, whole or not at all; one that is there is replaced.

    Parameters
    ----------
    path : path-like
        Ends in ``.json``.
    calibration : Calibration

    Returns
    -------
    pathlib.Path

    Raises
    ------
    UsageError
        The name is none of a calibration file.
    """
    place = Path(path)
    check_name(place)
    stated = None
    if calibration.arrays:
        raw = _packed(calibration.arrays)
        digest = hashlib.sha256(raw).hexdigest()
        stated = _Arrays(file=f"{place.stem}-{digest[:16]}.npz", sha256=digest)
        write_atomic(place.with_name(stated.file), raw)
    document = dump(_Document(items=calibration.items, arrays=stated))
    write_atomic(place, f"{json.dumps(document, indent=2, allow_nan=False)}\n".encode())
    return place


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    ordered: dict[str, Any] = {name: arrays[name] for name in sorted(arrays)}
    np.savez_compressed(buffer, **ordered)
    return buffer.getvalue()


def update(path: str | os.PathLike[str], found: Calibration) -> Calibration:
    """Put items into a calibration file; it is made if it is not there.

    Parameters
    ----------
    path : path-like
    found : Calibration
        Items of the same names are replaced, the others stay.

    Returns
    -------
    Calibration
        All that is in the file now.

    Raises
    ------
    MetadataError, UnsupportedError, DamagedDataError, LimitError, UsageError
        As `read_calibration` and `write_calibration`.
    """
    place = Path(path)
    there = _document(place) if place.exists() else _Document()
    before = read_calibration(place) if place.exists() else Calibration()
    kept = {name: array for name, array in before.arrays.items() if name not in found.items}
    after = Calibration({**before.items, **found.items}, {**kept, **found.arrays})
    write_calibration(place, after)
    now = _document(place).arrays
    if there.arrays is not None and (now is None or now.file != there.arrays.file):
        place.with_name(there.arrays.file).unlink(missing_ok=True)
    return after


def merge(calibrations: Mapping[str, Calibration]) -> Calibration:
    """Put several calibrations together.

    Parameters
    ----------
    calibrations : mapping of str to Calibration
        By what they are called in errors, such as their paths.

    Returns
    -------
    Calibration

    Raises
    ------
    UsageError
        Two of them say different things of one item.
    """
    items: dict[str, CalibrationItem] = {}
    arrays: dict[str, np.ndarray] = {}
    told_by: dict[str, str] = {}
    for where, calibration in calibrations.items():
        for name, item in calibration.items.items():
            array = calibration.arrays.get(name)
            if name in items and not _same(items[name], arrays.get(name), item, array):
                raise UsageError(
                    f"{name!r} is another one in {told_by[name]}",
                    where=where,
                    fix="Name one of the two files, or remove the item that is out of date.",
                )
            items[name], told_by[name] = item, where
            if array is not None:
                arrays[name] = array
    return Calibration(items, arrays)


def _same(
    one: CalibrationItem,
    one_array: np.ndarray | None,
    other: CalibrationItem,
    other_array: np.ndarray | None,
) -> bool:
    if one_array is None or other_array is None:
        return one == other and one_array is other_array
    return one == other and np.array_equal(one_array, other_array)
