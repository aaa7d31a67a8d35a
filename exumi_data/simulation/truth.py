"""What really happens in a simulated play session, as functions of continuous time.

Reference frames: *world* is right-handed with z up and the table at z = 0. *gripper* has its
origin midway between the two pads' centres, x from the left finger to the right one, z along the
approach (towards the fingertips) and y completing it. An *object*'s frame is described in
`objects`. Poses are ``T_parent_child`` as x y z qx qy qz qw, in metres.

Width is the distance between the two undeformed gel surfaces. While the gripper holds an object,
the object reaches into both gels, so at every moment of a contact

    width + depth(left) + depth(right) = the object's width

and `width` equals the object's width exactly at the moments of contact and of release.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exumi_data.simulation.motion import (
    Float64Array,
    RotationTrack,
    Track,
    multiply_quaternions,
    quaternion_from_rotation_vector,
    rotate_vectors,
)
from exumi_data.simulation.objects import Finger, SimulatedObject
from exumi_data.simulation.tremor import Tremor

__all__ = ["GelStiffness", "Grasp", "Truth"]

_SKIN_SHEAR_M = 0.7e-3
_SKIN_TURN_RAD = 0.09


@dataclass(frozen=True, slots=True)
class Grasp:
    """One grasp: from the reach for an object until the hand has left it again.

    Attributes
    ----------
    object_name : str
        Name of the object.
    object_index : int
        Its index in ``Truth.objects``.
    t_start_s, t_end_s : float
        The reach starts; the hand has retreated. Seconds since session start.
    t_contact_s, t_release_s : float
        The pads first and last touch the object.
    object_width_m : float
        The object's width between the contact faces, metres.
    left_share : float
        The left finger's part of the whole indentation, about one half.
    """

    object_name: str
    object_index: int
    t_start_s: float
    t_end_s: float
    t_contact_s: float
    t_release_s: float
    object_width_m: float
    left_share: float


@dataclass(frozen=True, slots=True)
class GelStiffness:
    """How both gels together give way when the fingers are driven past the object.

    Attributes
    ----------
    limit_m : float
        Indentation of both fingers together under any force, metres.
    give : float
        Indentation per metre of drive at first touch, between 0 and 1: at contact the closing
        speed drops to this part at once, which an encoder sees as a kink.
    """

    limit_m: float = 4.0e-3
    give: float = 0.6

    def indentation_m(self, drive_m: Float64Array) -> Float64Array:
        """Return the indentation of both fingers (metres) for a drive past contact (metres)."""
        drive = np.maximum(drive_m, 0.0)
        return -self.limit_m * np.expm1(-self.give * drive / self.limit_m)

    def drive_m(self, indentation_m: float) -> float:
        """Return the drive past contact (metres) that makes this indentation (metres)."""
        return float(-self.limit_m / self.give * np.log1p(-indentation_m / self.limit_m))


@dataclass(frozen=True, slots=True)
class Truth:
    """The session's true state; every method takes any times in seconds, in any order.

    Attributes
    ----------
    duration_s : float
        Length of the session; before 0 and after this nothing moves but the hand's tremor.
    objects : tuple of SimulatedObject
        The objects on the table.
    grasps : tuple of Grasp
        The grasps in order of time. They do not overlap, and each starts where the last ended.
    position : Track
        The planned place of the gripper in the world, metres.
    rotation : RotationTrack
        The planned orientation of the gripper in the world.
    tremor : Tremor
        What the hand adds to the plan.
    closing : Track
        Where the fingers are driven to, metres of opening, as if nothing were between them.
    slip : Track
        The object's place in the grip: y, z (metres) and turn about x (radians) in the gripper's
        frame. Without meaning while nothing is held.
    gel : GelStiffness
        How the gels give way.
    rest_poses : tuple of ndarray of float64, shape (K + 1, 7)
        For each object: ``T_world_object`` before its first and after each of its K grasps.
    """

    duration_s: float
    objects: tuple[SimulatedObject, ...]
    grasps: tuple[Grasp, ...]
    position: Track
    rotation: RotationTrack
    tremor: Tremor
    closing: Track
    slip: Track
    gel: GelStiffness
    rest_poses: tuple[Float64Array, ...]

    def pose(self, t_s: ArrayLike) -> Float64Array:
        """Return the gripper's pose ``T_world_gripper``.

        Parameters
        ----------
        t_s : array_like, shape (N,)
            Times, seconds since session start.

        Returns
        -------
        ndarray of float64, shape (N, 7)
            x y z qx qy qz qw: metres, unit quaternion, whose sign is continuous in time.
        """
        shake, turn = self.tremor(t_s)
        quaternion = multiply_quaternions(self.rotation(t_s), quaternion_from_rotation_vector(turn))
        return np.hstack([self.position(t_s) + shake, quaternion])

    def width_m(self, t_s: ArrayLike) -> Float64Array:
        """Return the opening between the undeformed gel surfaces, metres, shape (N,)."""
        drive = self._drive_m(t_s)
        opening: Float64Array = self.closing(t_s)[:, 0]
        return np.where(drive > 0, opening + drive - self.gel.indentation_m(drive), opening)

    def contact_depth_m(self, finger: Finger, t_s: ArrayLike) -> Float64Array:
        """Return how deep the object's outermost point is pressed into a finger's gel.

        Parameters
        ----------
        finger : {"left", "right"}
            The finger.
        t_s : array_like, shape (N,)
            Times, seconds since session start.

        Returns
        -------
        ndarray of float64, shape (N,)
            Metres; 0 without contact.
        """
        share = self._per_grasp(t_s, [grasp.left_share for grasp in self.grasps])
        own = share if _side(finger) > 0 else 1.0 - share
        return own * self.gel.indentation_m(self._drive_m(t_s))

    def contact_pose(self, finger: Finger, t_s: ArrayLike) -> Float64Array:
        """Return where the object's origin lies on a finger's pad.

        Parameters
        ----------
        finger : {"left", "right"}
            The finger.
        t_s : array_like, shape (N,)
            Times, seconds since session start.

        Returns
        -------
        ndarray of float64, shape (N, 3)
            Metres right and down from the image's centre, and the turn from right towards down
            in radians (clockwise as displayed). NaN without contact.
        """
        planar = _mirrored(finger, self.slip(t_s))
        planar[~self.in_contact(t_s)] = np.nan
        return planar

    def skin_shear(self, finger: Finger, t_s: ArrayLike) -> Float64Array:
        """Return how the contact drags a pad's skin along.

        The skin follows the object's slip since contact and gives way smoothly at 0.7 mm and
        0.09 rad, where the object slides over it.

        Parameters
        ----------
        finger : {"left", "right"}
            The finger.
        t_s : array_like, shape (N,)
            Times, seconds since session start.

        Returns
        -------
        ndarray of float64, shape (N, 3)
            Metres right and down and radians (clockwise as displayed); 0 without contact.
        """
        touch_s = self._per_grasp(t_s, [grasp.t_contact_s for grasp in self.grasps])
        moved = _mirrored(finger, self.slip(t_s) - self.slip(touch_s))
        distance = np.hypot(moved[:, 0], moved[:, 1]) / _SKIN_SHEAR_M
        moved[:, :2] /= np.sqrt(1.0 + distance**2)[:, None]
        moved[:, 2] /= np.sqrt(1.0 + (moved[:, 2] / _SKIN_TURN_RAD) ** 2)
        moved[~self.in_contact(t_s)] = 0.0
        return moved

    def in_contact(self, t_s: ArrayLike) -> NDArray[np.bool_]:
        """Return whether the pads touch an object, shape (N,), bool."""
        return self._drive_m(t_s) > 0

    def object_index(self, t_s: ArrayLike) -> NDArray[np.int64]:
        """Return the index of the object between the pads, -1 without contact, shape (N,)."""
        index = self._per_grasp(t_s, [grasp.object_index for grasp in self.grasps])
        return np.where(self.in_contact(t_s), index, -1).astype(np.int64)

    def object_name(self, t_s: ArrayLike) -> tuple[str | None, ...]:
        """Return the name of the object between the pads at each time, None without contact."""
        names = [item.name for item in self.objects]
        return tuple(names[i] if i >= 0 else None for i in self.object_index(t_s))

    def object_pose(self, index: int, t_s: ArrayLike) -> Float64Array:
        """Return an object's pose ``T_world_object``, on the table or in the hand.

        Parameters
        ----------
        index : int
            The object's index in `objects`.
        t_s : array_like, shape (N,)
            Times, seconds since session start.

        Returns
        -------
        ndarray of float64, shape (N, 7)
            x y z qx qy qz qw: metres, unit quaternion (its sign may jump at contact).
        """
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        uses = [grasp for grasp in self.grasps if grasp.object_index == index]
        released = np.searchsorted([grasp.t_release_s for grasp in uses], times, side="right")
        pose = self.rest_poses[index][released]
        held = self.object_index(times) == index
        if held.any():
            pose[held] = self._held_pose(times[held])
        return pose

    def _held_pose(self, times: Float64Array) -> Float64Array:
        gripper, slip = self.pose(times), self.slip(times)
        off_centre = self.contact_depth_m("right", times) - self.contact_depth_m("left", times)
        local = np.stack([0.5 * off_centre, slip[:, 0], slip[:, 1]], axis=1)
        turn = quaternion_from_rotation_vector(slip[:, 2:] * np.array([1.0, 0.0, 0.0]))
        place = gripper[:, :3] + rotate_vectors(gripper[:, 3:], local)
        return np.hstack([place, multiply_quaternions(gripper[:, 3:], turn)])

    def _drive_m(self, t_s: ArrayLike) -> Float64Array:
        """Return how far the fingers are driven past first touch, metres, 0 without contact."""
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        first_s = self._per_grasp(times, [grasp.t_contact_s for grasp in self.grasps])
        last_s = self._per_grasp(times, [grasp.t_release_s for grasp in self.grasps])
        width = self._per_grasp(times, [grasp.object_width_m for grasp in self.grasps])
        touching = (first_s <= times) & (times <= last_s)
        return np.where(touching, np.maximum(width - self.closing(times)[:, 0], 0.0), 0.0)

    def _per_grasp(self, t_s: ArrayLike, values: list[float] | list[int]) -> Float64Array:
        """Return the value of the grasp that each time belongs to, (N,)."""
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        starts = [grasp.t_start_s for grasp in self.grasps]
        index = np.searchsorted(starts, times, side="right") - 1
        return np.array(values, dtype=np.float64)[np.maximum(index, 0)]


def _mirrored(finger: Finger, planar: Float64Array) -> Float64Array:
    """Return y, z, turn about x of the gripper's frame as right, down, turn on a pad, (N, 3)."""
    on_pad: Float64Array = planar * np.array([_side(finger), 1.0, _side(finger)])
    return on_pad


def _side(finger: Finger) -> float:
    """Return +1 for the left finger, whose image has y to the right, -1 for the right one."""
    if finger not in ("left", "right"):
        raise ValueError(f"Invalid finger ({finger!r}). Supported values are left, right.")
    return 1.0 if finger == "left" else -1.0
