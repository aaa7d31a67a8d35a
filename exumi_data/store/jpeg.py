"""JPEG files: decoded straight into the caller's buffer, and never changed."""

from functools import lru_cache
from typing import Literal

import numpy as np
import simplejpeg

from exumi_data.errors import DamagedDataError

__all__ = ["check", "comment", "decode_into", "encode", "is_jpeg", "size_of"]

_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
_COM, _SOS = 0xFE, 0xDA
_SCAN = b"\xff\xda"
_MAX_SCANS = 64  # progressive ones of every writer have about ten
_BASELINE = (0xC0, 0xC1)
_TABLES = (0xC4, 0xDB, 0xDD, _COM, *range(0xE0, 0xF0))
_MAX_HEADER = 4096
_CHANNELS = {"Gray": 1, "YCbCr": 3, "RGB": 3}


def is_jpeg(data: bytes) -> bool:
    """Whether `data` begins and ends as a JPEG (zero padding after the end is allowed)."""
    return data.startswith(_SOI) and data.rstrip(b"\0").endswith(_EOI)


def size_of(data: bytes) -> tuple[int, int, int]:
    """Return (height, width, channels) from a JPEG's header.

    Raises
    ------
    DamagedDataError
        Not a JPEG.
    """
    try:
        height, width, colorspace, _ = simplejpeg.decode_jpeg_header(data, strict=False)
        channels = _CHANNELS[colorspace]
    except (ValueError, KeyError) as error:
        raise DamagedDataError(f"not a JPEG of grey or colour ({error})") from None
    return int(height), int(width), channels


def check(data: bytes, size: tuple[int, int]) -> None:
    """Check a JPEG that another decoder gets: its (height, width), and the number of its scans.

    Raises
    ------
    DamagedDataError
        It is no JPEG, of another size, or made to keep a decoder busy.
    """
    _check_scans(data)
    found = size_of(data)[:2]
    if found != size:
        raise DamagedDataError(
            f"the JPEG is {found[1]}x{found[0]}, the metadata says {size[1]}x{size[0]}"
        )


def _check_scans(data: bytes) -> None:
    # Each scan goes over the whole picture, and one of ten bytes can be repeated a thousand times.
    # Inside the data of a scan there can be no such marker.
    if data.count(_SCAN) > _MAX_SCANS:
        raise DamagedDataError(f"the JPEG has more than {_MAX_SCANS} scans")


def _has_one_scan(data: bytes) -> bool:
    """Whether the header shows that the decoder goes over the picture once, whatever follows.

    That is so where the first scan of a baseline JPEG holds all components: libjpeg then refuses a
    second one. Counting the scans of all frames would take a twentieth of decoding them.
    """
    start = data.find(_SCAN, 0, _MAX_HEADER)
    return 0 < start <= len(data) - 5 and _promises_one_scan(data[: start + 5])


@lru_cache(maxsize=64)  # the files of one writer have the same tables
def _promises_one_scan(header: bytes) -> bool:
    """Judge what leads to the first scan, and its marker, length and number of components."""
    position, components, scan = 2, 0, len(header) - 5
    while position < scan:
        prefix, marker = header[position], header[position + 1]
        length = int.from_bytes(header[position + 2 : position + 4], "big")
        if prefix != 0xFF or length < 2:
            return False
        if marker in _BASELINE and not components:
            components = int.from_bytes(header[position + 9 : position + 10], "big")
        elif marker not in _TABLES:
            return False
        position += 2 + length
    return header.startswith(_SOI) and position == scan and header[-1] == components > 0


def comment(data: bytes) -> str | None:
    """Return the comment (COM segment) of a JPEG, or None. It often names the encoder."""
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF:  # marker prefix
        marker = data[position + 1]
        length = int.from_bytes(data[position + 2 : position + 4], "big")
        if marker == _COM:
            text = data[position + 4 : position + 2 + length]
            return text.decode("latin-1").strip("\0 \r\n") or None
        if marker == _SOS:
            return None
        position += 2 + length
    return None


def decode_into(data: bytes, out: np.ndarray) -> None:
    """Decode a JPEG into `out`, shape (H, W, C) uint8, C-contiguous.

    With C = 1 the image's luma is decoded, whatever its channels: no colour is computed that
    nobody asked for. With C = 3 the order is RGB.

    Raises
    ------
    DamagedDataError
        The JPEG is damaged, or its size is not that of `out`.
    """
    if not _has_one_scan(data):
        _check_scans(data)
    try:
        decoded = simplejpeg.decode_jpeg(data, "GRAY" if out.shape[2] == 1 else "RGB", buffer=out)
    except ValueError as error:
        _check_scans(data)
        _check_size(size_of(data), out)
        raise DamagedDataError(f"the JPEG is damaged ({error})") from None
    # The decoder fills the front of a buffer that is too large without a word.
    if decoded.shape != out.shape:
        _check_size(decoded.shape, out)


def _check_size(size: tuple[int, ...], out: np.ndarray) -> None:
    if size[:2] != out.shape[:2]:
        raise DamagedDataError(
            f"the JPEG is {size[1]}x{size[0]}, the metadata says {out.shape[1]}x{out.shape[0]}"
        ) from None


def encode(frame: np.ndarray, quality: int, *, chroma: Literal["420", "444"] = "420") -> bytes:
    """Encode a frame, shape (H, W, 1|3) uint8 RGB, as JPEG.

    With `chroma` 420 its colours have half the resolution, as those of nearly every camera.
    """
    frame = np.ascontiguousarray(frame)
    if frame.shape[2] == 1:
        return bytes(simplejpeg.encode_jpeg(frame, quality, "GRAY", "Gray"))
    return bytes(simplejpeg.encode_jpeg(frame, quality, "RGB", chroma))
