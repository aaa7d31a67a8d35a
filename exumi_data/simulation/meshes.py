"""Shapes for the wrist camera: the objects and the gripper as coloured polygons.

Object meshes use the objects' own reference frames and dimensions (see `objects`), finger meshes
the gripper's frame with the gel surface at x = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.simulation import surfaces as shape
from exumi_data.simulation.surfaces import Finger

__all__ = ["Mesh", "finger_mesh", "object_mesh"]

Float64Array = NDArray[np.float64]
Colour = tuple[float, float, float]

_STEEL: Colour = (176, 180, 188)
_BALL: Colour = (244, 216, 74)
_CAP: Colour = (226, 92, 46)
_BOTTLE: Colour = (88, 150, 196)
_BRASS: Colour = (205, 168, 84)
_BERRY: Colour = (206, 38, 50)
_SEED: Colour = (240, 206, 110)
_LEAF: Colour = (66, 140, 62)
_STAND: Colour = (70, 66, 74)
_FINGER: Colour = (58, 60, 68)
_HOUSING: Colour = (36, 38, 44)
_TRIM: Colour = (226, 120, 48)
_GEL: Colour = (196, 200, 206)


@dataclass(frozen=True, slots=True)
class Mesh:
    """Flat polygons of four corners.

    Attributes
    ----------
    vertices : ndarray of float64, shape (V, 3)
        Metres, in the frame of what the mesh shows.
    faces : ndarray of int64, shape (F, 4)
        Corners, anticlockwise seen from outside (a triangle repeats its last corner).
    colours : ndarray of float64, shape (F, 3)
        RGB, 0 to 255, before lighting.
    """

    vertices: Float64Array
    faces: NDArray[np.int64]
    colours: Float64Array

    def moved(self, shift: Sequence[float]) -> Mesh:
        """Return the mesh shifted by `shift`, metres."""
        return Mesh(self.vertices + np.asarray(shift), self.faces, self.colours)


def object_mesh(name: str) -> Mesh:
    """Return the mesh of the object called `name`, in its own frame.

    Raises
    ------
    ValueError
        If there is no mesh of that name.
    """
    makers = {"bolt": _bolt, "ball": _ball, "cap": _cap, "key": _key, "strawberry": _strawberry}
    if name not in makers:
        raise ValueError(f"Invalid object name ({name!r}). Supported values are {list(makers)}.")
    return makers[name]()


def finger_mesh(finger: Finger) -> Mesh:
    """Return a finger with its sensor, in the gripper's frame, its gel surface at x = 0."""
    parts = [
        _box((-0.0035, -0.0093, -0.0072), (0.0, 0.0093, 0.0072), _GEL),
        _box((-0.019, -0.0125, -0.030), (-0.0035, 0.0125, 0.0105), _HOUSING),
        _box((-0.0195, -0.013, -0.034), (-0.0030, 0.013, -0.030), _TRIM),
        _box((-0.017, -0.010, -0.110), (-0.0055, 0.010, -0.034), _FINGER),
    ]
    mesh = _join(parts)
    if finger == "left":
        return mesh
    return Mesh(mesh.vertices * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1], mesh.colours)


def _join(meshes: Sequence[Mesh]) -> Mesh:
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.vstack([mesh.vertices for mesh in meshes]),
        np.vstack([mesh.faces + start for mesh, start in zip(meshes, offsets, strict=True)]),
        np.vstack([mesh.colours for mesh in meshes]),
    )


def _box(low: Sequence[float], high: Sequence[float], colour: Colour) -> Mesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    vertices = np.asarray(low) + corners * (np.asarray(high) - np.asarray(low))
    return Mesh(vertices, faces, np.tile(np.array(colour, dtype=float), (6, 1)))


def _turned(
    heights: Sequence[float] | Float64Array,
    radii: Sequence[float] | Float64Array,
    segments: int,
    colour: Colour,
) -> Mesh:
    """Return a solid of revolution about z, its first height uppermost (smallest z)."""
    angle = np.arange(segments) * 2 * np.pi / segments
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = [
        np.hstack([ring * max(float(r), 1e-5), np.full((segments, 1), float(z))])
        for z, r in zip(heights, radii, strict=True)
    ]
    here = np.arange(segments)
    there = (here + 1) % segments
    faces = [
        np.stack([here, here + segments, there + segments, there], axis=1) + row * segments
        for row in range(len(rows) - 1)
    ]
    stacked = np.vstack(faces)[:, ::-1]
    return Mesh(np.vstack(rows), stacked, np.tile(np.array(colour, dtype=float), (len(stacked), 1)))


