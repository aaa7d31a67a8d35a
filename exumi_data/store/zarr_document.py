"""The ``zarr.json`` of an array: the part of Zarr v3 that the format uses.

Writers make exactly these documents, and readers take no others. What they would have to trust in
other layouts has no bound: a chain of codecs makes terabytes of a kilobyte.
"""

import json
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from pydantic_core import to_json

from exumi_data.errors import DamagedDataError, ExumiError, LimitError, UnsupportedError

__all__ = [
    "DTYPES",
    "MAX_CHUNK_BYTES",
    "MAX_SHARD_BYTES",
    "MAX_WHOLE_READ",
    "ArrayDocument",
    "array_document",
    "layout_of",
    "parse_array",
]

DTYPES: frozenset[str] = frozenset(
    ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
) | frozenset(("float32", "float64"))
MAX_SHARD_BYTES = 64 << 20
MAX_CHUNK_BYTES = 256 << 20
MAX_WHOLE_READ = 2 << 30
"""Bytes of an array that are read at once."""
_MAX_CHUNKS = 1 << 26
_MAX_BYTES = 1 << 20
_MAX_KNOWN_BYTES = 4096


@dataclass(frozen=True, slots=True)
class ArrayDocument:
    """Shape and layout of one array.

    Only the first axis is divided into chunks and shards: the others lie whole in every chunk.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    chunk_rows: int
    """Rows of an inner chunk."""
    shard_rows: int
    """Rows of a shard, a multiple of `chunk_rows`."""
    zstd: bool
    dimension_names: tuple[str | None, ...] | None = None

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return math.prod(self.shape[1:]) * self.dtype.itemsize

    @property
    def chunk_bytes(self) -> int:
        """Bytes of one decoded inner chunk."""
        return self.chunk_rows * self.row_bytes

    @property
    def chunks_per_shard(self) -> int:
        """Inner chunks of a full shard."""
        return self.shard_rows // self.chunk_rows

    @property
    def shards(self) -> int:
        """Number of shard files."""
        return -(-self.shape[0] // self.shard_rows)

    @property
    def nbytes(self) -> int:
        """Bytes of the whole array in memory."""
        return self.shape[0] * self.row_bytes

    def shard_path(self, index: int) -> str:
        """Path of a shard file below the array's folder."""
        return "/".join(["c", str(index), *["0"] * (len(self.shape) - 1)])


def array_document(document: ArrayDocument) -> bytes:
    """Write the ``zarr.json`` of an array."""
    rest = list(document.shape[1:])
    inner: list[dict[str, Any]] = [{"name": "bytes", "configuration": {"endian": "little"}}]
    if document.dtype.itemsize == 1:
        inner = [{"name": "bytes"}]
    if document.zstd:
        inner.append({"name": "zstd", "configuration": {"level": 3, "checksum": True}})
    names = document.dimension_names
    fill: Any = False if document.dtype == np.bool_ else 0
    if document.dtype.kind == "f":
        fill = 0.0
    # An episode has ten of these: the same bytes as json.dumps gives, in a twentieth of its time.
    return (
        to_json(
            {
                "zarr_format": 3,
                "node_type": "array",
                "shape": list(document.shape),
                "data_type": document.dtype.name,
                "chunk_grid": {
                    "name": "regular",
                    "configuration": {"chunk_shape": [document.shard_rows, *rest]},
                },
                "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
                "fill_value": fill,
                "codecs": [
                    {
                        "name": "sharding_indexed",
                        "configuration": {
                            "chunk_shape": [document.chunk_rows, *rest],
                            "codecs": inner,
                            "index_codecs": [
                                {"name": "bytes", "configuration": {"endian": "little"}},
                                {"name": "crc32c"},
                            ],
                            "index_location": "end",
                        },
                    }
                ],
                "attributes": {},
                **({"dimension_names": list(names)} if names else {}),
            },
            indent=1,
        )
        + b"\n"
    )


def _sizes(value: object, where: object, what: str) -> tuple[int, ...]:
    if not isinstance(value, list) or not all(
        isinstance(item, int) and not isinstance(item, bool) and 0 <= item < 1 << 62
        for item in value
    ):
        raise DamagedDataError(f"{what} is not a list of sizes", where=where)
    return tuple(value)


def _codec_name(codec: object) -> str | None:
    return codec.get("name") if isinstance(codec, dict) else None


