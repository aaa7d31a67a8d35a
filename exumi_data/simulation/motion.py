"""Smooth motion as a sum of minimum-jerk submovements.

A hand does not stop at every waypoint: it starts the next submovement before the last one has
ended. A track is therefore a start value plus steps that may overlap in time, each following the
minimum-jerk profile of Flash and Hogan (1985), ``s(x) = 10 x^3 - 15 x^4 + 6 x^5``. Every track is
a function of continuous time and can be evaluated at any times, in any order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Float64Array",
    "RotationTrack",
    "Step",
    "Track",
    "minimum_jerk",
    "minimum_jerk_inverse",
    "multiply_quaternions",
    "quaternion_from_rotation_vector",
    "rotate_vectors",
]

Float64Array = NDArray[np.float64]


def minimum_jerk(x: ArrayLike) -> Float64Array:
    """Return the minimum-jerk progress for relative time `x`.

    Parameters
    ----------
    x : array_like
        Relative time, 0 at the start of a movement and 1 at its end; clamped to that range.

    Returns
    -------
    ndarray of float64
        Progress from 0 to 1, same shape as `x`.
    """
    x = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
    progress: Float64Array = x * x * x * (10.0 + x * (-15.0 + 6.0 * x))
    return progress


def minimum_jerk_inverse(progress: float) -> float:
    """Return the relative time at which a minimum-jerk movement reaches `progress`.

    Parameters
    ----------
    progress : float
        Wanted progress, in [0, 1].

    Returns
    -------
    float
        Relative time in [0, 1], within 1e-15.

    Raises
    ------
    ValueError
        If `progress` lies outside [0, 1].
    """
    if not 0.0 <= progress <= 1.0:
        raise ValueError(f"Invalid progress ({progress}). It must lie in [0, 1].")
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if minimum_jerk(middle) < progress:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@dataclass(frozen=True, slots=True)
class Step:
    """One submovement: from `start_s`, for `duration_s`, adding `delta` in the end.

    Attributes
    ----------
    start_s, duration_s : float
        When the submovement starts and how long it takes, in seconds.
    delta : tuple of float
        What it adds, in the units of its track (a rotation vector in radians for rotations).
    """

    start_s: float
    duration_s: float
    delta: tuple[float, ...]


def _progress(steps: Sequence[Step], t_s: Float64Array) -> Float64Array:
    """Return the progress of every step at every time, (N, M)."""
    start = np.array([step.start_s for step in steps])
    duration = np.array([step.duration_s for step in steps])
    return minimum_jerk((t_s[:, None] - start) / duration)


@dataclass(frozen=True, slots=True)
class Track:
    """A vector that moves by a sum of minimum-jerk steps.

    Attributes
    ----------
    initial : tuple of float
        Value before the first step, D components.
    steps : tuple of Step
        Submovements, which may overlap, each with a delta of D components.
    """

    initial: tuple[float, ...]
    steps: tuple[Step, ...]

    def __call__(self, t_s: ArrayLike) -> Float64Array:
        """Return the value at times `t_s`.

        Parameters
        ----------
        t_s : array_like, shape (N,)
            Times in seconds since session start.

        Returns
        -------
        ndarray of float64, shape (N, D)
            The value at each time.
        """
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        initial = np.array(self.initial)
        if not self.steps:
            return np.tile(initial, (len(times), 1))
        delta = np.array([step.delta for step in self.steps])
        value: Float64Array = initial + _progress(self.steps, times) @ delta
        return value


@dataclass(frozen=True, slots=True)
class RotationTrack:
    """An orientation that moves by a product of minimum-jerk steps.

    The quaternion is built from half-angle sines and cosines and never passes through a matrix,
    so its sign is continuous in time, however the track is sampled.

    Attributes
    ----------
    initial : tuple of float
        Unit quaternion xyzw before the first step.
    steps : tuple of Step
        Submovements; `delta` is a rotation vector (radians) in the parent reference frame,
        applied from the left, in the order given.
    """

    initial: tuple[float, float, float, float]
    steps: tuple[Step, ...]

    def __call__(self, t_s: ArrayLike) -> Float64Array:
        """Return the orientation at times `t_s`.

        Parameters
        ----------
        t_s : array_like, shape (N,)
            Times in seconds since session start.

        Returns
        -------
        ndarray of float64, shape (N, 4)
            Unit quaternions xyzw, continuous in sign.
        """
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        quaternion = np.tile(np.array(self.initial), (len(times), 1))
        if self.steps:
            progress = _progress(self.steps, times)
            for column, step in zip(progress.T, self.steps, strict=True):
                if column.any():
                    turn = quaternion_from_rotation_vector(column[:, None] * np.array(step.delta))
                    quaternion = multiply_quaternions(turn, quaternion)
        unit: Float64Array = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
        return unit


def quaternion_from_rotation_vector(vector: Float64Array) -> Float64Array:
    """Return the unit quaternions of rotation vectors.

    Parameters
    ----------
    vector : ndarray of float64, shape (N, 3)
        Axis times angle, radians.

    Returns
    -------
    ndarray of float64, shape (N, 4)
        Quaternions xyzw, continuous in the vector.
    """
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    # np.sinc is sin(pi x)/(pi x): well behaved at angle zero.
    return np.hstack([vector * (0.5 * np.sinc(angle / (2.0 * np.pi))), np.cos(0.5 * angle)])


def multiply_quaternions(a: Float64Array, b: Float64Array) -> Float64Array:
    """Return the Hamilton products ``a * b`` (first `b`, then `a`).

    SciPy's ``Rotation`` would do, but does not promise to keep the sign of a quaternion, which
    sign continuity needs.

    Parameters
    ----------
    a, b : ndarray of float64, shape (N, 4)
        Quaternions xyzw.

    Returns
    -------
    ndarray of float64, shape (N, 4)
        Quaternions xyzw.
    """
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=1,
    )


def rotate_vectors(quaternion: Float64Array, vector: Float64Array) -> Float64Array:
    """Return vectors turned by unit quaternions.

    Parameters
    ----------
    quaternion : ndarray of float64, shape (N, 4)
        Unit quaternions xyzw.
    vector : ndarray of float64, shape (N, 3)
        Vectors.

    Returns
    -------
    ndarray of float64, shape (N, 3)
        The turned vectors.
    """
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, vector)
    turned: Float64Array = vector + w * twice + np.cross(axis, twice)
    return turned