def _plate(outline: Float64Array, half_thickness: float, colour: Colour) -> Mesh:
    """Return a plate across x; `outline` (N, 2) in y, z, N even, mirrored strips as faces."""
    count = len(outline)
    near = np.hstack([np.full((count, 1), -half_thickness), outline])
    far = near * [-1.0, 1.0, 1.0]
    here = np.arange(count)
    there = (here + 1) % count
    rim = np.stack([here, there, there + count, here + count], axis=1)
    # The outline runs down one side and up the other: opposite points span the strips.
    first = np.arange(count // 2 - 1)
    strip = np.stack([first, first + 1, count - 2 - first, count - 1 - first], axis=1)
    faces = np.vstack([rim, strip[:, ::-1], strip + count])
    return Mesh(
        np.vstack([near, far]), faces, np.tile(np.array(colour, dtype=float), (len(faces), 1))
    )


def _bolt() -> Mesh:
    turns = np.arange(-15e-3, 13.5e-3, shape.BOLT_PITCH_M / 2)
    radii = shape.BOLT_RADIUS_M - 1.1e-3 * (np.arange(len(turns)) % 2)
    shaft = _turned(
        np.concatenate([[-16e-3, -16e-3], turns]),
        np.concatenate([[0, shape.BOLT_RADIUS_M - 1.4e-3], radii]),
        18,
        _STEEL,
    )
    colours = shaft.colours.copy()
    colours[np.arange(len(colours)) // 18 % 2 == 0] *= 0.72  # flanks that look down
    shaft = Mesh(shaft.vertices, shaft.faces, colours)
    head = _turned((14e-3, 14e-3, 24e-3), (0, 13e-3, 13e-3), 6, _STEEL)
    return _join([head, shaft])


def _ball() -> Mesh:
    angle = np.linspace(0, np.pi, 21)
    radius = shape.BALL_RADIUS_M
    return _turned(-radius * np.cos(angle), radius * np.sin(angle), 36, _BALL)


def _cap() -> Mesh:
    top, bottom, radius = shape.CAP_TOP_V_M, shape.CAP_BOTTOM_V_M, shape.CAP_RADIUS_M
    cap = _turned(
        (top, top, top + 1.2e-3, bottom - 2e-3, bottom - 1.4e-3, bottom),
        (0, radius - 1.2e-3, radius, radius, radius - 0.4e-3, radius),
        shape.CAP_RIDGES,
        _CAP,
    )
    ridges = cap.colours.copy()
    sides = np.arange(2 * shape.CAP_RIDGES, 3 * shape.CAP_RIDGES)
    ridges[sides[::2]] *= 0.72
    bottle = _turned(
        (bottom, 10e-3, 22e-3, 30e-3, 48e-3), (12.5e-3, 12.5e-3, 21e-3, 24e-3, 24e-3), 26, _BOTTLE
    )
    return _join([bottle, Mesh(cap.vertices, cap.faces, ridges)])


def _key() -> Mesh:
    z = np.concatenate(
        [
            shape.KEY_BOW_V_M - shape.KEY_BOW_RADIUS_M * np.cos(np.linspace(0.05, 2.6, 14)),
            np.linspace(shape.KEY_BLADE_V_M, 22e-3, 24),
        ]
    )
    bow = np.sqrt(np.maximum(shape.KEY_BOW_RADIUS_M**2 - (z - shape.KEY_BOW_V_M) ** 2, 0.0))
    blade = z > shape.KEY_BOW_V_M
    left = np.where(blade, np.maximum(bow, shape.KEY_BLADE_HALF_M), bow)
    right = np.where(blade, np.maximum(bow, shape.KEY_BLADE_HALF_M - shape.key_cut_depth_m(z)), bow)
    outline = np.vstack([np.stack([-left, z], 1), np.stack([right, z], 1)[::-1]])
    plate = _plate(outline, shape.KEY_THICKNESS_M / 2, _BRASS)
    block = _box((-0.012, -0.012, 0.021), (0.012, 0.012, 0.030), _STAND)
    return _join([block, plate])


def _strawberry() -> Mesh:
    top, tip = shape.BERRY_TOP_V_M, shape.BERRY_TIP_V_M
    z = np.concatenate([[top, top + 0.6e-3], np.linspace(top + 2e-3, tip, 13)])
    body = _turned(z, shape.berry_radius_m(z), 26, _BERRY)
    colours = body.colours.copy()
    row, column = np.divmod(np.arange(len(colours)), 26)
    colours[((column + 2 * (row % 2)) % 4 == 0) & (row > 1) & (row < 13)] = _SEED
    leaves = _turned((top - 2.5e-3, top - 0.5e-3, top + 1.6e-3), (0, 4e-3, 11e-3), 9, _LEAF)
    stand = _turned((15e-3, 15e-3, 22e-3), (7e-3, 11e-3, 13e-3), 22, _STAND)
    return _join([stand, Mesh(body.vertices, body.faces, colours), leaves])
