"""The wrist camera: a pinhole view of the fingers, the objects and the table.

The table is one warped picture with soft shadows on it; polygons are drawn over it from far to
near, at twice the size, and averaged down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from exumi_data.simulation.meshes import Mesh
from exumi_data.simulation.motion import Float64Array
from exumi_data.simulation.painter import LAMP, NEAR_M, SUBPIXEL_BITS, paint_faces
from exumi_data.simulation.pixels import Float32Array, UInt8Array, as_uint8
from exumi_data.simulation.table import TABLE_PX_PER_M, table_texture

__all__ = ["PlacedMesh", "WristCamera", "make_camera"]

_SUPERSAMPLE = 2
_SHADOW = 0.42
_WALL_RGB = np.array([208.0, 204.0, 198.0], dtype=np.float32)
_NOISE_MARGIN = 48
_NOISE_SIGMA = 1.5
_HORIZON_START, _HORIZON_FADE = -0.35, 0.25

_MOUNT_M = (0.0, -0.078, -0.118)
_LOOK_AT_M = (0.0, -0.022, 0.0)
_FOCAL_WIDTHS = 0.66


@dataclass(frozen=True, slots=True)
class PlacedMesh:
    """A mesh in the world.

    Attributes
    ----------
    mesh : Mesh
        The mesh.
    pose : ndarray of float64, shape (7,)
        ``T_world_mesh``: x y z qx qy qz qw, metres.
    layer : int
        0 for what lies on the table, 1 for the gripper and what it holds, drawn over it.
    """

    mesh: Mesh
    pose: Float64Array
    layer: int


@dataclass(frozen=True, slots=True)
class WristCamera:
    """The camera's model and what its pictures need. It has no state: threads may share it.

    Attributes
    ----------
    size : (int, int)
        Height and width, pixels.
    matrix : ndarray of float64, shape (3, 3)
        Intrinsics (pinhole, no distortion), pixels, the first pixel's centre at (0, 0).
    gripper_camera : ndarray of float64, shape (4, 4)
        ``T_gripper_camera``; camera x right, y down, z forward, metres.
    table : ndarray of uint8, shape (S, S, 3)
        The table from above (`table.table_texture`).
    vignette : ndarray of float32, shape (H, W, 3)
        Brightness factor.
    noise : ndarray of float32, shape (H + M, W + M, 3)
        Sensor noise, from which every picture takes a window.
    """

    size: tuple[int, int]
    matrix: Float64Array
    gripper_camera: Float64Array
    table: UInt8Array
    vignette: Float32Array
    noise: Float32Array

    def render(
        self, gripper: Float64Array, scene: Sequence[PlacedMesh], noise_seed: int
    ) -> UInt8Array:
        """Return the picture taken at gripper pose `gripper`.

        Parameters
        ----------
        gripper : ndarray of float64, shape (7,)
            ``T_world_gripper``: x y z qx qy qz qw, metres.
        scene : sequence of PlacedMesh
            Everything to be seen except the table.
        noise_seed : int
            Chooses the noise, not negative.

        Returns
        -------
        ndarray of uint8, shape (H, W, 3)
            RGB image.
        """
        world_camera = _matrix(gripper) @ self.gripper_camera
        camera_world = _inverse(world_camera)
        placed = [_world_vertices(item) for item in scene]
        table = self._shadows(self._table(camera_world, world_camera), camera_world, placed)
        # Doubling by nearest neighbour: averaging down later gives the table back unchanged.
        doubled = (self.size[1] * _SUPERSAMPLE, self.size[0] * _SUPERSAMPLE)
        canvas = as_uint8(cv2.resize(table, doubled, interpolation=cv2.INTER_NEAREST))
        for layer in (0, 1):
            chosen = [i for i, item in enumerate(scene) if item.layer == layer]
            meshes = [scene[i].mesh for i in chosen]
            self._polygons(canvas, camera_world, meshes, [placed[i] for i in chosen])
        return self._develop(canvas, noise_seed)

    def project(self, gripper: Float64Array, points_m: Float64Array) -> Float64Array:
        """Return where world points appear.

        Parameters
        ----------
        gripper : ndarray of float64, shape (7,)
            ``T_world_gripper``: x y z qx qy qz qw, metres.
        points_m : ndarray of float64, shape (N, 3)
            Points in the world's frame, metres.

        Returns
        -------
        ndarray of float64, shape (N, 3)
            Column and row in pixels, and the depth along the optical axis in metres (the pixels
            mean nothing where it is not positive).
        """
        return self._project(_inverse(_matrix(gripper) @ self.gripper_camera), points_m)

    def _project(self, camera_world: Float64Array, points_m: Float64Array) -> Float64Array:
        local = points_m @ camera_world[:3, :3].T + camera_world[:3, 3]
        pixel = (local / np.maximum(local[:, 2:], 1e-6)) @ self.matrix.T
        return np.hstack([pixel[:, :2], local[:, 2:]])

    def _table(self, camera_world: Float64Array, world_camera: Float64Array) -> UInt8Array:
        """Return the picture of the empty table."""
        rows, columns = self.size
        half = self.table.shape[0] / 2
        texture_to_world = np.array(
            [
                [1 / TABLE_PX_PER_M, 0.0, -half / TABLE_PX_PER_M],
                [0.0, -1 / TABLE_PX_PER_M, half / TABLE_PX_PER_M],
                [0.0, 0.0, 1.0],
            ]
        )
        onto_camera = np.column_stack([camera_world[:3, :2], camera_world[:3, 3]])
        homography = self.matrix @ onto_camera @ texture_to_world
        picture = cv2.warpPerspective(
            self.table, homography, (columns, rows), borderMode=cv2.BORDER_REFLECT_101
        )
        return self._hide_horizon(as_uint8(picture), world_camera)

    def _hide_horizon(self, picture: UInt8Array, world_camera: Float64Array) -> UInt8Array:
        """Return the picture with a wall, faded in, where rays hardly go down to the table."""
        rows, columns = self.size
        down = world_camera[2, :3] @ np.linalg.inv(self.matrix)
        ray_z = down[0] * np.arange(columns) + down[1] * np.arange(rows)[:, None] + down[2]
        if ray_z.max() < _HORIZON_START:
            return picture
        wall = np.clip((ray_z - _HORIZON_START) / _HORIZON_FADE, 0.0, 1.0)[..., None]
        return as_uint8((picture * (1.0 - wall) + _WALL_RGB * wall).astype(np.uint8))

    def _shadows(
        self, table: UInt8Array, camera_world: Float64Array, placed: Sequence[Float64Array]
    ) -> UInt8Array:
        """Return the table with the soft shadows of the meshes' convex hulls."""
        mask = np.zeros(self.size, np.uint8)
        for vertices in placed:
            ground = vertices - LAMP * (vertices[:, 2:] / LAMP[2])
            seen = self._project(camera_world, ground)
            if (seen[:, 2] > NEAR_M).all():
                hull = cv2.convexHull(np.clip(seen[:, :2], -2e3, 2e3).astype(np.float32))
                points = np.round(hull * (1 << SUBPIXEL_BITS)).astype(np.int32)
                cv2.fillConvexPoly(mask, points, (255,), cv2.LINE_AA, SUBPIXEL_BITS)
        soft = cv2.GaussianBlur(mask, (0, 0), self.size[1] / 110)
        light = cv2.bitwise_not(cv2.convertScaleAbs(soft, alpha=_SHADOW))
        return as_uint8(cv2.multiply(table, cv2.merge([light] * 3), scale=1 / 255))

    def _polygons(
        self,
        canvas: UInt8Array,
        camera_world: Float64Array,
        meshes: Sequence[Mesh],
        placed: Sequence[Float64Array],
    ) -> None:
        """Draw those of the meshes that are in view onto the supersampled canvas."""
        projected = [self._project(camera_world, vertices) for vertices in placed]
        shown = [i for i, seen in enumerate(projected) if self._in_view(seen)]
        if not shown:
            return
        seen = np.concatenate([projected[i][meshes[i].faces] for i in shown])
        seen[..., :2] = (seen[..., :2] + 0.5) * _SUPERSAMPLE - 0.5
        paint_faces(
            canvas,
            corners_m=np.concatenate([placed[i][meshes[i].faces] for i in shown]),
            seen=seen,
            colours=np.concatenate([meshes[i].colours for i in shown]),
            eye_m=_inverse(camera_world)[:3, 3],
        )

    def _in_view(self, seen: Float64Array) -> bool:
        """Return whether the box around projected points meets the picture."""
        ahead = seen[seen[:, 2] > NEAR_M]
        if not len(ahead):
            return False
        (left, top, _), (right, bottom, _) = ahead.min(axis=0), ahead.max(axis=0)
        return bool(right > 0 and bottom > 0 and left < self.size[1] and top < self.size[0])

    def _develop(self, canvas: UInt8Array, noise_seed: int) -> UInt8Array:
        """Return the canvas averaged down, with the lens's vignette and the sensor's noise."""
        rows, columns = self.size
        image = cv2.resize(canvas, (columns, rows), interpolation=cv2.INTER_AREA)
        image = cv2.multiply(image, self.vignette, dtype=cv2.CV_32F)
        top, left = np.random.default_rng(noise_seed).integers(0, _NOISE_MARGIN, 2)
        window = self.noise[top : top + rows, left : left + columns]
        return as_uint8(cv2.add(image, window, dtype=cv2.CV_8U))


