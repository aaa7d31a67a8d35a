"""What an index knows of each of its vectors: a Parquet table beside them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.store.files import atomic_file

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Entry", "Provenance", "entry_of", "group_codes", "read_entries", "write_entries"]

Provenance = Literal["human", "model"]

_MOST_LETTERS = 1000
_MOST_WORDS = 200
_MOST_ORIGINS = 10_000
_ROWS = 65_536  # written at a time


@dataclass(frozen=True)
class Entry:
    """What was touched, of one vector.

    Attributes
    ----------
    id : str
        ``<episode>/<stream>`` of a clip, ``taught/<uuid>`` of what was taught.
    name : str
        Of the object, in words where they are known.
    object_id, part_id, part : str or None
        Ids, and the part in words.
    sensor_model, pad_type : str or None
    adjectives : tuple of str
    labels : dict of str to float
        Ratings from 0 to 10.
    provenance : {"human", "model"}
        Who says so.
    taught : bool
        Whether it was taught, or built from a dataset.
    clips : int
        How many clips the vector is the average of.
    origins : tuple of str
        What the clips can be told by, see `identities`.
    """

    id: str
    name: str
    object_id: str | None = None
    part_id: str | None = None
    part: str | None = None
    sensor_model: str | None = None
    pad_type: str | None = None
    adjectives: tuple[str, ...] = ()
    labels: dict[str, float] = field(default_factory=dict)
    provenance: Provenance = "human"
    taught: bool = False
    clips: int = 1
    origins: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise UsageError("an entry needs a name")
        if self.provenance not in ("human", "model"):
            raise UsageError(f"invalid provenance ({self.provenance[:40]!r}) of an entry")
        if not all(0 <= value <= 10 for value in self.labels.values()):
            raise UsageError(f"labels are from 0 to 10, not {self.labels}", where=self.id)
        words = (self.id, self.name, *self.adjectives, *self.labels)
        words += tuple(w for w in (self.object_id, self.part_id, self.part) if w is not None)
        many = len(words) > _MOST_WORDS or len(self.origins) > _MOST_ORIGINS
        words += self.origins
        if many or any(len(word) > _MOST_LETTERS for word in words):
            raise UsageError(
                f"an entry has at most {_MOST_WORDS} words of {_MOST_LETTERS} letters, and is told "
                f"by at most {_MOST_ORIGINS}",
                where=self.name[:40],
            )
        if any("\ud800" <= letter <= "\udfff" for word in words for letter in word):
            raise UsageError("a word is not valid Unicode", where=self.id)


def _schema() -> "pa.Schema":
    import pyarrow as pa  # slow to import

    text = pa.string()
    rating = pa.struct([("property", text), ("value", pa.float64())])
    return pa.schema(
        [
            pa.field("id", text, nullable=False),
            pa.field("name", text, nullable=False),
            *(pa.field(name, text) for name in ("object_id", "part_id", "part")),
            *(pa.field(name, text) for name in ("sensor_model", "pad_type")),
            pa.field("adjectives", pa.list_(text), nullable=False),
            pa.field("labels", pa.list_(rating), nullable=False),
            pa.field("provenance", text, nullable=False),
            pa.field("taught", pa.bool_(), nullable=False),
            pa.field("clips", pa.int64(), nullable=False),
            pa.field("origins", pa.list_(text), nullable=False),
        ]
    )


def write_entries(path: Path, entries: Sequence[Entry]) -> None:
    """Write a table of entries, whole or not at all.

    Parameters
    ----------
    path : pathlib.Path
    entries : sequence of Entry
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with (
        atomic_file(path) as temporary,
        pq.ParquetWriter(
            temporary, _schema(), compression="zstd", write_page_checksum=True
        ) as writer,
    ):
        for start in range(0, len(entries), _ROWS):
            rows = [_row(entry) for entry in entries[start : start + _ROWS]]
            writer.write_table(pa.Table.from_pylist(rows, schema=_schema()))


def _row(entry: Entry) -> dict[str, Any]:
    row = {field.name: getattr(entry, field.name) for field in fields(entry)}
    row["labels"] = [{"property": key, "value": value} for key, value in entry.labels.items()]
    return row


def read_entries(path: Path, rows: int) -> "pa.Table":
    """Read a table of entries.

    Parameters
    ----------
    path : pathlib.Path
    rows : int
        How many there must be.

    Returns
    -------
    pyarrow.Table

    Raises
    ------
    DamagedDataError
        It is missing, damaged, of another schema, or asks for more memory than it may.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from exumi_data.store.parquet_limits import footer_mistake, pages_mistake
    from exumi_data.store.plain_files import is_plain_file

    if not is_plain_file(path):
        raise DamagedDataError("the table of entries is missing", where=path)
    try:
        mistake = footer_mistake(path)
        if mistake is None:
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                mistake = pages_mistake(path, file.metadata)
                if mistake is None:
                    table = file.read()
                    table.validate(full=True)
    except (pa.ArrowException, OSError, ValueError) as error:
        mistake = str(error).partition("\n")[0]
    if mistake is not None:
        raise DamagedDataError(f"cannot be read: {mistake}", where=path)
    if not table.schema.equals(_schema()) or table.num_rows != rows or _has_holes(table):
        raise DamagedDataError("is no table of so many entries", where=path)
    return table


def _has_holes(table: "pa.Table") -> bool:
    """Whether a word, a label or its value is missing in a list."""
    lists = [
        chunk.flatten()
        for name in ("adjectives", "labels", "origins")
        for chunk in table.column(name).chunks
    ]
    pairs = [values.flatten() for values in lists if values.type.num_fields]
    return any(values.null_count for values in (*lists, *chain(*pairs)))


def entry_of(row: dict[str, Any]) -> Entry:
    """Make an entry of a row of the table.

    Raises
    ------
    DamagedDataError
        It is none that could have been written.
    """
    known = {**row, "adjectives": tuple(row["adjectives"]), "origins": tuple(row["origins"])}
    known["labels"] = {label["property"]: label["value"] for label in row["labels"]}
    try:
        return Entry(**known)
    except UsageError as error:
        raise DamagedDataError(f"an entry is damaged: {error.what}", where=error.where) from None


def group_codes(tables: Sequence["pa.Table"], unique: str) -> np.ndarray:
    """Give numbers to objects (by name) or to parts (by part id; where there is none, by name).

    Parameters
    ----------
    tables : sequence of pyarrow.Table
    unique : {"object", "part"}

    Returns
    -------
    (N,) int
        Of each row of the tables, one after the other.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    if not tables:
        return np.empty(0, dtype=np.int64)
    columns = []
    for table in tables:
        name = table.column("name")
        # An id and a name that are the same word are not the same group.
        part = pc.binary_join_element_wise("part", table.column("part_id"), "/")
        columns.append(name if unique == "object" else pc.coalesce(part, name))
    chunks = [chunk for column in columns for chunk in column.chunks]
    values = pa.chunked_array(chunks, pa.string()).combine_chunks()
    return np.asarray(values.dictionary_encode().indices.to_numpy(zero_copy_only=False))
