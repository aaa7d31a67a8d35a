"""Grey frames and the representation that exUMI trains on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = [
    "REPRESENTATION_GAIN",
    "Float32Array",
    "UInt8Array",
    "check_pair",
    "representation",
    "to_grey",
]

UInt8Array = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]

REPRESENTATION_GAIN = 7.0
"""Factor on differences from the reference in exUMI's representation."""


def to_grey(frame: UInt8Array) -> UInt8Array:
    """Convert a frame to grey.

    Parameters
    ----------
    frame
        (H, W, 3) uint8 RGB, (H, W, 1) uint8 or (H, W) uint8.

    Returns
    -------
    (H, W) uint8
        0.299 R + 0.587 G + 0.114 B, rounded. A view of the frame where it is grey already.

    Raises
    ------
    ValueError
        If shape or dtype is something else.
    """
    import cv2

    if (
        frame.dtype != np.uint8
        or frame.ndim not in (2, 3)
        or frame.shape[2:] not in ((), (1,), (3,))
    ):
        raise ValueError(
            f"a frame must be (H, W, 3), (H, W, 1) or (H, W) uint8, not {frame.shape} {frame.dtype}"
        )
    if frame.ndim == 2:
        return frame
    if frame.shape[2] == 1:
        return frame[:, :, 0]
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY), np.uint8)


def representation(
    grey: UInt8Array, reference: UInt8Array, *, gain: float = REPRESENTATION_GAIN
) -> Float32Array:
    """Compute the three channels exUMI trains on.

    Where the released code multiplies uint8 differences by 7 and wraps above 36 grey levels,
    this clamps.

    Parameters
    ----------
    grey
        (H, W) uint8 frame.
    reference
        (H, W), (H, W, 1) or (H, W, 3) uint8 image without contact.
    gain
        Factor on the differences.

    Returns
    -------
    (3, H, W) float32 in [0, 1]
        Grey, convex (``gain * max(grey - reference, 0)``), concave (``gain * max(reference - grey,
        0)``), each divided by 255.

    Raises
    ------
    ValueError
        If shapes or dtypes do not fit.
    """
    base = to_grey(reference)
    check_pair(grey, base)
    out = np.empty((3, *grey.shape), np.float32)
    np.multiply(grey, np.float32(1 / 255), out=out[0])
    np.subtract(grey, base, out=out[1], dtype=np.float32)
    out[1] *= np.float32(gain / 255)
    np.negative(out[1], out=out[2])
    np.clip(out[1:], 0, 1, out=out[1:])
    return out


def check_pair(grey: UInt8Array, reference: UInt8Array) -> None:
    """Check that two grey images are uint8 and of one shape."""
    if grey.dtype != np.uint8 or reference.dtype != np.uint8 or grey.ndim != 2:
        raise ValueError(
            f"grey frames must be (H, W) uint8, not {grey.shape} {grey.dtype} and "
            f"{reference.shape} {reference.dtype}"
        )
    if grey.shape != reference.shape:
        raise ValueError(f"frames differ in size: {grey.shape} and {reference.shape}")
