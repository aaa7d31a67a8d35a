"""How the frames of a buffer are coded."""

from collections.abc import Callable
from typing import Any

import numpy as np

from exumi_data.errors import MissingExtraError, UsageError

__all__ = ["codec_config", "encoder"]

# As UMI's own class writes it, so that it, and imagecodecs of any version, read it.
_JPEGXL: dict[str, Any] = {
    "decodingspeed": None,
    "distance": None,
    "effort": None,
    "id": "imagecodecs_jpegxl",
    "index": None,
    "keeporientation": None,
    "level": 99,
    "lossless": False,
    "numthreads": 1,
    "photometric": None,
    "planar": None,
    "usecontainer": None,
}
_LOSSLESS = _JPEGXL | {"effort": 2, "level": None, "lossless": True}
_BLOSC: dict[str, Any] = {
    "blocksize": 0,
    "clevel": 5,
    "cname": "zstd",
    "id": "blosc",
    "shuffle": 1,
}
_CODECS = {"jpegxl": _JPEGXL, "jpegxl-lossless": _LOSSLESS, "blosc": _BLOSC}


def codec_config(images: str, *, tactile: bool) -> dict[str, Any]:
    """Return a codec's ``.zarray`` entry.

    Parameters
    ----------
    images : {"jpegxl", "jpegxl-lossless", "blosc"}
    tactile : bool
        Tactile images are always coded without loss.
    """
    if tactile and images == "jpegxl":
        images = "jpegxl-lossless"
    return dict(_CODECS[images])


def encoder(config: dict[str, Any]) -> Callable[[np.ndarray], bytes]:
    """Return a function that codes one chunk, (H, W, C) uint8.

    Raises
    ------
    MissingExtraError
        imagecodecs is not installed.
    """
    if config["id"] == "blosc":
        from numcodecs import Blosc

        codec = Blosc(cname=config["cname"], clevel=config["clevel"], shuffle=config["shuffle"])
        return lambda frame: bytes(codec.encode(np.ascontiguousarray(frame)))
    try:
        import imagecodecs
    except ImportError:
        raise MissingExtraError(
            "JPEG XL needs imagecodecs, which is not installed",
            fix="Install it: pip install 'exumi-data[umi]'; or pass -o images=blosc.",
        ) from None
    if not imagecodecs.JPEGXL.available:
        raise UsageError("this build of imagecodecs has no JPEG XL", fix="Pass -o images=blosc.")
    keys = ("level", "effort", "distance", "lossless", "numthreads")
    settings = {key: config[key] for key in keys}

    def encode(frame: np.ndarray) -> bytes:
        pixels = frame[..., 0] if frame.shape[2] == 1 else frame
        return bytes(imagecodecs.jpegxl_encode(np.ascontiguousarray(pixels), **settings))

    return encode
