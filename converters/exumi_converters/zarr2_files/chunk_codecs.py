"""Chunks of Zarr v2 are decoded: never objects, and never more bytes than the chunk has."""

import bz2
import json
import lzma
import struct
import zlib
from collections.abc import Mapping
from functools import lru_cache
from inspect import signature
from typing import Any

import numpy as np

from exumi_data.errors import (
    ExumiError,
    LimitError,
    MissingExtraError,
    SourceError,
    UnsupportedError,
)

__all__ = ["check_codec", "decode_chunk"]

_IMAGE_CODECS = "imagecodecs_"
_BLOSC = struct.Struct("<4B3I")
_LZ4 = struct.Struct("<I")
_OF_ZSTD = b"\x28\xb5\x2f\xfd"
_SIZED = ("blosc", "lz4", "zstd")
_UNSIZED = ("zlib", "gzip", "bz2", "lzma")
_LZMA_MEMORY = 1 << 27  # the strongest of the usual settings takes half of it
_KEEP_SIZE = ("shuffle", "delta", "bitround")  # filters whose output is as large as their input
_OBJECTS = ("pickle", "json2", "msgpack2", "categorize", "vlen-array", "vlen-bytes", "vlen-utf8")


def check_codec(config: Mapping[str, Any] | None, where: object) -> None:
    """Refuse a codec that is not known, or would make Python objects.

    Parameters
    ----------
    config : mapping or None
        Of the array's metadata; None: not compressed.
    where : object
        Named in errors.

    Raises
    ------
    UnsupportedError
        With what to do.
    MissingExtraError
        It is one of imagecodecs, which is not installed.
    """
    if config is None:
        return
    name = config.get("id")
    if name in _OBJECTS:
        raise UnsupportedError(
            f"the codec {name!r} makes Python objects, which are never loaded from a file",
            where=where,
            fix="Write the array again as numbers, with the program that made it.",
        )
    if not isinstance(name, str) or not (
        name in _SIZED + _UNSIZED or name.startswith(_IMAGE_CODECS)
    ):
        raise UnsupportedError(
            f"the codec {name!r} is not read",
            where=where,
            fix=f"Read are {', '.join(_SIZED + _UNSIZED)} and those of imagecodecs.",
        )
    try:
        _codec(_key(config))
    except ExumiError as error:
        raise type(error)(error.what, where=where, fix=error.fix) from None


def check_filters(filters: list[Mapping[str, Any]] | None, where: object) -> None:
    """Refuse filters that could make more bytes of few.

    Raises
    ------
    UnsupportedError
        With what to do.
    """
    for item in filters or []:
        if item.get("id") in _OBJECTS:
            check_codec(item, where)
        if item.get("id") not in _KEEP_SIZE or item.get("astype") not in (None, item.get("dtype")):
            raise UnsupportedError(
                f"the filter {item.get('id')!r} is not read",
                where=where,
                fix="Write the array again without filters.",
            )


def _key(config: Mapping[str, Any]) -> str:
    return json.dumps(dict(config))


@lru_cache(maxsize=64)  # for each chunk: what its parameters are takes half as long as decoding it
def _codec(config: str) -> Any:
    """Return a codec; its parameters are those that it knows, and one thread."""
    from numcodecs.registry import codec_registry, get_codec

    given = json.loads(config)
    name = given.pop("id")
    if name.startswith(_IMAGE_CODECS) and name not in codec_registry:
        try:
            from imagecodecs.numcodecs import register_codecs
        except ImportError:
            raise MissingExtraError(
                f"the codec {name!r} is one of imagecodecs, which is not installed",
                fix="Install it: pip install 'exumi-data[umi]'.",
            ) from None
        register_codecs(verbose=False)
    try:
        if name.startswith(_IMAGE_CODECS):
            known = signature(codec_registry[name]).parameters
            # Other versions have other parameters; those of the encoder have no part in decoding.
            given = {key: value for key, value in given.items() if key in known}
            if "numthreads" in known:
                given["numthreads"] = 1
        return get_codec({"id": name, **given})
    except (KeyError, ValueError, TypeError) as error:
        raise UnsupportedError(
            f"the codec {name!r} cannot be had ({error})",
            fix="Install a version of numcodecs or imagecodecs that has it.",
        ) from None


