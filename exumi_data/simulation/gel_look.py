"""What a gel pad looks like untouched: its three lights, its dots, its specks and its noise."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from exumi_data.simulation.pixels import Float32Array, as_float32

if TYPE_CHECKING:
    from exumi_data.simulation.gel import GelPad

__all__ = ["COLOUR_MIX", "LIGHT_DIRECTIONS", "NOISE_MARGIN", "PAD_WIDTH_M", "make_pad"]

PAD_WIDTH_M = 18.6e-3
"""Width of the imaged gel: GelSight Mini's."""

NOISE_MARGIN = 64
"""By how many pixels the noise is larger than the image, along both axes."""

_AZIMUTHS_DEG = (205.0, 335.0, 90.0)  # red, green, blue; anticlockwise from image right
_SLOPE = 2.6  # cotangent of the lights' elevation above the gel

LIGHT_DIRECTIONS = np.array(
    [
        [-_SLOPE * math.cos(math.radians(a)), _SLOPE * math.sin(math.radians(a)), 1.0]
        for a in _AZIMUTHS_DEG
    ]
)
"""(3, 3): by what the slopes (right, down) and 1 are multiplied to give each light's Lambert term.

A slope rises towards the camera; the side of a bump that faces a light is bright."""

COLOUR_MIX = np.array([[1.0, 0.13, 0.10], [0.14, 0.92, 0.20], [0.12, 0.20, 1.0]])
"""(3, 3): camera RGB from the lights; diodes and filters overlap a little."""

_NOISE_SIGMA = 1.2
_DOT_PITCH_M = 1.95e-3
_DOT_RADIUS_M = 0.30e-3


def make_pad(size: tuple[int, int], *, dotted: bool, seed: int) -> GelPad:
    """Return a gel pad of the given image size.

    Parameters
    ----------
    size : (int, int)
        Height and width of its image, pixels.
    dotted : bool
        Whether a grid of dots is printed on the gel.
    seed : int
        Chooses small differences between pads: the balance of the lights, specks, noise.

    Returns
    -------
    GelPad
        The pad.
    """
    from exumi_data.simulation.gel import GelPad

    rng = np.random.default_rng(seed)
    m_per_px = PAD_WIDTH_M / size[1]
    lights = _lights(size, rng) * (_mottle(size, rng) * _specks(size, m_per_px, rng))[..., None]
    shape = (size[0] + NOISE_MARGIN, size[1] + NOISE_MARGIN, 3)
    noise = _NOISE_SIGMA * rng.standard_normal(shape, dtype=np.float32)
    return GelPad(m_per_px, as_float32(lights), _dots(size, m_per_px, dotted), noise)


def _grid(size: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x (right) and y (down) of every pixel, from the centre, in half widths."""
    rows, columns = size
    x = (np.arange(columns) - (columns - 1) / 2) / (columns / 2)
    y = (np.arange(rows) - (rows - 1) / 2) / (columns / 2)
    grid_x, grid_y = np.meshgrid(x, y)
    return grid_x, grid_y


def _lights(size: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    x, y = _grid(size)
    maps = []
    for azimuth, base in zip(np.deg2rad(_AZIMUTHS_DEG), (92.0, 100.0, 98.0), strict=True):
        away = (x - 1.15 * np.cos(azimuth)) ** 2 + (y + 0.95 * np.sin(azimuth)) ** 2
        maps.append(base * rng.uniform(0.96, 1.04) + 36.0 * np.exp(-away / (2 * 0.62**2)))
    vignette = 1.0 - 0.20 * (x**2 + y**2) ** 1.5
    return np.stack(maps, axis=-1) * vignette[..., None]


def _mottle(size: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a weak cloudiness of the coating, half a percent."""
    import cv2

    coarse = rng.standard_normal((max(size[0] // 12, 2), max(size[1] // 12, 2)))
    cloud = cv2.resize(coarse, (size[1], size[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(1.0 + 0.004 * cloud, dtype=np.float64)


def _specks(
    size: tuple[int, int], m_per_px: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return a few specks of dust, as every used pad has."""
    rows, columns = np.mgrid[0 : size[0], 0 : size[1]]
    factor = np.ones(size)
    for _ in range(7):
        row, column = rng.uniform(0, size[0]), rng.uniform(0, size[1])
        radius_px = rng.uniform(0.05e-3, 0.10e-3) / m_per_px
        away = ((rows - row) ** 2 + (columns - column) ** 2) / radius_px**2
        factor *= 1.0 - rng.uniform(0.1, 0.35) * np.exp(-away)
    return factor


def _dots(size: tuple[int, int], m_per_px: float, dotted: bool) -> Float32Array | None:
    if not dotted:
        return None
    x, y = _grid(size)
    scale = m_per_px * size[1] / 2 / _DOT_PITCH_M
    away = np.hypot(x * scale - np.round(x * scale), y * scale - np.round(y * scale))
    edge = 0.06e-3 / _DOT_PITCH_M
    ink = 1.0 / (1.0 + np.exp((away - _DOT_RADIUS_M / _DOT_PITCH_M) / (edge / 3)))
    return (1.0 - 0.82 * ink).astype(np.float32)