def make_camera(size: tuple[int, int], *, seed: int) -> WristCamera:
    """Return the wrist camera.

    Parameters
    ----------
    size : (int, int)
        Height and width of its pictures, pixels.
    seed : int
        Chooses the table's grain and the noise.

    Returns
    -------
    WristCamera
        The camera.
    """
    rng = np.random.default_rng(seed)
    rows, columns = size
    focal = _FOCAL_WIDTHS * max(columns, rows)
    matrix = np.array(
        [[focal, 0.0, (columns - 1) / 2], [0.0, focal, (rows - 1) / 2], [0.0, 0.0, 1.0]]
    )
    x = (np.arange(columns) - (columns - 1) / 2) / (columns / 2)
    y = (np.arange(rows)[:, None] - (rows - 1) / 2) / (columns / 2)
    vignette = np.repeat((1.0 - 0.16 * (x**2 + y**2))[..., None], 3, axis=2).astype(np.float32)
    shape = (rows + _NOISE_MARGIN, columns + _NOISE_MARGIN, 3)
    noise = _NOISE_SIGMA * rng.standard_normal(shape, dtype=np.float32)
    return WristCamera(size, matrix, _mounting(), table_texture(rng), vignette, noise)


def _matrix(pose: Float64Array) -> Float64Array:
    """Return the (4, 4) matrix of a pose x y z qx qy qz qw."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(pose[3:]).as_matrix()
    matrix[:3, 3] = pose[:3]
    return matrix


def _inverse(matrix: Float64Array) -> Float64Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _mounting() -> Float64Array:
    """Return ``T_gripper_camera``: above the fingers, looking along them and at their tips."""
    place = np.array(_MOUNT_M)
    forward = np.array(_LOOK_AT_M) - place
    forward /= np.linalg.norm(forward)
    right = np.array([1.0, 0.0, 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    matrix[:3, 3] = place
    return matrix


def _world_vertices(item: PlacedMesh) -> Float64Array:
    matrix = _matrix(item.pose)
    moved: Float64Array = item.mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return moved
