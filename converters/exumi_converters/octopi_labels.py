"""Labels of PhysiCLeAR objects: a CSV with one row a part, or the ``data.json`` of a sample.

Columns of the CSV: ``part_id`` (with or without the prefix ``physiclear_``), and any of ``object``,
``part``, ``name``, ``material``, ``hardness_0_10``, ``roughness_0_10``, ``hardness_class``,
``roughness_class``, ``bumpiness_class``, ``adjectives`` (separated by ``|``), ``split_octopi1``,
``split_octopi15``. An empty cell means: not known.
"""

import csv
import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exumi_converters.source_folder import may_be_read
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import Label

__all__ = ["PartLabels", "SampleDocument", "bare_id", "read_labels", "read_sample_document", "slug"]

_PREFIX = "physiclear_"
_NUMBERS = {"hardness_0_10": "hardness", "roughness_0_10": "roughness"}
_SCALE = [0.0, 10.0]
_CLASSES = {
    "hardness_class": "hardness_class",
    "roughness_class": "roughness_class",
    "bumpiness_class": "bumpiness_class",
    "material": "material",
}
_SPLITS = {"split_octopi1": "octopi1", "split_octopi15": "octopi15"}
_TEXT = ("object", "part", "name")
_KNOWN = ("part_id", *_TEXT, *_NUMBERS, *_CLASSES, "adjectives", *_SPLITS)
# PhysiCLeAR's own, and nobody else's: its parts are named in Octopi's published splits.
_RATING_ORIGIN = "mean of about three raters"
_MOST_BYTES = 1 << 20  # of a data.json
_FIX = "Mend the table, or leave out --labels."


@dataclass(frozen=True, slots=True)
class PartLabels:
    """What is known of one part.

    Attributes
    ----------
    part_id : str
    object, part : str or None
        In words: "a hairbrush", "handle".
    labels : tuple of Label
    splits : dict of str to str
        Published split to the list that the part is in.
    """

    part_id: str
    object: str | None = None
    part: str | None = None
    labels: tuple[Label, ...] = ()
    splits: dict[str, str] = field(default_factory=dict)

    @property
    def object_id(self) -> str | None:
        """Identifier of the object: the same for all of its parts; None if it is not known."""
        return None if self.object is None else slug(self.object)


def slug(text: str) -> str:
    """Make an identifier from words: ``a TV remote`` becomes ``a_tv_remote``."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def bare_id(part_id: str) -> str:
    """Return a part id without the prefix that Octopi's own tables put before it."""
    return part_id.removeprefix(_PREFIX)