def _is_little(codec: dict[str, Any]) -> bool:
    return bool((codec.get("configuration") or {}).get("endian", "little") == "little")


def _foreign(what: str, where: object) -> UnsupportedError:
    return UnsupportedError(
        f"the array is stored in a layout that is not the standard's ({what})",
        where=where,
        fix="Read it with zarr.open_array, and write the episode again.",
    )


def parse_array(raw: bytes, where: object) -> ArrayDocument:
    """Parse the ``zarr.json`` of an array.

    Raises
    ------
    DamagedDataError
        Not an array document.
    LimitError
        A document larger than 1 MiB, an inner chunk larger than 256 MiB, or more than 2**26
        chunks: nothing we wrote.
    UnsupportedError
        A layout that is not the standard's.
    """
    if len(raw) > _MAX_BYTES:
        raise LimitError(f"a zarr.json of {len(raw):,} bytes", where=where)
    if len(raw) > _MAX_KNOWN_BYTES:
        return _parse(raw, where)
    try:
        return _parse_known(raw)
    except ExumiError as error:
        raise type(error)(error.what, where=where, fix=error.fix) from None


def _parse(raw: bytes, where: object) -> ArrayDocument:
    try:
        document = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise DamagedDataError(f"zarr.json is not valid JSON ({error})", where=where) from None
    return layout_of(document, where)


@lru_cache(maxsize=1024)
def _parse_known(raw: bytes) -> ArrayDocument:
    """Parse a small document; thousands of episodes have the same few."""
    return _parse(raw, None)


def layout_of(document: object, where: object) -> ArrayDocument:
    """Understand the ``zarr.json`` of an array, parsed. Raises as `parse_array` does."""
    if not isinstance(document, dict) or document.get("node_type") != "array":
        raise DamagedDataError("zarr.json does not describe an array", where=where)
    if document.get("zarr_format") != 3:  # Zarr v3
        raise DamagedDataError("not a Zarr v3 array", where=where)
    shape = _sizes(document.get("shape"), where, "shape")
    data_type = document.get("data_type")
    if not isinstance(data_type, str) or data_type not in DTYPES or not shape:
        raise _foreign(f"data type {str(data_type)[:40]!r}, shape {list(shape[:8])}", where)
    dtype = np.dtype(data_type).newbyteorder("<")
    try:
        grid = _sizes(document["chunk_grid"]["configuration"]["chunk_shape"], where, "chunk_shape")
        (codec,) = document["codecs"]
        separator = document["chunk_key_encoding"].get("configuration", {}).get("separator", "/")
        if _codec_name(codec) != "sharding_indexed" or separator != "/":
            raise _foreign("it is not sharded", where)
        configuration = codec["configuration"]
        inner = _sizes(configuration["chunk_shape"], where, "chunk_shape")
        codecs = configuration["codecs"]
        index_codecs = [_codec_name(item) for item in configuration["index_codecs"]]
        location = configuration.get("index_location", "end")
        names = document.get("dimension_names")
        chain = [_codec_name(item) for item in codecs]
        little = _is_little(codecs[0]) and _is_little(configuration["index_codecs"][0])
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):
        raise _foreign("codecs or chunk grid", where) from None
    standard = (
        location == "end"
        and index_codecs == ["bytes", "crc32c"]
        and chain in (["bytes"], ["bytes", "zstd"])
        and little
        and document["chunk_key_encoding"].get("name") == "default"
        and document["chunk_grid"].get("name") == "regular"
        and document.get("storage_transformers") in (None, [])
        and len(grid) == len(inner) == len(shape)
        and grid[1:] == inner[1:] == shape[1:]
        and min(inner) > 0
        and grid[0] > 0
        and grid[0] % inner[0] == 0
    )
    if not standard:
        raise _foreign("codecs or chunk grid", where)
    parsed = ArrayDocument(
        shape,
        dtype,
        inner[0],
        grid[0],
        chain[-1] == "zstd",
        tuple(names) if isinstance(names, list) else None,
    )
    if parsed.chunk_bytes > MAX_CHUNK_BYTES:
        raise LimitError(f"a chunk of {parsed.chunk_bytes:,} bytes", where=where)
    if parsed.chunks_per_shard > _MAX_CHUNKS or parsed.shards > _MAX_CHUNKS:
        raise LimitError("too many chunks", where=where)
    return parsed
