"""Presses of objects of known hardness and roughness into a gel pad.

Two things of an object are known: how stiff it is against the gel, and how high its relief is.
Pressed together by some distance, gel and object share it as two springs in a row do; what is soft
flattens, so that its shape and its relief leave a weaker imprint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from exumi_data.simulation.gel import Contact, GelPad
from exumi_data.simulation.gel_look import make_pad
from exumi_data.simulation.objects import MAP_SIDE_M, NO_SURFACE_M
from exumi_data.simulation.pixels import Float32Array, UInt8Array, as_float32

__all__ = ["Press", "TouchedPart", "make_parts", "simulate_press"]

_TRAVEL_M = 1.3e-3
_SOFTEST, _HARDEST = -0.7, 1.5  # decimal logarithm of the stiffness relative to the gel's
_SMOOTHEST_M, _ROUGHEST = 8e-6, 40.0  # relief of roughness 0, and how much higher it is at 10


@dataclass(frozen=True, slots=True)
class TouchedPart:
    """A part of an object, as a finger feels it.

    Attributes
    ----------
    name : str
    hardness : float
        0 (a fifth as stiff as the gel) to 10 (thirty times as stiff), on a logarithmic scale.
    roughness : float
        0 (a relief of 8 micrometres) to 10 (0.3 millimetres), on a logarithmic scale.
    radius_m : float
        Of the dome that is pressed into the gel.
    grain_m : float
        Width of the bumps of its relief.
    seed : int
        Of the relief.
    """

    name: str
    hardness: float
    roughness: float
    radius_m: float
    grain_m: float
    seed: int


@dataclass(frozen=True, slots=True)
class Press:
    """A part pressed into a pad and let go.

    Attributes
    ----------
    time_ns : (N,) int64
    frames : (N, H, W, 3) uint8
        RGB; the first and the last are without contact.
    reference : (H, W, 3) uint8
        The pad without contact.
    """

    time_ns: np.ndarray
    frames: UInt8Array
    reference: UInt8Array


def make_parts(count: int, *, seed: int = 0) -> tuple[TouchedPart, ...]:
    """Return parts that differ in hardness, roughness, curvature and grain, each on its own.

    Parameters
    ----------
    count : int
    seed : int

    Returns
    -------
    tuple of TouchedPart
    """
    rng = np.random.default_rng(seed)
    # Evenly spread in each property, in an order of its own.
    even = (np.arange(count) + 0.5) / count
    hardness, roughness, radius, grain = (rng.permutation(even) for _ in range(4))
    return tuple(
        TouchedPart(
            name=f"part_{number:02d}",
            hardness=round(10 * hardness[number], 2),
            roughness=round(10 * roughness[number], 2),
            radius_m=0.006 * 8 ** radius[number],
            grain_m=0.3e-3 * 5 ** grain[number],
            seed=int(rng.integers(1 << 31)),
        )
        for number in range(count)
    )


def simulate_press(
    part: TouchedPart, *, seed: int, frames: int = 14, size: tuple[int, int] = (96, 128)
) -> Press:
    """Press a part into a pad: somewhere else, turned, and a little harder or softer each time.

    Parameters
    ----------
    part : TouchedPart
    seed : int
        Of place, turn and travel.
    frames : int
        At 25 Hz.
    size : (int, int)
        Height and width of the images, pixels.

    Returns
    -------
    Press

    Raises
    ------
    ValueError
        There are fewer than 3 frames.
    """
    if frames < 3:
        raise ValueError(f"{frames} frames: a press needs at least 3")
    rng = np.random.default_rng((part.seed, seed))
    pad = make_pad(size, dotted=False, seed=0)
    stiffness = 10 ** (_SOFTEST + part.hardness / 10 * (_HARDEST - _SOFTEST))
    share = stiffness / (1 + stiffness)
    height = as_float32(np.maximum(share * _surface(part, pad, rng), NO_SURFACE_M))
    travel = _TRAVEL_M * share * rng.uniform(0.85, 1.15)
    u, v = rng.uniform(-2e-3, 2e-3, 2)
    angle = rng.uniform(-math.pi, math.pi)
    drawn = [
        pad.render(height, Contact(depth, u, v, angle), int(noise))
        for depth, noise in zip(
            travel * np.sin(np.linspace(0, math.pi, frames)) ** 2 - 1e-9,
            rng.integers(1 << 31, size=frames),
            strict=True,
        )
    ]
    return Press(np.arange(frames) * 40_000_000, np.stack(drawn), pad.reference())


def _surface(part: TouchedPart, pad: GelPad, rng: np.random.Generator) -> Float32Array:
    """Return the height map of a dome with relief, (S, S), 0 at its outermost point, metres."""
    half = round(MAP_SIDE_M / 2 / pad.m_per_px)
    axis = np.arange(-half, half + 1) * pad.m_per_px
    u, v = np.meshgrid(axis, axis)
    dome = np.sqrt(np.maximum(part.radius_m**2 - u**2 - v**2, 0)) - part.radius_m
    # The same relief all over the part; each press meets another piece of it.
    relief = np.random.default_rng(part.seed).standard_normal(dome.shape)
    relief = np.roll(relief, rng.integers(0, len(axis), 2), axis=(0, 1))
    relief = cv2.GaussianBlur(relief, (0, 0), part.grain_m / 2 / pad.m_per_px)
    relief *= _SMOOTHEST_M * _ROUGHEST ** (part.roughness / 10) / relief.std()
    surface = dome + relief
    return as_float32(surface - surface.max())