def read_labels(path: Path) -> tuple[dict[str, PartLabels], list[str]]:
    """Read a table of labels.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    labels : dict of str to PartLabels
        By part id, without the prefix ``physiclear_``.
    notices : list of str
        Columns that are not understood.

    Raises
    ------
    UsageError
        The table cannot be read, lacks ``part_id``, or has a malformed row.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file, strict=True))
    except OSError as error:
        raise UsageError(
            f"the table of labels cannot be read ({error.strerror})", where=path
        ) from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise UsageError(f"not a CSV table in UTF-8 ({error})", where=path, fix=_FIX) from None
    header = [name.strip() for name in rows[0]] if rows else []
    _check_header(header, path)
    labels: dict[str, PartLabels] = {}
    for number, cells in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in cells):
            continue
        where = f"{path}, line {number}"
        if len(cells) != len(header):
            raise UsageError(
                f"{len(cells)} cells, the header has {len(header)}", where=where, fix=_FIX
            )
        row = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}
        entry = _entry(row, path, where)
        if entry.part_id in labels:
            raise UsageError(
                f"part id {entry.part_id!r} for the second time", where=where, fix=_FIX
            )
        labels[entry.part_id] = entry
    unknown = [name for name in header if name not in _KNOWN]
    notices = []
    if unknown:
        notices.append(
            f"{path.name}: not converted, because their meaning is not known: column(s) "
            f"{', '.join(unknown)}"
        )
    return labels, notices


def _check_header(header: list[str], path: Path) -> None:
    if "part_id" not in header:
        found = ", ".join(header) or "nothing"
        raise UsageError(
            f"the table has no column part_id; its header has: {found}",
            where=path,
            fix=f"Known columns: {', '.join(_KNOWN)}.",
        )
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise UsageError(f"column {twice[0]!r} for the second time", where=path, fix=_FIX)


def _entry(row: dict[str, str], path: Path, where: str) -> PartLabels:
    part_id = bare_id(row["part_id"])
    if not part_id:
        raise UsageError("the row has no part id", where=where, fix=_FIX)
    words = {name: row.get(name) or None for name in _TEXT}
    published = any(row.get(column) for column in _SPLITS)
    origin = f"{path.name}: {_RATING_ORIGIN}" if published else path.name
    labels = []
    for column, name in _NUMBERS.items():
        if row.get(column):
            value = _rating(row[column], column, where)
            labels.append(_rating_label(name, value, origin))
    for column, name in _CLASSES.items():
        if row.get(column):
            labels.append(_label(name, row[column], path.name))
    if row.get("adjectives"):
        adjectives = [word.strip() for word in row["adjectives"].split("|") if word.strip()]
        labels.append(_label("adjectives", adjectives, path.name))
    return PartLabels(
        part_id,
        object=words["object"],
        part=words["part"] or words["name"],
        labels=tuple(labels),
        splits={name: row[column] for column, name in _SPLITS.items() if row.get(column)},
    )


def _rating(text: str, column: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not _SCALE[0] <= value <= _SCALE[1]:
        raise UsageError(f"{column} is {text!r}, not a number from 0 to 10", where=where, fix=_FIX)
    return value


def _label(name: str, value: str | list[str], origin: str) -> Label:
    return Label(property=name, value=value, provenance="human", origin=origin)


def _rating_label(name: str, value: float, origin: str) -> Label:
    # How many rated is not in the data ("about three"), so `raters` stays open.
    return Label(property=name, value=value, scale=list(_SCALE), provenance="human", origin=origin)


@dataclass(frozen=True, slots=True)
class SampleDocument:
    """What a processed sample says of itself.

    Attributes
    ----------
    object_id : str
        Octopi's own: ``physiclear_<part id>``, ``hardness_...`` or ``objectfolder_<n>``.
    labels : PartLabels
    procedure, tactile_path : str or None
    """

    object_id: str
    labels: PartLabels
    procedure: str | None
    tactile_path: str | None


def read_sample_document(path: Path) -> SampleDocument:
    """Read a sample's ``data.json``.

    Raises
    ------
    SourceError
        It is not what Octopi-1.5 writes.
    """
    if not may_be_read(path):
        raise SourceError("is no ordinary file", where=path)
    try:
        with path.open("rb") as file:
            raw = file.read(_MOST_BYTES + 1)
        if len(raw) > _MOST_BYTES:
            raise SourceError("is larger than 1 MiB", where=path)
        document = json.loads(raw)
    except (OSError, ValueError, RecursionError) as error:
        raise SourceError(f"cannot be read ({error})", where=path) from None
    if not isinstance(document, dict) or not _is_text(document.get("object_id")):
        raise SourceError("no object_id: not the data.json of an Octopi-1.5 sample", where=path)
    properties = document.get("properties") or {}
    if not isinstance(properties, dict):
        raise SourceError("`properties` is no JSON object", where=path)
    object_id: str = document["object_id"]
    published = object_id.startswith("physiclear_")
    origin = f"data.json: {_RATING_ORIGIN}" if published else "data.json"
    labels = tuple(
        _rating_label(name, _sample_rating(properties[name], name, path), origin)
        for name in _NUMBERS.values()
        if properties.get(name) is not None
    )
    split = _optional_text(document, "split")
    return SampleDocument(
        object_id,
        PartLabels(
            bare_id(object_id),
            part=_optional_text(document, "object"),
            labels=labels,
            splits={"octopi15": split} if split else {},
        ),
        _optional_text(document, "exploratory_procedure"),
        _optional_text(document, "tactile_path"),
    )


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _optional_text(document: dict[str, Any], key: str) -> str | None:
    value = document.get(key)
    return value.strip() if isinstance(value, str) and value.strip() else None


def _sample_rating(value: Any, name: str, path: Path) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not _SCALE[0] <= value <= _SCALE[1]:
        raise SourceError(f"{name} is {value!r}, not a number from 0 to 10", where=path)
    return float(value)
