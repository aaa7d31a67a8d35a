"""Drawing lit polygons from far to near."""

from __future__ import annotations

import cv2
import numpy as np

from exumi_data.simulation.motion import Float64Array
from exumi_data.simulation.pixels import UInt8Array

__all__ = ["LAMP", "NEAR_M", "SUBPIXEL_BITS", "paint_faces"]

LAMP = np.array([-0.45, 0.35, 0.82])
"""Towards the lamp, in the world's frame."""

SUBPIXEL_BITS = 3
"""Bits behind the point in the pixel coordinates that OpenCV gets."""

NEAR_M = 0.012
"""Nothing nearer to the camera than this is drawn."""

_AMBIENT = 0.42
_DIFFUSE = 0.62
_SKY = 0.10
_GLINT = 55.0
_GLINT_SHARPNESS = 24
_FAR_OUT_PX = 4e3


def paint_faces(
    canvas: UInt8Array,
    corners_m: Float64Array,
    seen: Float64Array,
    colours: Float64Array,
    eye_m: Float64Array,
) -> None:
    """Draw the faces that look at the camera onto `canvas`, far ones first.

    Parameters
    ----------
    canvas : ndarray of uint8, shape (H, W, 3)
        RGB picture, drawn upon.
    corners_m : ndarray of float64, shape (F, 4, 3)
        The faces' corners in the world's frame, metres.
    seen : ndarray of float64, shape (F, 4, 3)
        The corners' column and row on the canvas (pixels) and their depth (metres).
    colours : ndarray of float64, shape (F, 3)
        RGB before lighting, 0 to 255.
    eye_m : ndarray of float64, shape (3,)
        Where the camera is, in the world's frame, metres.
    """
    normal = np.cross(corners_m[:, 2] - corners_m[:, 0], corners_m[:, 3] - corners_m[:, 1])
    towards = eye_m - corners_m.mean(axis=1)
    visible = ((normal * towards).sum(axis=1) > 0) & (seen[..., 2] > NEAR_M).all(axis=1)
    order = np.argsort(-np.linalg.norm(towards, axis=1))
    order = order[visible[order]]
    lit = _lit(colours[order], normal[order], towards[order]).tolist()
    pixels = np.clip(seen[order, :, :2], -_FAR_OUT_PX, _FAR_OUT_PX) * (1 << SUBPIXEL_BITS)
    polygons = np.round(pixels).astype(np.int32)
    for polygon, colour in zip(polygons, lit, strict=True):
        cv2.fillConvexPoly(canvas, polygon, colour, cv2.LINE_8, SUBPIXEL_BITS)


def _lit(colours: Float64Array, normal: Float64Array, towards: Float64Array) -> Float64Array:
    """Return the faces' colours under the lamp, with a weak highlight."""
    normal, lamp = _unit(normal), _unit(LAMP)
    diffuse = np.maximum(normal @ lamp, 0.0)
    half = _unit(_unit(towards) + lamp)
    glint = np.maximum((normal * half).sum(axis=1), 0.0) ** _GLINT_SHARPNESS
    brightness = _AMBIENT + _SKY * normal[:, 2] + _DIFFUSE * diffuse
    lit: Float64Array = colours * brightness[:, None] + _GLINT * glint[:, None]
    return np.clip(lit, 0.0, 255.0)


def _unit(vectors: Float64Array) -> Float64Array:
    """Return vectors, the last axis, scaled to length 1; null vectors stay."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Float64Array = vectors / np.maximum(length, 1e-15)
    return unit
