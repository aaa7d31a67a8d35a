"""Relative actions from the common timeline."""

import numpy as np

from exumi_data.geometry import relative, rotation_6d
from exumi_loaders.timeline import Timeline

__all__ = ["relative_actions"]


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
    action : (B, S, 10) float32
        Pose relative to step 0 (x y z in metres, first two rows of the rotation matrix), and the
        absolute width in metres. 9 columns without a width, 1 without a pose.
    valid : (B, S) bool
        Whether pose and width are measured there (and, for poses, at step 0).
    """
    layout = timeline.layout
    columns = []
    valid = np.ones(ticks.shape, dtype=bool)
    if layout.pose is not None:
        poses = np.asarray(timeline.low[layout.pose])[ticks]
        moved = relative(poses[:, zero : zero + 1], poses)
        columns += [moved[..., :3], rotation_6d(moved[..., 3:])]
        good = timeline.valid[layout.pose][ticks]
        valid &= good & good[:, zero : zero + 1]
    if layout.width is not None:
        columns.append(np.asarray(timeline.low[layout.width])[ticks][..., None])
        valid &= timeline.valid[layout.width][ticks]
    return np.concatenate(columns, axis=-1, dtype=np.float32), valid
