"""Spoiling bytes without knowing what they mean."""

from collections.abc import Callable
from random import Random

__all__ = ["WORDS", "spoil_bytes", "spoil_word"]

WORDS = (0, 1, 2, 7, 0x7F, 0xFF, 0xFFFF, 1 << 31, (1 << 32) - 1, 1 << 62, (1 << 64) - 1)


def _flip(data: bytearray, random: Random) -> None:
    for _ in range(random.choice((1, 1, 1, 4, 32))):
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def _overwrite(data: bytearray, random: Random) -> None:
    at = random.randrange(len(data))
    length = min(random.choice((1, 2, 4, 8, 64)), len(data) - at)
    fill = random.choice((b"\0", b"\xff", b"", b" "))
    data[at : at + length] = fill * length or random.randbytes(length)


def _cut(data: bytearray, random: Random) -> None:
    del data[random.choice((0, len(data) // 2, len(data) - 1, random.randrange(len(data)))) :]


def _remove(data: bytearray, random: Random) -> None:
    at = random.randrange(len(data))
    del data[at : at + random.choice((1, 4, 16, 256))]


def _insert(data: bytearray, random: Random) -> None:
    at = random.randrange(len(data) + 1)
    data[at:at] = random.randbytes(random.choice((1, 4, 16, 256)))


def _repeat(data: bytearray, random: Random) -> None:
    at = random.randrange(len(data))
    data[at:at] = data[at : at + random.choice((1, 8, 64, 4096))] * random.choice((1, 2, 50))


def _word(data: bytearray, random: Random) -> None:
    data[:] = spoil_word(bytes(data), random, 0, len(data))


def spoil_word(data: bytes, random: Random, start: int, stop: int) -> bytes:
    """Put a number that asks for trouble somewhere into a range of bytes."""
    width = random.choice((1, 2, 4, 8))
    at = random.randrange(max(start, 0), max(stop - width + 1, start + 1))
    value = random.choice((*WORDS, len(data), len(data) + 1, random.getrandbits(64)))
    value &= (1 << 8 * width) - 1
    order = random.choice(("little", "big"))
    word = value.to_bytes(width, "little" if order == "little" else "big")
    return data[:at] + word + data[at + width :]


_WAYS: tuple[Callable[[bytearray, Random], None], ...] = (
    _flip, _flip, _overwrite, _cut, _remove, _insert, _repeat, _word, _word,
)  # fmt: skip


def spoil_bytes(data: bytes, random: Random) -> bytes:
    """Flip, overwrite, cut, remove, insert or repeat some bytes."""
    if not data:
        return random.randbytes(random.choice((1, 8, 100)))
    out = bytearray(data)
    random.choice(_WAYS)(out, random)
    return bytes(out)
