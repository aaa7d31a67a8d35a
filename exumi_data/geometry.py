"""Geometry of poses: conversions, composition, 6-D rotation, interpolation over time.

A pose is seven float64 numbers, ``x y z qx qy qz qw`` in metres, and means ``T_parent_child``:
it maps coordinates in the child reference frame to coordinates in the parent. Quaternions are
xyzw with real part last; they need not have unit length, but must not be zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from exumi_data.time import Brackets, bracket_indices

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = [
    "axis_angle_to_quaternion",
    "compose",
    "interpolate_linear",
    "interpolate_poses",
    "inverse",
    "make_sign_continuous",
    "matrix_to_pose",
    "mirror",
    "pose_to_matrix",
    "relative",
    "rotation_6d",
    "rotation_from_6d",
]

Float64Array = npt.NDArray[np.float64]

_NEARLY_PARALLEL = 1.0 - 1e-9


def pose_to_matrix(pose: npt.ArrayLike) -> Float64Array:
    """Write poses as homogeneous matrices.

    Parameters
    ----------
    pose
        (..., 7) poses.

    Returns
    -------
    (..., 4, 4) float64
        ``T_parent_child``.

    Raises
    ------
    ValueError
        If the shape is wrong or a quaternion is zero.
    """
    poses = _as_poses(pose)
    flat = _flat(poses)
    matrix = np.zeros((len(flat), 4, 4))
    matrix[:, :3, :3] = _rotation(flat).as_matrix()
    matrix[:, :3, 3] = flat[:, :3]
    matrix[:, 3, 3] = 1.0
    return matrix.reshape(*poses.shape[:-1], 4, 4)


def matrix_to_pose(matrix: npt.ArrayLike) -> Float64Array:
    """Write homogeneous matrices as poses; the inverse of `pose_to_matrix`.

    Parameters
    ----------
    matrix
        (..., 4, 4) homogeneous matrices. Their rotation is made orthogonal.

    Returns
    -------
    (..., 7) float64
        Poses with unit quaternions, real part not negative.

    Raises
    ------
    ValueError
        If the shape is wrong, the last row is not 0 0 0 1, or a rotation is singular or mirrors.
    """
    from scipy.spatial.transform import Rotation

    matrices = np.asarray(matrix, np.float64)
    if matrices.shape[-2:] != (4, 4):
        raise ValueError(f"matrices must be of shape (..., 4, 4), not {matrices.shape}")
    if not np.allclose(matrices[..., 3, :], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError("the last row of a homogeneous matrix must be 0 0 0 1")
    flat = matrices.reshape(-1, 4, 4)
    if not (np.linalg.det(flat[:, :3, :3]) > 0).all():
        raise ValueError("a rotation matrix must have a positive determinant")
    pose = np.empty((len(flat), 7))
    pose[:, :3] = flat[:, :3, 3]
    pose[:, 3:] = Rotation.from_matrix(flat[:, :3, :3]).as_quat(canonical=True)
    return pose.reshape(*matrices.shape[:-2], 7)


def inverse(pose: npt.ArrayLike) -> Float64Array:
    """Invert poses: ``T_parent_child`` becomes ``T_child_parent``.

    Parameters
    ----------
    pose
        (..., 7) poses.

    Returns
    -------
    (..., 7) float64
        Inverse poses with unit quaternions.

    Raises
    ------
    ValueError
        If the shape is wrong or a quaternion is zero.
    """
    poses = _as_poses(pose)
    flat = _flat(poses)
    rotation = _rotation(flat).inv()
    out = np.empty_like(flat)
    out[:, :3] = -rotation.apply(flat[:, :3])
    out[:, 3:] = rotation.as_quat()
    return out.reshape(poses.shape)


def compose(first: npt.ArrayLike, second: npt.ArrayLike) -> Float64Array:
    """Chain poses: ``T_a_b`` and ``T_b_c`` give ``T_a_c``.

    Parameters
    ----------
    first, second
        (..., 7) poses; leading axes are broadcast.

    Returns
    -------
    (..., 7) float64
        Poses with unit quaternions.

    Raises
    ------
    ValueError
        If a shape is wrong or a quaternion is zero.
    """
    a, b = np.broadcast_arrays(_as_poses(first), _as_poses(second))
    flat_a, flat_b = _flat(a), _flat(b)
    rotation = _rotation(flat_a)
    out = np.empty_like(flat_a)
    out[:, :3] = flat_a[:, :3] + rotation.apply(flat_b[:, :3])
    out[:, 3:] = _product(rotation.as_quat(), _rotation(flat_b).as_quat())
    return out.reshape(a.shape)


def _product(a: Float64Array, b: Float64Array) -> Float64Array:
    """Multiply unit quaternions (N, 4): as SciPy does, in an eighth of its time."""
    from scipy.spatial.transform import Rotation

    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    out = np.empty_like(a)
    out[:, 0] = aw * bx + bw * ax + (ay * bz - az * by)
    out[:, 1] = aw * by + bw * ay + (az * bx - ax * bz)
    out[:, 2] = aw * bz + bw * az + (ax * by - ay * bx)
    out[:, 3] = aw * bw - ax * bx - ay * by - az * bz
    return np.asarray(Rotation.from_quat(out).as_quat(), np.float64)


def relative(base: npt.ArrayLike, pose: npt.ArrayLike) -> Float64Array:
    """Express poses in the reference frame of a base pose: ``inv(base) * pose``.

    Parameters
    ----------
    base, pose
        (..., 7) poses with the same parent; leading axes are broadcast.

    Returns
    -------
    (..., 7) float64
        ``T_base_child`` with unit quaternions.

    Raises
    ------
    ValueError
        If a shape is wrong or a quaternion is zero.
    """
    return compose(inverse(base), pose)


def mirror(pose: npt.ArrayLike, axis: Literal["x", "y", "z"]) -> Float64Array:
    """Mirror poses: ``M·T·M``, where M negates one axis of both reference frames.

    What a scene's mirror image does, described in frames that are mirrored with it: the position
    changes its sign along the axis, and rotations about the other two axes change theirs.

    Parameters
    ----------
    pose
        (..., 7) poses.
    axis
        The axis that is negated.

    Returns
    -------
    (..., 7) float64
        Poses; quaternions keep their length.

    Raises
    ------
    ValueError
        If the shape is wrong or there is no such axis.
    """
    if axis not in ("x", "y", "z"):
        raise ValueError(f"Invalid axis ({axis!r}). Supported values are 'x', 'y', 'z'.")
    sign = np.ones(7)
    number = "xyz".index(axis)
    sign[number] = -1.0
    sign[[3 + (number + 1) % 3, 3 + (number + 2) % 3]] = -1.0
    return np.asarray(_as_poses(pose) * sign, np.float64)


def rotation_6d(quaternion: npt.ArrayLike) -> Float64Array:
    """Write rotations as six numbers: the first two rows of the matrix, one after the other.

    UMI and exUMI use rows; the publication of the representation (Zhou et al., "On the
    Continuity of Rotation Representations in Neural Networks", CVPR 2019) uses columns.

    Parameters
    ----------
    quaternion
        (..., 4) quaternions xyzw.

    Returns
    -------
    (..., 6) float64
        ``R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]``.

    Raises
    ------
    ValueError
        If the shape is wrong or a quaternion is zero.
    """
    from scipy.spatial.transform import Rotation

    q = np.asarray(quaternion, np.float64)
    if q.shape[-1:] != (4,):
        raise ValueError(f"quaternions must be of shape (..., 4), not {q.shape}")
    matrix = Rotation.from_quat(q.reshape(-1, 4)).as_matrix()
    return np.asarray(matrix, np.float64)[:, :2].reshape(*q.shape[:-1], 6)


def rotation_from_6d(numbers: npt.ArrayLike) -> Float64Array:
    """Make quaternions from six numbers by Gram-Schmidt; the inverse of `rotation_6d`.

    Parameters
    ----------
    numbers
        (..., 6): two rows of a matrix, not necessarily orthogonal or of unit length (as a
        network predicts them).

    Returns
    -------
    (..., 4) float64
        Unit quaternions xyzw, real part not negative.

    Raises
    ------
    ValueError
        If the shape is wrong, or two rows are zero or parallel and thus span no rotation.
    """
    from scipy.spatial.transform import Rotation

    rows = np.asarray(numbers, np.float64)
    if rows.shape[-1:] != (6,):
        raise ValueError(f"6-D rotations must be of shape (..., 6), not {rows.shape}")
    flat = rows.reshape(-1, 6)
    first, second = _unit(flat[:, :3]), _unit(flat[:, 3:])
    second = _unit(second - np.einsum("ij,ij->i", first, second)[:, None] * first)
    matrix = np.stack((first, second, np.cross(first, second)), axis=1)
    quaternions = Rotation.from_matrix(matrix).as_quat(canonical=True)
    return np.asarray(quaternions, np.float64).reshape(*rows.shape[:-1], 4)


def axis_angle_to_quaternion(axis_angle: npt.ArrayLike) -> Float64Array:
    """Write rotation vectors as quaternions.

    Parameters
    ----------
    axis_angle
        (..., 3): axis times angle, radians.

    Returns
    -------
    (..., 4) float64
        Unit quaternions xyzw, real part not negative.

    Raises
    ------
    ValueError
        If the shape is wrong.
    """
    from scipy.spatial.transform import Rotation

    vectors = np.asarray(axis_angle, np.float64)
    if vectors.shape[-1:] != (3,):
        raise ValueError(f"rotation vectors must be of shape (..., 3), not {vectors.shape}")
    quaternions = Rotation.from_rotvec(vectors.reshape(-1, 3).copy()).as_quat(canonical=True)
    return np.asarray(quaternions, np.float64).reshape(*vectors.shape[:-1], 4)


def make_sign_continuous(quaternions: npt.ArrayLike) -> Float64Array:
    """Choose signs so that successive quaternions never point into opposite hemispheres.

    ``q`` and ``-q`` are the same rotation; devices and conversions jump between the two.

    Parameters
    ----------
    quaternions
        (N, 4) quaternions in time order.

    Returns
    -------
    (N, 4) float64
        The same rotations; the first sign is kept.

    Raises
    ------
    ValueError
        If the shape is wrong.
    """
    q = np.asarray(quaternions, np.float64)
    if q.ndim != 2 or q.shape[1] != 4:
        raise ValueError(f"quaternions must be of shape (N, 4), not {q.shape}")
    flips = np.einsum("ij,ij->i", q[1:], q[:-1]) < 0
    odd = np.logical_xor.accumulate(np.concatenate(([False], flips)))[: len(q)]
    return np.where(odd[:, None], -q, q)


def interpolate_poses(
    time_ns: npt.ArrayLike,
    poses: npt.ArrayLike,
    ticks_ns: npt.ArrayLike,
    max_gap_ns: int,
) -> tuple[Float64Array, npt.NDArray[np.bool_]]:
    """Interpolate poses at ticks: position linearly, rotation by slerp on the shorter arc.

    Parameters
    ----------
    time_ns
        (N,) strictly increasing integers: sample times.
    poses
        (N, 7) poses.
    ticks_ns
        (M,) integers: wanted times. In time order, if the signs of the resulting quaternions
        are to be continuous.
    max_gap_ns
        The longest period to interpolate across.

    Returns
    -------
    poses : (M, 7) float64
        Poses with unit, sign-continuous quaternions. At ticks that are not valid, the nearest
        sample.
    valid : (M,) bool
        False in gaps and outside the samples; see `exumi_data.time.bracket_indices`.

    Raises
    ------
    ValueError
        If shapes disagree, there are no samples, a number is not finite or a quaternion is zero.
    """
    samples = _as_poses(poses)
    time = np.asarray(time_ns)
    _check_samples(time, samples, 2)
    lo, weight, valid = bracket_indices(time, ticks_ns, max_gap_ns)
    before = samples[lo]
    after = samples[np.minimum(lo + 1, len(samples) - 1)]
    w = weight[:, None]
    out = np.empty_like(before)
    out[:, :3] = before[:, :3] + w * (after[:, :3] - before[:, :3])
    out[:, 3:] = make_sign_continuous(_slerp(_unit(before[:, 3:]), _unit(after[:, 3:]), weight))
    return out, valid


def interpolate_linear(
    time_ns: npt.ArrayLike,
    values: npt.ArrayLike,
    ticks_ns: npt.ArrayLike,
    max_gap_ns: int,
) -> tuple[Float64Array, npt.NDArray[np.bool_]]:
    """Interpolate values linearly at ticks.

    Parameters
    ----------
    time_ns
        (N,) strictly increasing integers: sample times.
    values
        (N,) or (N, C) numbers.
    ticks_ns
        (M,) integers: wanted times.
    max_gap_ns
        The longest period to interpolate across.

    Returns
    -------
    values : (M,) or (M, C) float64
        At ticks that are not valid, the nearest sample.
    valid : (M,) bool
        False in gaps and outside the samples; see `exumi_data.time.bracket_indices`.

    Raises
    ------
    ValueError
        If shapes disagree, there are no samples or a number is not finite.
    """
    samples = np.asarray(values)
    time = np.asarray(time_ns)
    if samples.ndim not in (1, 2):
        raise ValueError(f"values must be of shape (N,) or (N, C), not {samples.shape}")
    _check_samples(time, samples, samples.ndim)
    brackets = bracket_indices(time, ticks_ns, max_gap_ns)
    return _lerp(samples, brackets), brackets.valid


def _lerp(samples: npt.NDArray[Any], brackets: Brackets) -> Float64Array:
    """Interpolate (N,) or (N, C) samples at brackets."""
    before = samples[brackets.lo].astype(np.float64)
    after = samples[np.minimum(brackets.lo + 1, len(samples) - 1)].astype(np.float64)
    weight = brackets.weight if samples.ndim == 1 else brackets.weight[:, None]
    # written so that equal neighbours are returned bit for bit
    return np.asarray(before + weight * (after - before), np.float64)


def _slerp(before: Float64Array, after: Float64Array, weight: Float64Array) -> Float64Array:
    """Slerp (M, 4) unit quaternions on the shorter arc.

    SciPy's Slerp wants one spline over all samples and refuses ticks outside; this one takes
    the pairs that the brackets chose, and gaps never enter.
    """
    cosine = np.einsum("ij,ij->i", before, after)
    after = np.where(cosine[:, None] < 0, -after, after)
    cosine = np.minimum(np.abs(cosine), 1.0)
    angle = np.arccos(cosine)
    near = cosine > _NEARLY_PARALLEL
    sine = np.where(near, 1.0, np.sin(angle))
    first = np.where(near, 1.0 - weight, np.sin((1.0 - weight) * angle) / sine)
    second = np.where(near, weight, np.sin(weight * angle) / sine)
    return _unit(first[:, None] * before + second[:, None] * after)


def _unit(vectors: Float64Array) -> Float64Array:
    """Scale vectors along the last axis to unit length; refuse zero."""
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not (norm > 1e-12).all():
        raise ValueError(
            "a quaternion or a row of a 6-D rotation is zero (or its rows are parallel)"
        )
    return np.asarray(vectors / norm, np.float64)


def _rotation(flat: Float64Array) -> Rotation:
    """SciPy's rotation of (N, 7) poses."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(flat[:, 3:])


def _flat(poses: Float64Array) -> Float64Array:
    """Copy (..., 7) poses to (N, 7): SciPy refuses read-only memory in places."""
    return poses.reshape(-1, 7).copy()


def _as_poses(pose: npt.ArrayLike) -> Float64Array:
    """Check the shape of poses and return them as float64."""
    poses = np.asarray(pose, np.float64)
    if poses.shape[-1:] != (7,):
        raise ValueError(f"poses must be of shape (..., 7), not {poses.shape}")
    return poses


def _check_samples(time: npt.NDArray[Any], samples: npt.NDArray[Any], ndim: int) -> None:
    """Check that there is one finite sample for each time."""
    if samples.ndim != ndim or len(samples) != len(time):
        raise ValueError(f"{len(time)} times do not fit samples of shape {samples.shape}")
    if not np.isfinite(samples).all():
        bad = ~np.isfinite(samples.reshape(len(samples), -1)).all(axis=1)
        raise ValueError(f"sample {int(bad.argmax())} is not finite")
