"""Spoiling arrays: the index of a shard with its checksum made right again, or the values."""

import json
import math
from random import Random
from typing import Any

import numpy as np
from numcodecs.zstd import Zstd

from exumi_data.store.shards import crc32c
from exumi_data.store.zarr_document import ArrayDocument, layout_of
from tests.fuzz.spoil_bytes import spoil_word
from tests.fuzz.stores import Draft

__all__ = ["arrays_of", "spoil_index", "spoil_values"]

EXTREMES = (0, 1, -1, 2, 127, 255, 65535, 1 << 31, (1 << 63) - 1, -(1 << 63), 1 << 62, 10**9)
FLOATS = (0.0, -0.0, 1e-320, 1e308, -1e308, math.nan, math.inf, -math.inf, 1.0, -1.0, 1e-9)


def arrays_of(draft: Draft) -> list[str]:
    """Return the paths of arrays in the standard layout whose first shard is there."""
    found = []
    for path in draft.paths("/zarr.json"):
        array = path.removesuffix("/zarr.json")
        document = _document(draft, array)
        if document is not None and f"{array}/{document.shard_path(0)}" in draft.files:
            found.append(array)
    return found


def _document(draft: Draft, array: str) -> ArrayDocument | None:
    try:
        return layout_of(json.loads(draft.data(f"{array}/zarr.json")), array)
    except Exception:  # noqa: BLE001  # it was spoiled before
        return None


def _shard(draft: Draft, array: str) -> tuple[ArrayDocument, str, bytes] | None:
    document = _document(draft, array)
    if document is None:
        return None
    path = f"{array}/{document.shard_path(0)}"
    data = draft.files.get(path)
    length = document.chunks_per_shard * 16 + 4
    if not isinstance(data, bytes) or len(data) < length or document.chunks_per_shard > 10_000:
        return None
    return document, path, data


def spoil_index(draft: Draft, array: str, random: Random) -> str:
    """Change a shard's index; half of the time its checksum is right."""
    found = _shard(draft, array)
    if found is None:
        return "nothing"
    document, path, data = found
    at = len(data) - document.chunks_per_shard * 16 - 4
    body, index = data[:at], data[at:-4]
    for _ in range(random.choice((1, 1, 2, 8))):
        index = spoil_word(index, random, 0, len(index))
    checksum = crc32c(index).to_bytes(4, "little")
    if random.random() < 0.3:
        checksum = random.randbytes(4)
    draft.files[path] = body + index + checksum
    return f"index of {path}"


def _values(document: ArrayDocument, data: bytes) -> np.ndarray:
    """Decode the first shard."""
    at = len(data) - document.chunks_per_shard * 16 - 4
    index = np.frombuffer(data[at:-4], "<u8").reshape(-1, 2)
    rows = min(document.shape[0], document.shard_rows)
    chunks = []
    for start, length in index[: -(-rows // document.chunk_rows)].tolist():
        raw = data[start : start + length]
        chunks.append(bytes(Zstd().decode(raw)) if document.zstd else raw)
    whole = np.frombuffer(b"".join(chunks), document.dtype)
    return whole.reshape(-1, *document.shape[1:])[:rows].copy()


def _encoded(document: ArrayDocument, values: np.ndarray) -> bytes:
    """Encode a shard that holds these values."""
    chunks, index, position = [], [], 0
    for start in range(0, len(values), document.chunk_rows):
        rows = values[start : start + document.chunk_rows]
        raw = rows.tobytes() + bytes((document.chunk_rows - len(rows)) * document.row_bytes)
        chunk = bytes(Zstd(level=1, checksum=True).encode(raw)) if document.zstd else raw
        chunks.append(chunk)
        index.append((position, len(chunk)))
        position += len(chunk)
    absent = [(2**64 - 1, 2**64 - 1)] * (document.chunks_per_shard - len(index))
    tail = np.array(index + absent, "<u8").tobytes()
    return b"".join(chunks) + tail + crc32c(tail).to_bytes(4, "little")


def _change(values: np.ndarray, random: Random) -> np.ndarray:
    flat = values.reshape(-1)
    if not flat.size:
        return values
    way = random.randrange(7)
    at = random.randrange(flat.size)
    if way == 0:
        flat[at:] = flat[at]
    elif way == 1:
        values = values[::-1].copy()
    elif way == 2:
        flat[:] = _extreme(values.dtype, random)
    elif way == 3:
        raw = bytearray(values.tobytes())
        for _ in range(random.choice((1, 3, 20))):
            raw[random.randrange(len(raw))] ^= 1 << random.randrange(8)
        values = np.frombuffer(bytes(raw), values.dtype).reshape(values.shape)
    else:
        for _ in range(random.choice((1, 1, 2, 10))):
            flat[random.randrange(flat.size)] = _extreme(values.dtype, random)
    return values


def _extreme(dtype: "np.dtype[Any]", random: Random) -> Any:
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.array(random.choice(FLOATS)).astype(dtype)
    value = random.choice(EXTREMES)
    return np.frombuffer((value & (2**64 - 1)).to_bytes(8, "little"), dtype)[0]


def spoil_values(draft: Draft, array: str, random: Random) -> str:
    """Change values, or how many there are, and write the array as it should be written."""
    found = _shard(draft, array)
    if found is None or found[0].shards != 1:
        return "nothing"
    document, path, data = found
    try:
        values = _values(document, data)
    except Exception:  # noqa: BLE001  # it was spoiled before
        return "nothing"
    values = _change(values, random)
    # The layout is kept, so there is room for as many rows as the shard has.
    draft.files[path] = _encoded(document, values)
    if random.random() < 0.15:
        node = json.loads(draft.data(f"{array}/zarr.json"))
        node["shape"][0] = random.choice((0, 1, len(values) - 1, len(values) + 1))
        draft.files[f"{array}/zarr.json"] = json.dumps(node).encode()
    return f"values of {array}"
