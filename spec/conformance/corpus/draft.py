"""An episode in memory, as files: written without the library that reads it.

What comes out depends on nothing but this code, NumPy's integers and the files in ``sources``.
"""

import json
from typing import Any

import google_crc32c
import numpy as np

from corpus import zstd_frames

__all__ = ["CONVENTION", "Draft", "crc32c", "dumps"]

CONVENTION = {
    "uuid": "7d8f0a52-5a5b-4a0e-9d7c-3f2f6a1c9e10",
    "name": "exumi-episode",
    "description": "exUMI Episode: one tactile robot-manipulation episode",
}
_ABSENT = 0xFFFFFFFFFFFFFFFF


def crc32c(data: bytes) -> int:
    """Return the CRC-32C of some bytes."""
    return int(google_crc32c.value(data))


def dumps(document: object) -> bytes:
    """Write a JSON document."""
    return (json.dumps(document, ensure_ascii=False, separators=(",", ":")) + "\n").encode()


class Draft:
    """An episode that is being made up.

    Attributes
    ----------
    metadata : dict
        The attribute ``exumi``.
    root : dict
        The root's document; `metadata` is put into it last.
    nodes : dict
        Path of a group or array to its document.
    blobs : dict
        Path of any other file to its bytes.
    values : dict
        Path of an array to its values, as they were put.
    """

    def __init__(self, **metadata: Any) -> None:
        self.metadata: dict[str, Any] = {
            "format": "exumi-episode",
            "version": "1.0",
            "id": "018f0000-0000-7000-8000-0000000000a1",
            "task": {"name": "press the gel"},
            "regime": "play",
            "streams": {},
            "licence": "CC0-1.0",
            "source": {"type": "simulated", "tool": "corpus", "tool_version": "1"},
            **metadata,
        }
        self.root: dict[str, Any] = {
            "zarr_format": 3,
            "node_type": "group",
            "attributes": {"zarr_conventions": [CONVENTION], "exumi": self.metadata},
        }
        self.nodes: dict[str, dict[str, Any]] = {}
        self.blobs: dict[str, bytes] = {}
        self.values: dict[str, np.ndarray] = {}
        self.group("streams")

    def group(self, path: str, **attributes: Any) -> None:
        """Add a group."""
        self.nodes[path] = {"zarr_format": 3, "node_type": "group", "attributes": attributes}

    def stream(self, name: str, kind: str, **fields: Any) -> dict[str, Any]:
        """Add a stream; its arrays are listed as they are put."""
        self.group(f"streams/{name}")
        clock = {"source": "simulation", "stamp_point": "simulated"}
        model = {"kind": kind, "clock": clock, "arrays": [], **fields}
        self.metadata["streams"][name] = model
        return model

    def put(
        self,
        path: str,
        values: np.ndarray,
        *,
        names: tuple[str, ...] = ("time",),
        chunk_rows: int | None = None,
        chunks_per_shard: int | None = None,
        zstd: bool = True,
        listed: bool = True,
    ) -> None:
        """Add an array, or put another one in its place.

        Chunks are as long as the array, and one shard holds all of them, unless it is said
        otherwise.
        """
        for old in [name for name in self.blobs if name.startswith(f"{path}/c/")]:
            del self.blobs[old]
        self.values[path] = values
        rows = chunk_rows or max(1, len(values))
        total = max(1, -(-len(values) // rows))
        in_shard = chunks_per_shard or total
        self.nodes[path] = _document(values, names, rows, rows * in_shard, zstd=zstd)
        starts = range(0, len(values), rows)
        chunks = [_chunk(values[at : at + rows], rows, zstd=zstd) for at in starts]
        tail = "/0" * (values.ndim - 1)
        for shard, at in enumerate(range(0, len(chunks), in_shard)):
            self.blobs[f"{path}/c/{shard}{tail}"] = _shard(chunks[at : at + in_shard], in_shard)
        top, _, rest = path.partition("/")
        if top == "streams" and listed:
            name, _, array = rest.partition("/")
            arrays = self.metadata["streams"][name]["arrays"]
            if array not in arrays:
                arrays.append(array)

    def derive(self, key: str, values: np.ndarray, *, names: tuple[str, ...], **item: Any) -> None:
        """Add a derived array with its description."""
        if "derived" not in self.nodes:
            document = {"format": "exumi-derived", "version": "1.0", "items": {}}
            self.group("derived", exumi=document)
        self.nodes["derived"]["attributes"]["exumi"]["items"][key] = item
        self.group(f"derived/{key.partition('/')[0]}")
        self.put(f"derived/{key}", values, names=names)

    def drop(self, path: str) -> None:
        """Remove a node or file, and all that is below it."""
        for found in [name for name in self.nodes if name == path or name.startswith(f"{path}/")]:
            del self.nodes[found]
        for found in [name for name in self.blobs if name == path or name.startswith(f"{path}/")]:
            del self.blobs[found]

    def files(self) -> dict[str, bytes]:
        """Return the episode's files."""
        nodes = {f"{path}/zarr.json": dumps(node) for path, node in self.nodes.items()}
        return {"zarr.json": dumps(self.root), **nodes, **self.blobs}


def _chunk(rows: np.ndarray, length: int, *, zstd: bool) -> bytes:
    data = rows.tobytes()
    # The last one is filled up.
    data += bytes(length * (len(data) // max(1, len(rows))) - len(data))
    return zstd_frames.frame(data) if zstd else data


def _shard(chunks: list[bytes], places: int) -> bytes:
    index, position = [], 0
    for chunk in chunks:
        index += [position, len(chunk)]
        position += len(chunk)
    index += [_ABSENT, _ABSENT] * (places - len(chunks))
    raw = np.array(index, dtype="<u8").tobytes()
    return b"".join(chunks) + raw + crc32c(raw).to_bytes(4, "little")


def _document(
    values: np.ndarray, names: tuple[str, ...], chunk_rows: int, shard_rows: int, *, zstd: bool
) -> dict[str, Any]:
    little = {"name": "bytes", "configuration": {"endian": "little"}}
    inner: list[dict[str, Any]] = [{"name": "bytes"} if values.itemsize == 1 else little]
    if zstd:
        inner.append({"name": "zstd", "configuration": {"level": 0, "checksum": True}})
    sharding = {
        "chunk_shape": [chunk_rows, *values.shape[1:]],
        "codecs": inner,
        "index_codecs": [little, {"name": "crc32c"}],
        "index_location": "end",
    }
    fill: Any = 0.0 if values.dtype.kind == "f" else 0
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": list(values.shape),
        "data_type": values.dtype.name,
        "chunk_grid": {
            "name": "regular",
            "configuration": {"chunk_shape": [shard_rows, *values.shape[1:]]},
        },
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": False if values.dtype == np.bool_ else fill,
        "codecs": [{"name": "sharding_indexed", "configuration": sharding}],
        "attributes": {},
        "dimension_names": list(names),
    }
