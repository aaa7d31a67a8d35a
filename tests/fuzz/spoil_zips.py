"""Spoiling packed episodes: bytes of the directory, or zips that were made to deceive."""

import io
import struct
import warnings
import zipfile
from random import Random

from tests.fuzz.spoil_bytes import spoil_bytes, spoil_word
from tests.fuzz.stores import as_zip, unzipped

__all__ = ["spoil_zip"]

NAMES = (
    "../../evil", "/etc/evil", "a\\b", "C:/x", "a//b", "./a", "a/./b", "", "a/", "zarr.json",
    "streams/", "x" * 2000, "\0", "é", "streams/zarr.json/x", "streams",
)  # fmt: skip


def _directory(data: bytes, random: Random) -> bytes:
    """Change a number in the directory or in the record at the end."""
    start = data.find(b"PK\x01\x02")
    if start < 0:
        return spoil_bytes(data, random)
    for _ in range(random.choice((1, 1, 2, 4))):
        data = spoil_word(data, random, start, len(data))
    return data


def _end(data: bytes, random: Random) -> bytes:
    return spoil_word(data, random, max(0, len(data) - 22), len(data))


def _local(data: bytes, random: Random) -> bytes:
    places, at = [], data.find(b"PK\x03\x04")
    while at >= 0:
        places.append(at)
        at = data.find(b"PK\x03\x04", at + 4)
    if not places:
        return spoil_bytes(data, random)
    at = random.choice(places)
    return spoil_word(data, random, at, at + 60)


def _members(data: bytes, random: Random) -> bytes:
    """Make a zip with a member that should not be there."""
    members = list(unzipped(data).items())
    extra = (random.choice(NAMES) or "zarr.json", random.choice((b"", b"{}", b"x" * 1000)))
    members.insert(random.randrange(len(members) + 1), extra)
    if random.random() < 0.3:
        random.shuffle(members)
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # names stand twice
        with zipfile.ZipFile(buffer, "w") as archive:
            for name, content in members:
                info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                if random.random() < 0.05:
                    info.compress_type = random.choice((8, 12, 14))
                if random.random() < 0.05:
                    info.external_attr = 0o120777 << 16
                if random.random() < 0.05:
                    info.extra = random.randbytes(random.choice((1, 4, 30)))
                archive.writestr(info, content)
    return buffer.getvalue()


def _overlapping(data: bytes, random: Random) -> bytes:
    """Let all entries of the directory point at one member."""
    out = bytearray(data)
    at = out.find(b"PK\x01\x02")
    first = None
    while at >= 0 and at + 46 <= len(out):
        offset = struct.unpack_from("<I", out, at + 42)[0]
        first = offset if first is None else first
        if random.random() < 0.5:
            struct.pack_into("<I", out, at + 42, first)
        at = out.find(b"PK\x01\x02", at + 46)
    return bytes(out)


def _zip64(data: bytes, random: Random) -> bytes:
    """Put records for large files before the end, with numbers that may be lies."""
    end = data.rfind(b"PK\x05\x06")
    if end < 0:
        return spoil_bytes(data, random)
    start = data.find(b"PK\x01\x02")
    count = data.count(b"PK\x01\x02")
    numbers = [count, count, end - start, start]
    if random.random() < 0.7:
        numbers[random.randrange(4)] = random.choice((0, 1, 1 << 32, 1 << 62, (1 << 64) - 1))
    record = struct.pack("<4sQ2H2L4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, *numbers)
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, end, 1)
    tail = bytearray(data[end:])
    tail[8:20] = b"\xff" * 12
    return data[:end] + record + locator + bytes(tail)


def _again(data: bytes, random: Random) -> bytes:
    return random.choice((data + data, b"#!/bin/sh\n" + data, data + b"\0" * 100, as_zip({})))


_WAYS = (
    _directory, _directory, _directory, _end, _end, _local, _local, _members, _members,
    _overlapping, _zip64, _again,
)  # fmt: skip


def spoil_zip(data: bytes, random: Random) -> tuple[bytes, str]:
    """Return another file, and what was done."""
    way = random.choice(_WAYS)
    try:
        return way(data, random), f"zip {way.__name__.strip('_')}"
    except Exception:  # noqa: BLE001  # it was spoiled before
        return spoil_bytes(data, random), "zip bytes"
