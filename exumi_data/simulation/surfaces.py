"""The shapes of the objects' faces, as heights over the plane of a fingertip.

Each function takes a finger and grids of u (right) and v (down) as that finger's camera sees
them, in metres from the grasp point, and returns heights in metres towards the finger: 0 at the
outermost point, negative elsewhere. `objects` describes the reference frames.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BALL_RADIUS_M",
    "BERRY_RADIUS_M",
    "BERRY_TIP_V_M",
    "BERRY_TOP_V_M",
    "BOLT_PITCH_M",
    "BOLT_RADIUS_M",
    "CAP_BOTTOM_V_M",
    "CAP_RADIUS_M",
    "CAP_RIDGES",
    "CAP_TOP_V_M",
    "KEY_BLADE_HALF_M",
    "KEY_BLADE_V_M",
    "KEY_BOW_RADIUS_M",
    "KEY_BOW_V_M",
    "KEY_THICKNESS_M",
    "Finger",
    "ball",
    "berry_radius_m",
    "bolt",
    "cap",
    "key",
    "key_cut_depth_m",
    "strawberry",
]

Finger = Literal["left", "right"]
Float64Array = NDArray[np.float64]

WALL_SLOPE = 8.0
"""Slope of an object's side walls: not vertical, or the imprint's edge would be a staircase."""


def _cylinder(radius_m: float, u: Float64Array) -> Float64Array:
    """Return the height of an upright cylinder, 0 on its ridge line."""
    height: Float64Array = np.sqrt(np.maximum(radius_m**2 - u**2, 0.0)) - radius_m
    return height


def _smooth_step(x: Float64Array) -> Float64Array:
    """Return x clamped to 0..1, with soft ends."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


BOLT_RADIUS_M = 8e-3
BOLT_PITCH_M = 2.0e-3


def bolt(finger: Finger, u: Float64Array, v: Float64Array) -> Float64Array:
    """Return a bolt's ISO-like thread: 60 degree flanks, crest and root cut flat."""
    angle = np.arcsin(np.clip(u / BOLT_RADIUS_M, -1.0, 1.0))
    turn = 0.0 if finger == "left" else np.pi
    phase = (v / BOLT_PITCH_M + (angle + turn) / (2 * np.pi)) % 1.0
    flank = np.clip(np.abs(phase - 0.5) * 3.2 - 0.22, 0.0, 1.0)
    return _cylinder(BOLT_RADIUS_M, u) - 0.85e-3 * flank


BALL_RADIUS_M = 21e-3
BALL_DIMPLE_RADIUS_M = 1.65e-3


def ball(finger: Finger, u: Float64Array, v: Float64Array) -> Float64Array:
    """Return a golf ball: a sphere with dimples."""
    height = np.sqrt(np.maximum(BALL_RADIUS_M**2 - u**2 - v**2, 0.0)) - BALL_RADIUS_M
    sign = -1.0 if finger == "left" else 1.0
    for centre in _even_directions(392) * BALL_RADIUS_M:
        if centre[0] * sign > 0.5 * BALL_RADIUS_M:
            patch = _around(u, v, -sign * centre[1], centre[2], BALL_DIMPLE_RADIUS_M)
            away = (u[patch] + sign * centre[1]) ** 2 + (v[patch] - centre[2]) ** 2
            height[patch] -= 0.26e-3 * np.maximum(1.0 - away / BALL_DIMPLE_RADIUS_M**2, 0.0)
    return _from_top(height)


def _from_top(height: Float64Array) -> Float64Array:
    """Return heights shifted so that the outermost point is at 0."""
    top: Float64Array = height - height.max()
    return top


def _around(
    u: Float64Array, v: Float64Array, centre_u: float, centre_v: float, reach: float
) -> tuple[slice, slice]:
    """Return the part of the grid (`u`, `v`) within `reach` of a centre, all in metres."""
    columns = np.searchsorted(u[0], [centre_u - reach, centre_u + reach])
    rows = np.searchsorted(v[:, 0], [centre_v - reach, centre_v + reach])
    return slice(int(rows[0]), int(rows[1])), slice(int(columns[0]), int(columns[1]))


