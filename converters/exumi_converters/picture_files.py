"""Pictures of strangers: PNG and WebP, decoded once their headers promise not to be too large."""

import struct

import numpy as np

from exumi_data.store.video import MAX_PIXELS

__all__ = ["check_size", "decode_picture"]

_PNG = b"\x89PNG\r\n\x1a\n"


def check_size(height: int, width: int) -> None:
    """Check that a picture does not claim more pixels than are decoded.

    Parameters
    ----------
    height, width : int

    Raises
    ------
    ValueError
        It does, or claims none.
    """
    if not 0 < height * width <= MAX_PIXELS:
        msg = f"a picture claims {width}x{height} pixels"
        raise ValueError(msg)


def decode_picture(data: bytes) -> np.ndarray:
    """Decode a PNG or WebP file.

    Parameters
    ----------
    data : bytes

    Returns
    -------
    (H, W, 3) uint8 ndarray
        RGB.

    Raises
    ------
    ValueError
        It is neither, damaged, or too large.
    """
    import cv2

    size = _size_of(data)
    if size is None:
        msg = "a picture is no JPEG, PNG or WebP, or is cut short"
        raise ValueError(msg)
    check_size(*size)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
    if image is None or image.shape[:2] != size:
        msg = "a picture cannot be decoded"
        raise ValueError(msg)
    return np.asarray(image, np.uint8)


def _size_of(data: bytes) -> tuple[int, int] | None:
    """Return height and width as the header says; None: it is none that is read."""
    if data.startswith(_PNG) and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return height, width
    if len(data) < 30 or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        return None
    form = data[12:16]
    if form == b"VP8 ":
        width, height = struct.unpack("<HH", data[26:30])
        return height & 0x3FFF, width & 0x3FFF
    if form == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
    if form == b"VP8X":
        width = int.from_bytes(data[24:27], "little") + 1
        return int.from_bytes(data[27:30], "little") + 1, width
    return None
