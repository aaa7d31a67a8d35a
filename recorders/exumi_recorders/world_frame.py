"""From a headset's left-handed world to a right-handed one, and back.

A Quest app sends poses in Unity's world: metres, left-handed, y up. The operator puts a *world
frame* ``p_WF, R_WF`` into the room; with Q, which swaps y and z,

    p_rel = Q R_WF^T (p - p_WF)        R_rel = Q R_WF^T R Q^T

is right-handed: x to the right, y forward and z up, as seen from the world frame. Both reference
frames of a pose are swapped, the parent and the child: R_rel is a rotation again.
"""

import numpy as np
import numpy.typing as npt

from exumi_data.geometry import compose, relative

__all__ = ["from_headset_world", "to_headset_world"]

Float64Array = npt.NDArray[np.float64]


def from_headset_world(poses: npt.ArrayLike, world_frame: npt.ArrayLike) -> Float64Array:
    """Express poses of a headset's world in the right-handed world of its world frame.

    Parameters
    ----------
    poses : array_like, shape (..., 7)
        x y z qx qy qz qw as a Quest app sends them: metres, left-handed, y up.
    world_frame : array_like, shape (..., 7)
        The world frame, in the same terms; leading axes are broadcast.

    Returns
    -------
    ndarray of float64, shape (..., 7)
        x y z qx qy qz qw with unit quaternions: metres, right-handed, z up.

    Raises
    ------
    ValueError
        If a shape is wrong or a quaternion is zero.
    """
    return _swap_y_and_z(relative(world_frame, poses))


def to_headset_world(poses: npt.ArrayLike, world_frame: npt.ArrayLike) -> Float64Array:
    """Express right-handed poses in a headset's world; the inverse of `from_headset_world`.

    Parameters
    ----------
    poses : array_like, shape (..., 7)
        x y z qx qy qz qw: metres, right-handed, z up.
    world_frame : array_like, shape (..., 7)
        The world frame in the headset's world; leading axes are broadcast.

    Returns
    -------
    ndarray of float64, shape (..., 7)
        x y z qx qy qz qw with unit quaternions: metres, left-handed, y up.

    Raises
    ------
    ValueError
        If a shape is wrong or a quaternion is zero.
    """
    return compose(world_frame, _swap_y_and_z(np.asarray(poses, np.float64)))


def _swap_y_and_z(poses: Float64Array) -> Float64Array:
    """Return ``Q T Q``: a reflection turns a rotation's axis over and swaps its components."""
    if poses.shape[-1:] != (7,):
        raise ValueError(f"poses must be of shape (..., 7), not {poses.shape}")
    swapped: Float64Array = poses[..., [0, 2, 1, 3, 5, 4, 6]].copy()
    swapped[..., 3:6] *= -1.0
    return swapped