def _even_directions(count: int) -> Float64Array:
    """Return `count` unit vectors spread evenly over the sphere (Fibonacci lattice), (N, 3)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    # The lattice's axis is y here, so that its poles are not what the fingers touch.
    return np.stack([radius * np.cos(angle), z, radius * np.sin(angle)], axis=1)


CAP_RADIUS_M = 14e-3
CAP_RIDGES = 54
CAP_TOP_V_M = -7.5e-3
CAP_BOTTOM_V_M = 5.5e-3


def cap(finger: Finger, u: Float64Array, v: Float64Array) -> Float64Array:
    """Return a bottle cap: ridges, and below them the tamper band."""
    angle = np.arcsin(np.clip(u / CAP_RADIUS_M, -1.0, 1.0))
    turn = 0.0 if finger == "left" else 0.3
    ridge = np.abs(np.sin(0.5 * CAP_RIDGES * angle + turn))
    knurled = _smooth_step((v - CAP_TOP_V_M - 0.8e-3) / 0.8e-3) * _smooth_step(
        (CAP_BOTTOM_V_M - 2.2e-3 - v) / 0.5e-3
    )
    height = _cylinder(CAP_RADIUS_M, u) - 0.45e-3 * (1.0 - ridge**0.8) * knurled
    # The tamper band: a groove between the ridges and the lower ring.
    height -= 0.5e-3 * np.exp(-(((v - (CAP_BOTTOM_V_M - 1.6e-3)) / 0.28e-3) ** 4))
    rounding = 0.9e-3 * (1.0 - _smooth_step((v - CAP_TOP_V_M) / 1.3e-3))
    outside = np.maximum(CAP_TOP_V_M - v, v - CAP_BOTTOM_V_M)
    return height - rounding - WALL_SLOPE * np.maximum(outside, 0.0)


KEY_THICKNESS_M = 2.4e-3
KEY_BOW_V_M = -8.5e-3
KEY_BOW_RADIUS_M = 9.0e-3
KEY_HOLE_RADIUS_M = 2.4e-3
KEY_HOLE_V_M = -10.5e-3
KEY_BLADE_HALF_M = 3.6e-3
KEY_CUTS_M = (0.6e-3, 2.2e-3, 1.2e-3, 2.8e-3, 0.9e-3, 1.9e-3)
KEY_CUT_PITCH_M = 2.6e-3
KEY_BLADE_V_M = 1.5e-3


def key_cut_depth_m(v: Float64Array) -> Float64Array:
    """Return how deep the key's blade is cut at heights `v`, all in metres."""
    position = (v - KEY_BLADE_V_M) / KEY_CUT_PITCH_M
    knots: list[float] = [-1.0, 0.0]
    depths: list[float] = [0.0, 0.0]
    for index, cut in enumerate(KEY_CUTS_M):
        knots += [index + 0.35, index + 0.65]
        depths += [cut, cut]
    return np.interp(position, knots, depths)


def key(finger: Finger, u: Float64Array, v: Float64Array) -> Float64Array:
    """Return a flat key: a round bow with a hole and a ring, a blade with cuts and a groove."""
    y = u if finger == "left" else -u
    bow = KEY_BOW_RADIUS_M - np.hypot(y, v - KEY_BOW_V_M)
    hole = np.hypot(y, v - KEY_HOLE_V_M) - KEY_HOLE_RADIUS_M
    blade = np.minimum(
        np.minimum(KEY_BLADE_HALF_M - key_cut_depth_m(v) - y, y + KEY_BLADE_HALF_M), v + 4e-3
    )
    inside = np.minimum(np.maximum(bow, blade), hole)  # distance to the nearest edge
    bevel = 0.35e-3 * (1.0 - _smooth_step(inside / 0.4e-3))
    groove = 0.55e-3 * _smooth_step(1.6 - np.abs(y + 0.9e-3) / 0.55e-3) * (v > -1.5e-3)
    ring = np.abs(bow - 1.5e-3) / 0.3e-3
    engraved = 0.22e-3 * _smooth_step(1.5 - ring) * (v < -2.5e-3)
    return -bevel - groove - engraved - WALL_SLOPE * np.maximum(-inside, 0.0)


BERRY_RADIUS_M = 15e-3
BERRY_TOP_V_M = -13e-3
BERRY_TIP_V_M = 22e-3
BERRY_ROW_M = 2.7e-3
BERRY_COLUMN_RAD = 0.235


def berry_radius_m(v: Float64Array) -> Float64Array:
    """Return the strawberry's radius (metres) at heights `v` (metres); widest near zero."""
    above = np.clip(v / BERRY_TOP_V_M, 0.0, 1.0)
    below = np.clip(v / BERRY_TIP_V_M, 0.0, 1.0)
    part: Float64Array = np.where(v < 0, np.sqrt(1.0 - above**2), (1.0 - below**2) ** 0.7)
    return BERRY_RADIUS_M * part


def strawberry(finger: Finger, u: Float64Array, v: Float64Array) -> Float64Array:
    """Return a strawberry: a swelling berry with seeds in pits."""
    height = np.sqrt(np.maximum(berry_radius_m(v) ** 2 - u**2, 0.0))
    start = 0.2 if finger == "left" else 0.5
    for row in range(-3, 7):
        for column in range(-5, 6):
            angle = (column + 0.5 * (row % 2) + start) * BERRY_COLUMN_RAD
            centre_v = (row + start) * BERRY_ROW_M
            centre_u = float(berry_radius_m(np.array(centre_v))) * np.sin(angle)
            patch = _around(u, v, centre_u, centre_v, 2.4e-3)
            height[patch] += _seed(u[patch] - centre_u, v[patch] - centre_v, float(np.cos(angle)))
    return _from_top(height)


def _seed(u: Float64Array, v: Float64Array, cosine: float) -> Float64Array:
    """Return the height of one seed in its pit, seen under an angle with this `cosine`."""
    across = u / max(cosine, 0.2)
    pit = np.exp(-(across**2 + (0.85 * v) ** 2) / (0.8e-3**2))
    seed = (across / 0.42e-3) ** 2 + (v / 0.72e-3) ** 2
    return 0.5e-3 * np.exp(-(seed**2)) - 0.62e-3 * pit
