"""Relative actions from the common timeline."""

from collections.abc import Iterable, Mapping

import numpy as np

from exumi_data.geometry import axis_angle_to_quaternion, compose, relative, rotation_6d
from exumi_loaders.layout import Gripper, Layout
from exumi_loaders.timeline import Timeline

__all__ = [
    "action_columns",
    "between_columns",
    "between_grippers",
    "between_poses",
    "motion_columns",
    "relative_actions",
    "relative_to_start",
]

_POSE_COLUMNS = ("x", "y", "z", "r00", "r01", "r02", "r10", "r11", "r12")


def action_columns(layout: Layout) -> tuple[str, ...]:
    """Name the columns of an action: one gripper after the other, each its pose, then its width.

    Parameters
    ----------
    layout : Layout

    Returns
    -------
    tuple of str
        ``<stream>.x`` ... ``<stream>.r12`` of a pose (metres, first two rows of the rotation
        matrix), ``<stream>`` of a width (metres).
    """
    names: list[str] = []
    for pose, width in layout.grippers:
        names += [f"{pose}.{column}" for column in _POSE_COLUMNS] if pose else []
        names += [width] if width else []
    return tuple(names)


def between_columns(layout: Layout) -> tuple[str, ...]:
    """Name the columns of `between_grippers`: ``<stream>.x`` ... of all poses but the first.

    Parameters
    ----------
    layout : Layout
    """
    return tuple(f"{pose}.{column}" for pose in layout.pose[1:] for column in _POSE_COLUMNS)


def motion_columns(
    grippers: Iterable[Gripper],
    values: Mapping[str, np.ndarray],
    base: Mapping[str, np.ndarray] | None,
) -> np.ndarray:
    """Write poses and widths as the columns of an action.

    Parameters
    ----------
    grippers : iterable of Gripper
    values : mapping of str to (..., S, 7) float64 or (..., S)
        Of each stream: poses, or widths in metres.
    base : mapping of str to (..., 1, 7) float64, optional
        Of each pose stream the pose that its poses are relative to; None leaves them as they are,
        in their parent frame.

    Returns
    -------
    (..., S, A) float32
        Columns as in `action_columns`.
    """
    columns: list[np.ndarray] = []
    for pose, width in grippers:
        if pose is not None:
            columns += _nine(None if base is None else base[pose], values[pose])
        if width is not None:
            columns.append(values[width][..., None])
    return np.concatenate(columns, axis=-1, dtype=np.float32)


def relative_actions(
    timeline: Timeline, ticks: np.ndarray, *, zero: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the actions of a batch of windows.

    Parameters
    ----------
    timeline : Timeline
    ticks : (B, S) int64
        Flat ticks of the steps.
    zero : int
        Column of step 0, whose pose is the reference frame.

    Returns
    -------
    action : (B, S, A) float32
        Of each gripper its pose relative to its own at step 0 (x y z in metres, first two rows of
        the rotation matrix) and its absolute width in metres; columns as in `action_columns`.
    valid : (B, S) bool
        Whether all poses and widths are measured there (and, for poses, at step 0).
    """
    layout = timeline.layout
    values, valid = timeline.motion(ticks)
    base = {name: values[name][:, zero : zero + 1] for name in layout.pose}
    for name in layout.pose:
        valid &= timeline.valid[name][ticks[:, zero : zero + 1]]
    return motion_columns(layout.grippers, values, base), valid


def between_grippers(
    timeline: Timeline, ticks: np.ndarray, *, zero: int
) -> tuple[np.ndarray, np.ndarray]:
    """Express the poses of the other grippers in the frame that the first one has at step 0.

    Parameters
    ----------
    timeline : Timeline
        With at least two pose streams of one parent frame.
    ticks : (B, S) int64
        Flat ticks of the steps.
    zero : int
        Column of step 0.

    Returns
    -------
    between : (B, S, 9·(G−1)) float32
        ``inv(T_first at step 0)·T_other`` of each other pose; columns as in `between_columns`.
    valid : (B, S) bool
        Whether these poses are measured there, and the first at step 0.
    """
    first, *others = timeline.layout.pose
    base = np.asarray(timeline.low[first])[ticks[:, zero : zero + 1]]
    valid = np.repeat(timeline.valid[first][ticks[:, zero : zero + 1]], ticks.shape[1], axis=1)
    for name in others:
        valid &= timeline.valid[name][ticks]
    return between_poses(base, [np.asarray(timeline.low[name])[ticks] for name in others]), valid


def between_poses(base: np.ndarray, others: Iterable[np.ndarray]) -> np.ndarray:
    """Express poses of other grippers in the frame of one.

    Parameters
    ----------
    base : (..., 1, 7) float64
    others : iterable of (..., S, 7) float64

    Returns
    -------
    (..., S, 9·(G−1)) float32
        Columns as in `between_columns`.
    """
    columns = [part for poses in others for part in _nine(base, poses)]
    return np.concatenate(columns, axis=-1, dtype=np.float32)


def relative_to_start(
    timeline: Timeline, ticks: np.ndarray, start: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Express poses relative to a noisy start: where a policy was started is never exactly known.

    Parameters
    ----------
    timeline : Timeline
    ticks : (B, S) int64
        Flat ticks of the steps.
    start : (B,) int64
        Flat tick of the start of each window's episode.
    noise : (B, P, 6) float64
        Of each pose stream: metres along the axes of its parent frame, and a rotation vector in
        radians about the axes of its child frame.

    Returns
    -------
    proprioception : (B, S, A) float32
        Of each gripper its pose relative to its own noisy start, and its absolute width; columns
        as in `action_columns`.
    valid : (B, S) bool
        Whether all of it is measured there, and the poses at the start.
    """
    layout = timeline.layout
    values, valid = timeline.motion(ticks)
    base: dict[str, np.ndarray] = {}
    for name, error in zip(layout.pose, np.moveaxis(noise, 1, 0), strict=True):
        turned = np.concatenate(
            (np.zeros_like(error[:, :3]), axis_angle_to_quaternion(error[:, 3:])), axis=1
        )
        noisy = compose(np.asarray(timeline.low[name])[start], turned)
        noisy[:, :3] += error[:, :3]
        base[name] = noisy[:, None]
        valid &= timeline.valid[name][start][:, None]
    return motion_columns(layout.grippers, values, base), valid


def _nine(base: np.ndarray | None, poses: np.ndarray) -> list[np.ndarray]:
    """Return position (..., 3) and two rows of the rotation (..., 6), relative to a base if any."""
    moved = poses if base is None else relative(base, poses)
    return [moved[..., :3], rotation_6d(moved[..., 3:])]
