"""Turning truth into images: one renderer for each image stream.

The states are looked up once for all frames; drawing a frame then needs no truth. Renderers hold
no changing state, so frames may be drawn in any order, by several threads or processes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.simulation.camera import PlacedMesh, WristCamera
from exumi_data.simulation.gel import Contact, GelPad
from exumi_data.simulation.meshes import Mesh, finger_mesh, object_mesh
from exumi_data.simulation.motion import Float64Array
from exumi_data.simulation.objects import Finger, height_map
from exumi_data.simulation.truth import Truth

__all__ = ["TactileRenderer", "WristRenderer", "make_tactile_renderer", "make_wrist_renderer"]

UInt8Array = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class TactileRenderer:
    """Draws the frames of one finger's pad; call it with a frame's index."""

    pad: GelPad
    height_maps: tuple[NDArray[np.float32], ...]
    object_index: NDArray[np.int64]
    depth_m: Float64Array
    contact_pose: Float64Array
    shear: Float64Array
    seed: int

    def __call__(self, index: int) -> UInt8Array:
        """Return frame `index`, (H, W, 3) uint8 RGB."""
        touched = int(self.object_index[index])
        # Without contact any map will do: the pad does not look at it.
        heights = self.height_maps[max(touched, 0)]
        return self.pad.render(heights, self._contact(index, touched), self.seed + index)

    def _contact(self, index: int, touched: int) -> Contact:
        if touched < 0:
            return Contact(0.0, 0.0, 0.0, 0.0)
        u_m, v_m, angle = (float(value) for value in self.contact_pose[index])
        right, down, turn = (float(value) for value in self.shear[index])
        return Contact(float(self.depth_m[index]), u_m, v_m, angle, (right, down, turn))


def make_tactile_renderer(
    truth: Truth, finger: Finger, pad: GelPad, t_s: Float64Array, seed: int
) -> TactileRenderer:
    """Return the renderer of a finger's frames taken at `t_s` (N,), seconds."""
    return TactileRenderer(
        pad=pad,
        height_maps=tuple(height_map(item, finger, pad.m_per_px) for item in truth.objects),
        object_index=truth.object_index(t_s),
        depth_m=truth.contact_depth_m(finger, t_s),
        contact_pose=truth.contact_pose(finger, t_s),
        shear=truth.skin_shear(finger, t_s),
        seed=seed,
    )


@dataclass(frozen=True, slots=True)
class WristRenderer:
    """Draws the frames of the wrist camera; call it with a frame's index."""

    camera: WristCamera
    object_meshes: tuple[Mesh, ...]
    finger_meshes: tuple[Mesh, Mesh]
    gripper: Float64Array
    width_m: Float64Array
    held: NDArray[np.int64]
    object_poses: tuple[Float64Array, ...]
    seed: int

    def __call__(self, index: int) -> UInt8Array:
        """Return frame `index`, (H, W, 3) uint8 RGB."""
        gripper, half_m = self.gripper[index], 0.5 * float(self.width_m[index])
        scene = [
            PlacedMesh(mesh, poses[index], layer=int(number == self.held[index]))
            for number, (mesh, poses) in enumerate(
                zip(self.object_meshes, self.object_poses, strict=True)
            )
        ]
        for mesh, shift_m in zip(self.finger_meshes, (-half_m, half_m), strict=True):
            scene.append(PlacedMesh(mesh.moved((shift_m, 0.0, 0.0)), gripper, layer=1))
        return self.camera.render(gripper, scene, self.seed + index)


def make_wrist_renderer(
    truth: Truth, camera: WristCamera, t_s: Float64Array, seed: int
) -> WristRenderer:
    """Return the renderer of the wrist camera's frames taken at `t_s` (N,), seconds."""
    return WristRenderer(
        camera=camera,
        object_meshes=tuple(object_mesh(item.name) for item in truth.objects),
        finger_meshes=(finger_mesh("left"), finger_mesh("right")),
        gripper=truth.pose(t_s),
        width_m=truth.width_m(t_s),
        held=truth.object_index(t_s),
        object_poses=tuple(truth.object_pose(i, t_s) for i in range(len(truth.objects))),
        seed=seed,
    )
