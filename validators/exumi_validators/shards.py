"""The shards of one array: that they are there, and that their indices are sound."""

import re
import struct
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from exumi_data.errors import ExumiError
from exumi_data.store.access import FolderStore, ZipStore
from exumi_data.store.shards import crc32c
from exumi_data.store.zarr_document import ArrayDocument
from exumi_validators.findings import problem
from exumi_validators.listing import Listing
from exumi_validators.report import Problem

__all__ = ["judge_shards"]

_ABSENT = np.uint64(0xFFFFFFFFFFFFFFFF)
_ENTRY = struct.Struct("<QQ")
_NUMBER = re.compile(r"(0|[1-9][0-9]{0,18})")


class HasFiles(Protocol):
    """What is needed of an episode."""

    store: FolderStore | ZipStore
    listing: Listing


def judge_shards(episode: HasFiles, path: str, document: ArrayDocument) -> Iterator[Problem]:
    """Judge all shards of an array. No chunk is read.

    Parameters
    ----------
    episode : EpisodeContext
    path : str
        Of the array.
    document : ArrayDocument
        Its layout.

    Yields
    ------
    Problem
        Of the rules SHARD-001 to 004, and SHARD-006; and of SHARD-005 what the index tells: the
        lengths of uncompressed chunks.
    """
    present = _present(episode.listing, path, document)
    missing = document.shards - len(present)
    if missing:
        first = next(index for index in range(document.shards) if index not in present)
        yield problem(
            "SHARD-001",
            path,
            found=missing,
            expected=document.shards,
            detail=document.shard_path(first),
        )
    for shard in sorted(present):
        yield from _judge_shard(episode, path, document, shard)


def _present(listing: Listing, path: str, document: ArrayDocument) -> set[int]:
    """Numbers of the shards that are there: as many as there are files, however many are asked."""
    found = set()
    tail = "/0" * (len(document.shape) - 1)
    for rest in listing.chunk_files.get(path, ()):
        number = rest.removesuffix(tail) if rest.endswith(tail) else ""
        if _NUMBER.fullmatch(number) and int(number) < document.shards:
            found.add(int(number))
    return found


def _judge_shard(
    episode: HasFiles, path: str, document: ArrayDocument, shard: int
) -> Iterator[Problem]:
    file = f"{path}/{document.shard_path(shard)}"
    size = episode.listing.files[file]
    length = document.chunks_per_shard * 16 + 4
    raw = _index_of(episode, file, length)
    if isinstance(raw, str):
        yield problem("SHARD-002", file, detail=raw)
        return
    rows = min(document.shard_rows, document.shape[0] - shard * document.shard_rows)
    chunks = -(-rows // document.chunk_rows)
    if chunks == 1 and _is_all(raw, size - length, document):
        return
    index = np.frombuffer(raw[:-4], dtype="<u8").reshape(-1, 2)[:chunks]
    absent = (index == _ABSENT).any(axis=1)
    if absent.any():
        first = int(absent.argmax())
        found = int(absent.sum())
        yield problem("SHARD-003", file, index=first, found=found, expected=chunks)
        return
    body = np.uint64(size - length)
    # Compared one by one: the sum of two hostile numbers could wrap.
    outside = (index > body).any(axis=1) | (index.sum(axis=1) > body)
    if outside.any():
        detail = f"inner chunk {int(outside.argmax())} lies outside the shard"
        yield problem("SHARD-002", file, detail=detail)
        return
    lengths = index[:, 1] != document.chunk_bytes
    if not document.zstd and lengths.any():
        first = int(lengths.argmax())
        detail = f"has {int(index[first, 1])} bytes, expected {document.chunk_bytes}"
        yield problem("SHARD-005", path, detail=f"inner chunk {first} of {file} {detail}")
        return
    if not document.zstd:
        yield from _judge_order(file, index, document.chunk_bytes)
    yield from _judge_body(file, index, size - length)


def _index_of(episode: HasFiles, file: str, length: int) -> bytes | str:
    """Return the bytes of a shard's index with its checksum, or what is wrong with it."""
    size = episode.listing.files[file]
    if size < length:
        return f"it has {size} bytes, its index alone has {length}"
    try:
        raw = episode.store.read_range(file, size - length, length)
    except (ExumiError, OSError) as error:
        return f"it cannot be read: {error}"
    if crc32c(raw[:-4]) != int.from_bytes(raw[-4:], "little"):
        return "its index has a wrong checksum"
    return raw


def _is_all(raw: bytes, body: int, document: ArrayDocument) -> bool:
    """Whether a shard's first chunk is all that it holds: so it is with most small arrays."""
    start, length = _ENTRY.unpack_from(raw)
    return start == 0 and length == body and (document.zstd or length == document.chunk_bytes)


def _judge_body(file: str, index: np.ndarray, body: int) -> Iterator[Problem]:
    """Judge that the chunks fill the shard: bytes of no chunk, or of two, are damage."""
    in_order = index[np.argsort(index[:, 0], kind="stable")].astype(np.int64)
    ends = in_order.sum(axis=1)
    starts = np.append(in_order[:, 0], body)
    expected = np.concatenate((np.zeros(1, np.int64), ends))
    wrong = starts != expected
    if wrong.any():
        at = int(expected[int(wrong.argmax())])
        detail = f"the bytes from {at} on belong to no inner chunk"
        if int(starts[int(wrong.argmax())]) < at:
            detail = f"the bytes before {at} belong to two inner chunks"
        yield problem("SHARD-006", file, detail=detail)


def _judge_order(file: str, index: np.ndarray, chunk_bytes: int) -> Iterator[Problem]:
    starts = np.arange(len(index), dtype=np.uint64) * np.uint64(chunk_bytes)
    moved = index[:, 0] != starts
    if moved.any():
        first = int(moved.argmax())
        expected, found = int(starts[first]), int(index[first, 0])
        yield problem("SHARD-004", file, index=first, expected=expected, found=found)
