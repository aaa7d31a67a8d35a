"""The objects of the play session, as the two height maps that the fingertips feel.

Reference frame of an object: origin at the grasp point, x through both contact faces (the left
finger touches the face at negative x), z down into the table, y completing a right-handed frame.
When the gripper holds the object without offset, this frame is the gripper's.

Each side is a height map in the coordinates of the finger that touches it: u to the right and v
down as that finger's camera sees it (left: u = y, v = z; right: u = -y, v = z). Heights are
metres towards the finger, 0 at the outermost point and negative elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from exumi_data.simulation import surfaces as shape
from exumi_data.simulation.surfaces import Finger

__all__ = ["OBJECTS", "Finger", "SimulatedObject", "height_map", "object_by_name"]

Float64Array = NDArray[np.float64]
Surface = Callable[[Finger, Float64Array, Float64Array], Float64Array]

MAP_SIDE_M = 0.036
"""Side of a height map; a pad's diagonal and the largest offset fit in it."""

NO_SURFACE_M = -0.006
"""Height where the object is absent: deeper than any indentation."""


@dataclass(frozen=True, slots=True)
class SimulatedObject:
    """A rigid object that the gripper can pick up.

    Attributes
    ----------
    name : str
        Short name, the one used in ``simulate_play(objects=...)``.
    width_m : float
        Distance between its two contact faces, metres.
    rest_height_m : float
        Height of its origin above the table when it stands there, metres.
    hold_depth_m : float
        Indentation per finger of a usual grasp, metres.
    surface : callable
        ``surface(finger, u_m, v_m)`` gives heights in metres (see the module's text).
    """

    name: str
    width_m: float
    rest_height_m: float
    hold_depth_m: float
    surface: Surface


def object_by_name(name: str) -> SimulatedObject:
    """Return the object called `name`.

    Raises
    ------
    ValueError
        If there is no such object; the message lists those there are.
    """
    for item in OBJECTS:
        if item.name == name:
            return item
    names = ", ".join(item.name for item in OBJECTS)
    raise ValueError(f"Invalid object name ({name!r}). Supported values are {names}.")


@lru_cache(maxsize=32)  # a live camera looks its session up again and again
def height_map(item: SimulatedObject, finger: Finger, m_per_px: float) -> NDArray[np.float32]:
    """Return the height map that `finger` feels, centred on the grasp point.

    Parameters
    ----------
    item : SimulatedObject
        The object.
    finger : {"left", "right"}
        Which finger touches it.
    m_per_px : float
        Resolution, metres per pixel.

    Returns
    -------
    ndarray of float32, shape (S, S), S odd
        Heights in metres: 0 at the outermost point, clamped to ``NO_SURFACE_M`` below. Not
        writeable: the same array for the same arguments.
    """
    half = round(MAP_SIDE_M / 2 / m_per_px)
    axis = np.arange(-half, half + 1) * m_per_px
    u, v = np.meshgrid(axis, axis)
    heights = np.clip(item.surface(finger, u, v), NO_SURFACE_M, 0.0).astype(np.float32)
    heights.flags.writeable = False
    return heights


OBJECTS: tuple[SimulatedObject, ...] = (
    SimulatedObject("bolt", 2 * shape.BOLT_RADIUS_M, 0.024, 0.95e-3, shape.bolt),
    SimulatedObject("ball", 2 * shape.BALL_RADIUS_M, shape.BALL_RADIUS_M, 1.15e-3, shape.ball),
    SimulatedObject("cap", 2 * shape.CAP_RADIUS_M, 0.048, 0.95e-3, shape.cap),
    SimulatedObject("key", shape.KEY_THICKNESS_M, 0.030, 0.75e-3, shape.key),
    SimulatedObject("strawberry", 2 * shape.BERRY_RADIUS_M, 0.022, 1.2e-3, shape.strawberry),
)
"""The objects in the order in which a session takes them when none are named."""