def decode_chunk(
    data: bytes,
    out: np.ndarray,
    compressor: Mapping[str, Any] | None,
    filters: list[Mapping[str, Any]] | None,
    where: object,
) -> None:
    """Decode a chunk into an array of its shape and type.

    Parameters
    ----------
    data : bytes
        As stored.
    out : ndarray
        C-contiguous; the chunk in the order that it is stored in.
    compressor : mapping or None
    filters : list of mapping or None
    where : object
        Named in errors.

    Raises
    ------
    SourceError
        It is damaged, or not of that size.
    """
    try:
        decoded = _decompress(data, out, compressor, where)
        for item in reversed(filters or []):
            decoded = _codec(_key(item)).decode(decoded)
        if decoded is not out:
            _fill(out, decoded)
    except (SourceError, UnsupportedError, MissingExtraError, LimitError):
        raise
    except Exception as error:  # noqa: BLE001  # what third-party decoders raise is not known
        text = str(error).strip() or type(error).__name__
        raise SourceError(f"a chunk cannot be decoded ({text[:200]})", where=where) from None


def _fill(out: np.ndarray, decoded: Any) -> None:
    if isinstance(decoded, np.ndarray) and decoded.dtype == out.dtype:
        np.copyto(out, decoded.reshape(out.shape))
        return
    flat = np.frombuffer(memoryview(decoded).cast("B"), out.dtype)
    np.copyto(out, flat.reshape(out.shape))


def _decompress(
    data: bytes, out: np.ndarray, config: Mapping[str, Any] | None, where: object
) -> Any:
    if config is None:
        return data
    name = str(config["id"])
    if name in _UNSIZED:
        return _bounded(name, data, out.nbytes, config, where)
    codec = _codec(_key(config))
    if name.startswith(_IMAGE_CODECS):
        return _decode_image(codec, data, out)
    _check_size(name, data, out.nbytes, where)
    codec.decode(data, out.reshape(-1).view(np.uint8))
    return out


def _check_size(name: str, data: bytes, size: int, where: object) -> None:
    """Refuse what says to be of another size unpacked.

    Of a larger one the decoders would take memory, of a smaller one leave the rest as it was; and
    Blosc would read on behind the end of a block that is cut short.
    """
    if name == "blosc":
        if len(data) < _BLOSC.size:
            raise SourceError("a chunk is cut short", where=where)
        *_, stated, _, packed = _BLOSC.unpack_from(data)
        if packed > len(data):
            raise SourceError(f"a chunk has {len(data):,} bytes of {packed:,}", where=where)
    elif name == "lz4":
        stated = _LZ4.unpack_from(data)[0] if len(data) >= _LZ4.size else None
    else:
        stated = _zstd_size(data)
    if stated is None:
        raise SourceError("a chunk does not say how large it is unpacked", where=where)
    if stated != size:
        raise SourceError(f"a chunk has {stated:,} bytes unpacked instead of {size:,}", where=where)


def _zstd_size(data: bytes) -> int | None:
    """Return the size of its content that the header of a Zstandard frame states, if it does."""
    if not data.startswith(_OF_ZSTD) or len(data) < 5:
        return None
    form, single = data[4] >> 6, data[4] >> 5 & 1
    length = 1 << form if form else single
    at = 5 + (not single) + (0, 1, 2, 4)[data[4] & 3]
    if not length or len(data) < at + length:
        return None
    return int.from_bytes(data[at : at + length], "little") + (256 if form == 1 else 0)


def _decode_image(codec: Any, data: bytes, out: np.ndarray) -> np.ndarray:
    """Decode into `out`: whatever size the file claims, it is compared before memory is taken."""
    lead = out.reshape(out.shape[-3:]) if out.ndim > 3 and out.size == _size3(out) else out
    decoded = codec.decode(data, out=lead)
    if not isinstance(decoded, np.ndarray):
        return np.frombuffer(decoded, out.dtype)
    if decoded.size != out.size or decoded.dtype != out.dtype:
        msg = f"it is {decoded.shape} {decoded.dtype}, the chunk {out.shape} {out.dtype}"
        raise ValueError(msg)
    return out if np.shares_memory(decoded, out) else decoded


def _size3(array: np.ndarray) -> int:
    return int(np.prod(array.shape[-3:], dtype=np.int64))


def _bounded(name: str, data: bytes, size: int, config: Mapping[str, Any], where: object) -> bytes:
    """Unpack what does not say its size: one byte more than there should be is enough."""
    most = size + 1
    if name == "bz2":
        content = bz2.BZ2Decompressor().decompress(data, most)
    elif name == "lzma":
        if config.get("format", 1) not in (0, 1) or config.get("filters"):
            raise UnsupportedError("raw LZMA is not read", where=where)
        content = lzma.LZMADecompressor(memlimit=_LZMA_MEMORY).decompress(data, most)
    else:
        content = zlib.decompressobj(31 if name == "gzip" else 15).decompress(data, most)
    if len(content) != size:
        raise SourceError(f"a chunk has other than {size:,} bytes unpacked", where=where)
    return content
