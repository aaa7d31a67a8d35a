"""What an array of Zarr v2 says of itself: its ``.zarray``, read and checked."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from exumi_converters.zarr2_files.chunk_codecs import check_codec, check_filters
from exumi_data.errors import LimitError, SourceError, UnsupportedError

__all__ = ["MAX_CHUNK", "MAX_DOCUMENT", "MAX_ROWS", "ArrayMeta", "load_json", "parse_array"]

MAX_DOCUMENT = 1 << 20
"""Most bytes of a ``.zarray``."""
MAX_CHUNK = 1 << 28
"""Most bytes of a chunk, and of all chunks of a row, decoded."""
MAX_ROWS = 1 << 40
_MAX_PIECES = 4096
_KINDS = "biufSU"


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayMeta:
    """A ``.zarray`` document.

    Attributes
    ----------
    path : str
        Within the store, such as ``data/camera0_rgb``.
    shape, chunks : tuple of int
    dtype : numpy.dtype
    order : str
        ``C`` or ``F``: of the numbers in a chunk.
    compressor : mapping or None
    filters : list of mapping or None
    separator : str
        Between the numbers of a chunk's name.
    fill_value : int, float, str or None
        What a chunk that is not stored holds throughout.
    """

    path: str
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[Any]
    order: str
    compressor: Mapping[str, Any] | None
    filters: list[Mapping[str, Any]] | None
    separator: str
    fill_value: Any = None

    @property
    def name(self) -> str:
        """The last part of its path."""
        return self.path.rpartition("/")[2]

    @property
    def codec(self) -> str | None:
        """Id of its compressor."""
        return None if self.compressor is None else str(self.compressor.get("id"))

    @property
    def row_bytes(self) -> int:
        """Bytes of one row, decoded."""
        return math.prod(self.shape[1:]) * self.dtype.itemsize

    def pieces(self) -> list[tuple[int, ...]]:
        """Return the numbers, but the first, of the chunks that a row lies in."""
        ranges = (
            range(-(-size // chunk))
            for size, chunk in zip(self.shape[1:], self.chunks[1:], strict=True)
        )
        return list(product(*ranges))

    def chunk_name(self, row: int, piece: tuple[int, ...]) -> str:
        """Return a chunk's name within the array."""
        return self.separator.join(map(str, (row, *piece)))


def parse_array(raw: bytes, path: str, where: object) -> ArrayMeta:
    """Read a ``.zarray`` document.

    Parameters
    ----------
    raw : bytes
    path : str
        Of the array, within the store.
    where : object
        Named in errors.

    Raises
    ------
    SourceError, UnsupportedError, LimitError
        It is damaged, is of a kind that is not read, or asks for too much memory.
    """
    try:
        document: Any = load_json(raw) if len(raw) <= MAX_DOCUMENT else None
        dtype = document["dtype"]
        if document["zarr_format"] != 2 or not isinstance(dtype, str):
            raise KeyError("zarr_format or dtype")
        meta = ArrayMeta(
            path=path,
            shape=_numbers(document["shape"]),
            chunks=_numbers(document["chunks"]),
            dtype=np.dtype("V1" if "O" in dtype else dtype),
            order=document.get("order", "C"),
            compressor=_codec(document.get("compressor")),
            filters=[_codec(value or 0) for value in document.get("filters") or []] or None,
            separator=document.get("dimension_separator", "."),
            fill_value=document.get("fill_value"),
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise SourceError(
            f"its .zarray is damaged ({type(error).__name__}: {error})",
            where=where,
            fix="Get the file again from its source.",
        ) from None
    _check(meta, dtype, where)
    return meta


def load_json(raw: bytes) -> Any:
    """Return JSON values, among which no number is infinite or none.

    Raises
    ------
    ValueError, RecursionError
        It is none.
    """
    value = json.loads(raw)
    json.dumps(value, allow_nan=False)  # Python's reader takes NaN and 1e999 for numbers
    return value


def _numbers(value: object) -> tuple[int, ...]:
    if not isinstance(value, list) or any(
        isinstance(n, bool) or not isinstance(n, int) or not 0 <= n <= MAX_ROWS for n in value
    ):
        raise ValueError("shape")
    return tuple(value)


def _codec(value: Any) -> Any:
    if value is not None and not isinstance(value, dict):
        raise TypeError(f"a codec is {str(value)[:80]!r}")
    return value


def _check(meta: ArrayMeta, dtype: str, where: object) -> None:
    if "O" in dtype:
        raise UnsupportedError(
            "it holds Python objects (pickles), which are never loaded from a file",
            where=where,
            fix="Write the array again as numbers, with the program that made it.",
        )
    same = len(meta.shape) == len(meta.chunks) >= 1 and all(meta.chunks)
    if meta.dtype.kind not in _KINDS or not same or meta.order not in ("C", "F"):
        raise UnsupportedError(
            f"an array of {dtype}, shape {meta.shape}, chunks {meta.chunks} is not read",
            where=where,
        )
    if meta.separator not in (".", "/"):
        raise UnsupportedError("its chunks are named in an unknown way", where=where)
    size = math.prod(meta.chunks) * meta.dtype.itemsize
    block = meta.chunks[0] * meta.row_bytes
    if size > MAX_CHUNK or block > MAX_CHUNK or len(meta.pieces()) > _MAX_PIECES:
        raise LimitError(
            f"a chunk of {max(size, block):,} bytes, or a row of too many",
            where=where,
            fix="Write the array again with smaller chunks.",
        )
    check_codec(meta.compressor, where)
    check_filters(meta.filters, where)
