"""One record of a log: a header of 48 bytes, then the sample's payload as it came.

The checksum begins with a number that only one log of one journal has. So neither what a disk still
held from another file, nor a record within another one's payload, passes for a record of this log.
"""

import struct
import zlib
from typing import NamedTuple

import numpy as np

__all__ = [
    "HEADER_BYTES",
    "MAGIC",
    "MAX_PAYLOAD_BYTES",
    "NONE",
    "RESTARTED",
    "Header",
    "checksum_of",
    "header_dtype",
    "pack_header",
    "salt_of",
    "unpack_header",
]

MAGIC = b"\x9dXJ1"
NONE = -(1 << 63)
"""Of device time and sequence: the device gave none."""
RESTARTED = 1 << 31
"""Flag of a record, not of an episode: the device was opened anew before this sample."""
MAX_PAYLOAD_BYTES = 32 << 20

_HEAD = struct.Struct("<4sII")
_BODY = struct.Struct("<QqqqI")
HEADER_BYTES = _HEAD.size + _BODY.size
_WHOLE = struct.Struct("<4sIIQqqqI")
_CHECKED = _HEAD.size


class Header(NamedTuple):
    """What stands before a payload.

    Attributes
    ----------
    length : int
        Bytes of the payload.
    checksum : int
    seq : int
        Counts what was given to this log, written or dropped: a hole is what was dropped.
    time_host_ns : int
    time_device, sequence : int
        `NONE` where there is none.
    flags : int
        Of the registry, and `RESTARTED`.
    """

    length: int
    checksum: int
    seq: int
    time_host_ns: int
    time_device: int
    sequence: int
    flags: int


def salt_of(journal: str, log: str) -> int:
    """Return the number that the checksums of one log begin with.

    Parameters
    ----------
    journal, log : str
        The episode's id, and the log's name.
    """
    return zlib.crc32(f"{journal}/{log}".encode())


def pack_header(
    salt: int,
    seq: int,
    time_host_ns: int,
    time_device: int,
    sequence: int,
    flags: int,
    payload: bytes,
) -> bytes:
    """Return the header of a record, `HEADER_BYTES` long.

    Parameters
    ----------
    salt : int
        See `salt_of`.
    seq, time_host_ns, time_device, sequence, flags : int
        See `Header`.
    payload : bytes
    """
    body = _BODY.pack(seq, time_host_ns, time_device, sequence, flags)
    checksum = zlib.crc32(payload, zlib.crc32(body, salt))
    return _HEAD.pack(MAGIC, len(payload), checksum) + body


def unpack_header(data: bytes) -> Header | None:
    """Return a header; None where there is none.

    Parameters
    ----------
    data : bytes
        `HEADER_BYTES` or more.
    """
    if len(data) < HEADER_BYTES:
        return None
    magic, *fields = _WHOLE.unpack_from(data)
    return Header(*fields) if magic == MAGIC else None


def checksum_of(salt: int, header: bytes | memoryview, payload: bytes | memoryview) -> int:
    """Return the checksum that a record should have.

    Parameters
    ----------
    salt : int
    header : bytes or memoryview
        As it was read.
    payload : bytes or memoryview
    """
    return zlib.crc32(payload, zlib.crc32(header[_CHECKED:HEADER_BYTES], salt))


def header_dtype(payload_bytes: int) -> np.dtype[np.void]:
    """Return the type of whole records whose payloads have one length.

    Parameters
    ----------
    payload_bytes : int
    """
    return np.dtype(
        [
            ("magic", "<u4"),
            ("length", "<u4"),
            ("checksum", "<u4"),
            ("seq", "<u8"),
            ("time_host", "<i8"),
            ("time_device", "<i8"),
            ("sequence", "<i8"),
            ("flags", "<u4"),
            ("payload", np.uint8, (payload_bytes,)),
        ]
    )
