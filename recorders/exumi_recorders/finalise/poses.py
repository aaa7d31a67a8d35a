"""From a headset's poses to poses of the world: right-handed, Z up, X right, Y forward."""

import numpy as np
import numpy.typing as npt

from exumi_data.geometry import make_sign_continuous
from exumi_recorders.world_frame import from_headset_world

__all__ = ["IDENTITY", "PoseSigns", "to_world"]

IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""The pose that changes nothing."""
_SMALLEST = 1e-6


def to_world(
    raw: npt.NDArray[np.floating], world_frame: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Express poses of a left-handed, Y-up space in the world that was marked in it.

    As `exumi_recorders.world_frame`, but poses that are none do no harm.

    Parameters
    ----------
    raw : (N, 7) float
        As they were sent: x y z qx qy qz qw.
    world_frame : (7,) float
        Pose of the world in the same space, as it was sent.

    Returns
    -------
    poses : (N, 7) float64
        With unit quaternions; NaN where there is none.
    valid : (N,) bool
        Whether a pose is one: finite, with a quaternion that is not zero.
    """
    given = np.asarray(raw, np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        norm = np.linalg.norm(given[:, 3:], axis=1)
    valid = np.isfinite(given).all(axis=1) & (norm > _SMALLEST) & np.isfinite(norm)
    out = np.full(given.shape, np.nan)
    if valid.any():
        out[valid] = from_headset_world(given[valid], world_frame)
    return out, valid


class PoseSigns:
    """Keeps the signs of quaternions continuous, block by block; NaN is passed over."""

    def __init__(self) -> None:
        self._last: npt.NDArray[np.float64] | None = None

    def take(
        self, poses: npt.NDArray[np.float64], valid: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.float64]:
        """Return poses whose quaternions do not change their sign.

        Parameters
        ----------
        poses : (N, 7) float64
        valid : (N,) bool
        """
        quaternions = poses[valid, 3:]
        if not len(quaternions):
            return poses
        before = quaternions[:1] if self._last is None else self._last[None]
        continuous = make_sign_continuous(np.concatenate([before, quaternions]))[1:]
        self._last = continuous[-1]
        out = poses.copy()
        out[valid, 3:] = continuous
        return out
