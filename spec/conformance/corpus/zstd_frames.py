"""Zstandard frames of raw blocks (RFC 8878), with their checksum.

Not compressed: so that the corpus is the same, byte for byte, whichever version of whichever
library is at hand.
"""

__all__ = ["frame", "xxh64"]

_MASK = (1 << 64) - 1
_PRIMES = (
    0x9E3779B185EBCA87,
    0xC2B2AE3D27D4EB4F,
    0x165667B19E3779F9,
    0x85EBCA77C2B2AE63,
    0x27D4EB2F165667C5,
)
_BLOCK = 128 << 10


def _rotate(value: int, bits: int) -> int:
    return ((value << bits) | (value >> (64 - bits))) & _MASK


def _round(accumulator: int, lane: int) -> int:
    value = (accumulator + lane * _PRIMES[1]) & _MASK
    return (_rotate(value, 31) * _PRIMES[0]) & _MASK


def xxh64(data: bytes) -> int:
    """Return the XXH64 hash, seed 0."""
    position = 0
    if len(data) >= 32:
        lanes = [(_PRIMES[0] + _PRIMES[1]) & _MASK, _PRIMES[1], 0, -_PRIMES[0] & _MASK]
        while position + 32 <= len(data):
            for lane in range(4):
                word = int.from_bytes(data[position : position + 8], "little")
                lanes[lane] = _round(lanes[lane], word)
                position += 8
        bits = (1, 7, 12, 18)
        value = sum(_rotate(lane, n) for lane, n in zip(lanes, bits, strict=True)) & _MASK
        for lane in lanes:
            value = ((value ^ _round(0, lane)) * _PRIMES[0] + _PRIMES[3]) & _MASK
    else:
        value = _PRIMES[4]
    value = (value + len(data)) & _MASK
    while position + 8 <= len(data):
        value ^= _round(0, int.from_bytes(data[position : position + 8], "little"))
        value = (_rotate(value, 27) * _PRIMES[0] + _PRIMES[3]) & _MASK
        position += 8
    if position + 4 <= len(data):
        value ^= int.from_bytes(data[position : position + 4], "little") * _PRIMES[0] & _MASK
        value = (_rotate(value, 23) * _PRIMES[1] + _PRIMES[2]) & _MASK
        position += 4
    for byte in data[position:]:
        value ^= byte * _PRIMES[4] & _MASK
        value = _rotate(value, 11) * _PRIMES[0] & _MASK
    value = ((value ^ (value >> 33)) * _PRIMES[1]) & _MASK
    value = ((value ^ (value >> 29)) * _PRIMES[2]) & _MASK
    return value ^ (value >> 32)


def frame(data: bytes) -> bytes:
    """Return one frame: single segment, content size, raw blocks, checksum."""
    single_segment, checksum = 1 << 5, 1 << 2
    if len(data) < 256:
        size_flag, size = 0, len(data).to_bytes(1, "little")
    elif len(data) < 65536 + 256:
        size_flag, size = 1, (len(data) - 256).to_bytes(2, "little")
    else:
        size_flag, size = 2, len(data).to_bytes(4, "little")
    out = b"\x28\xb5\x2f\xfd" + bytes([size_flag << 6 | single_segment | checksum]) + size
    blocks = [data[start : start + _BLOCK] for start in range(0, len(data), _BLOCK)] or [b""]
    for index, block in enumerate(blocks):
        last = index == len(blocks) - 1
        out += (last | len(block) << 3).to_bytes(3, "little") + block
    return out + (xxh64(data) & 0xFFFFFFFF).to_bytes(4, "little")
