"""The ``zarr.json`` of groups and arrays, judged without stopping at the first mistake."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from exumi_data.store.zarr_document import DTYPES, MAX_SHARD_BYTES
from exumi_validators.findings import problem
from exumi_validators.report import Problem

__all__ = [
    "MAX_CHUNKS",
    "MAX_CHUNKS_PER_SHARD",
    "ArrayNode",
    "array_problems",
    "node_mistake",
    "parse_array_node",
]

MAX_CHUNKS = 1 << 26
MAX_CHUNKS_PER_SHARD = 1 << 20
_MAX_RANK = 16
_MAX_SIZE = 1 << 62
_ZSTD_LEVELS = range(-131072, 23)
_NOT_FINITE = ("NaN", "Infinity", "-Infinity")
_GROUP_MEMBERS = {"zarr_format", "node_type", "attributes", "consolidated_metadata"}
_ARRAY_MEMBERS = {
    "zarr_format", "node_type", "attributes", "shape", "data_type", "chunk_grid",
    "chunk_key_encoding", "fill_value", "codecs", "dimension_names", "storage_transformers",
}  # fmt: skip
_ITEM_BYTES = {"bool": 1} | {name: int(name.lstrip("uintfloa")) // 8 for name in DTYPES - {"bool"}}


@dataclass(frozen=True, slots=True)
class ArrayNode:
    """What could be understood of an array's document; None where it could not.

    Attributes
    ----------
    path : str
        Of the array.
    document : dict
    shape : tuple of int
    dtype : str or None
        Its Zarr name, when it is a core type.
    shard : tuple of int or None
        Shape of a shard.
    chunk : tuple of int or None
        Shape of an inner chunk.
    zstd : bool
    """

    path: str
    document: dict[str, Any]
    shape: tuple[int, ...]
    dtype: str | None
    shard: tuple[int, ...] | None
    chunk: tuple[int, ...] | None
    zstd: bool

    @property
    def file(self) -> str:
        """Path of the document."""
        return f"{self.path}/zarr.json"


def _sizes(value: object) -> tuple[int, ...] | None:
    if not isinstance(value, list) or len(value) > _MAX_RANK:
        return None
    for item in value:
        if not isinstance(item, int) or isinstance(item, bool) or not 0 <= item < _MAX_SIZE:
            return None
    return tuple(value)


def _configuration(value: object, name: str) -> dict[str, Any] | None:
    """Return the configuration of a named extension point, None when it is another one."""
    if not isinstance(value, dict) or value.get("name") != name:
        return None
    configuration = value.get("configuration", {})
    return configuration if isinstance(configuration, dict) else None


def _exactly(value: object, name: str, *keys: str) -> bool:
    """Whether an extension point, or one of its lists' items, has no members but these.

    Zarr libraries refuse what they do not know.
    """
    configuration = _configuration(value, name)
    if configuration is None or not isinstance(value, dict):
        return False
    return set(value) <= {"name", "configuration"} and set(configuration) <= set(keys)


def node_mistake(document: dict[str, Any], node_type: str) -> str | None:
    """Return what keeps a ``zarr.json`` from being one of its type, None when nothing does.

    Parameters
    ----------
    document : dict
    node_type : str
        ``group`` or ``array``.
    """
    if document.get("zarr_format") != 3:
        return "`zarr_format` is not 3"
    if document.get("node_type") != node_type:
        return f"`node_type` is not {node_type}"
    unknown = set(document) - (_ARRAY_MEMBERS if node_type == "array" else _GROUP_MEMBERS)
    if unknown:
        return f"Zarr v3 has no member `{min(unknown)}`"
    if node_type == "array" and "fill_value" not in document:
        return "there is no `fill_value`"
    data_type = document.get("data_type")
    if node_type == "array" and isinstance(data_type, str) and data_type in DTYPES:
        return _fill_value_mistake(document["fill_value"], data_type)
    return None


def _fill_value_mistake(value: object, dtype: str) -> str | None:
    is_integer = isinstance(value, int) and not isinstance(value, bool)
    if dtype == "bool":
        fits = isinstance(value, bool)
    elif dtype.startswith("float"):
        fits = is_integer or isinstance(value, float) or value in _NOT_FINITE
    else:
        unsigned = dtype.startswith("u")
        bits = _ITEM_BYTES[dtype] * 8 - (not unsigned)
        fits = (
            isinstance(value, int) and is_integer and -(not unsigned) << bits <= value < 1 << bits
        )
    return None if fits else f"`fill_value` is no {dtype}"


def parse_array_node(document: dict[str, Any], path: str) -> ArrayNode | None:
    """Read what can be read of an array's document.

    Parameters
    ----------
    document : dict
    path : str
        Of the array.

    Returns
    -------
    ArrayNode or None
        None without a shape: then there is nothing to judge.
    """
    shape = _sizes(document.get("shape"))
    if not shape:
        return None
    data_type = document.get("data_type")
    dtype = data_type if isinstance(data_type, str) and data_type in DTYPES else None
    grid = _configuration(document.get("chunk_grid"), "regular")
    shard = None if grid is None else _sizes(grid.get("chunk_shape"))
    sharding = _sharding(document.get("codecs"))
    chunk = None if sharding is None else _sizes(sharding.get("chunk_shape"))
    inner = [] if sharding is None else sharding.get("codecs")
    zstd = isinstance(inner, list) and any(_configuration(c, "zstd") is not None for c in inner)
    return ArrayNode(path, document, shape, dtype, shard, chunk, zstd)


def _sharding(codecs: object) -> dict[str, Any] | None:
    if not isinstance(codecs, list) or len(codecs) != 1:
        return None
    return _configuration(codecs[0], "sharding_indexed")


def array_problems(node: ArrayNode) -> Iterator[Problem]:
    """Judge an array's document: types, codecs, grid, sizes, keys.

    Parameters
    ----------
    node : ArrayNode

    Yields
    ------
    Problem
        Of the rules ZARR-002, 003, 004, 008, 009 and 010.
    """
    document = node.document
    if node.dtype is None:
        yield problem(
            "ZARR-002", node.file, pointer=("data_type",), found=document.get("data_type")
        )
    mistake = _codec_mistake(document.get("codecs"), node.dtype)
    if document.get("storage_transformers", []) != []:
        mistake = "there are storage transformers"
    if mistake:
        yield problem("ZARR-003", node.file, pointer=("codecs",), detail=mistake)
    yield from _grid_problems(node)
    expected = {"name": "default", "configuration": {"separator": "/"}}
    keys = document.get("chunk_key_encoding")
    default = _configuration(keys, "default")
    is_default = default is not None and default.get("separator", "/") == "/"
    if not is_default or not _exactly(keys, "default", "separator"):
        pointer = ("chunk_key_encoding",)
        yield problem("ZARR-009", node.file, pointer=pointer, found=keys, expected=expected)


def _codec_mistake(codecs: object, dtype: str | None) -> str | None:
    sharding = _sharding(codecs)
    if sharding is None or not isinstance(codecs, list):
        return "the only codec is not sharding_indexed"
    members = ("chunk_shape", "codecs", "index_codecs", "index_location")
    if not _exactly(codecs[0], "sharding_indexed", *members):
        return "sharding_indexed has members that it does not know"
    if sharding.get("index_location", "end") != "end":
        return "the shard index is not at the end"
    return _chain_mistake(sharding.get("codecs"), sharding.get("index_codecs"), dtype)


def _chain_mistake(inner: object, index_codecs: object, dtype: str | None) -> str | None:
    """Return what is wrong with the codecs of chunks and of the shard index."""
    if _names(index_codecs) != ["bytes", "crc32c"] or not isinstance(index_codecs, list):
        return "the codecs of the shard index are not bytes and crc32c"
    if _names(inner) not in (["bytes"], ["bytes", "zstd"]) or not isinstance(inner, list):
        return "the inner codecs are not bytes, or bytes and zstd"
    known = (
        _exactly(index_codecs[0], "bytes", "endian")
        and _exactly(index_codecs[1], "crc32c")
        and _exactly(inner[0], "bytes", "endian")
        and all(_exactly(codec, "zstd", "level", "checksum") for codec in inner[1:])
    )
    if not known:
        return "a codec has members that it does not know"
    one_byte = dtype is not None and _ITEM_BYTES[dtype] == 1
    if not (_is_little(inner[0], optional=one_byte) and _is_little(index_codecs[0])):
        return "a bytes codec is not little endian"
    return _zstd_mistake(inner[1].get("configuration", {})) if len(inner) > 1 else None


def _zstd_mistake(configuration: dict[str, Any]) -> str | None:
    level = configuration.get("level")
    if not isinstance(level, int) or isinstance(level, bool) or level not in _ZSTD_LEVELS:
        return "zstd is without a level from -131072 to 22"
    return None if configuration.get("checksum") is True else "zstd is without its checksum"


def _names(codecs: object) -> list[object]:
    """Names of codecs, each an object; None for what is none."""
    if not isinstance(codecs, list):
        return []
    return [
        codec.get("name")
        if isinstance(codec, dict) and isinstance(codec.get("configuration", {}), dict)
        else None
        for codec in codecs
    ]


def _is_little(codec: dict[str, Any], *, optional: bool = False) -> bool:
    configuration = codec.get("configuration", {})
    return configuration.get("endian") == "little" or (optional and "endian" not in configuration)


def _inner_mistake(node: ArrayNode, shard: tuple[int, ...]) -> str | None:
    """Return what is wrong with inner chunks, where the array has them."""
    chunk = node.chunk
    if chunk is None:
        has_chunks = _sharding(node.document.get("codecs")) is not None
        return "the shape of inner chunks is not a list of sizes" if has_chunks else None
    if len(chunk) != len(node.shape) or 0 in chunk or chunk[1:] != shard[1:]:
        return f"inner chunks of shape {list(chunk)} divide more than the first axis"
    if shard[0] % chunk[0]:
        return f"shards of {shard[0]} rows are no whole number of chunks of {chunk[0]}"
    return None


def _grid_problems(node: ArrayNode) -> Iterator[Problem]:
    shape, shard, chunk = node.shape, node.shard, node.chunk
    pointer: tuple[str, ...] = ("chunk_grid",)
    mistake = None
    if shard is None:
        mistake = "the chunk grid is not regular"
    elif not _exactly(node.document.get("chunk_grid"), "regular", "chunk_shape"):
        mistake = "the chunk grid has members that it does not know"
    elif len(shard) != len(shape) or 0 in shard:
        mistake = f"shards of shape {list(shard)} do not divide an array of shape {list(shape)}"
    elif shard[1:] != shape[1:]:
        mistake = f"shards of shape {list(shard)} divide more than the first axis"
    else:
        pointer = ("codecs", "0", "configuration", "chunk_shape")
        mistake = _inner_mistake(node, shard)
    if mistake:
        yield problem("ZARR-008", node.file, pointer=pointer, detail=mistake)
        return
    if shard is None or node.dtype is None:
        return
    shard_bytes = math.prod(shard) * _ITEM_BYTES[node.dtype]
    if shard_bytes > MAX_SHARD_BYTES:
        yield problem(
            "ZARR-004", node.file, pointer=pointer, found=shard_bytes, expected=MAX_SHARD_BYTES
        )
    in_shard = shard[0] // (chunk or shard)[0]
    if in_shard > MAX_CHUNKS_PER_SHARD:
        yield problem(
            "ZARR-010", node.file, pointer=pointer, found=in_shard, expected=MAX_CHUNKS_PER_SHARD
        )
    chunks = -(-shape[0] // (chunk or shard)[0])
    if chunks > MAX_CHUNKS:
        yield problem("ZARR-010", node.file, pointer=("shape",), found=chunks, expected=MAX_CHUNKS)
