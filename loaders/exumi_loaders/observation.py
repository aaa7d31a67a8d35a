"""Proprioception of a policy: one computation for recorded windows and for live streams."""

from collections.abc import Mapping

import numpy as np

from exumi_loaders.actions import between_poses, motion_columns
from exumi_loaders.policy_spec import PolicySpec

__all__ = ["base_poses", "put_proprioception"]


def base_poses(spec: PolicySpec, seen: Mapping[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """Return the pose of each gripper that its actions are relative to.

    Parameters
    ----------
    spec : PolicySpec
    seen : mapping of str to (R, n, ...)
        Of each pose and width stream the samples that are at hand at the observed steps.

    Returns
    -------
    dict of str to (R, 1, 7) float64, or None
        The pose at hand at step 0: what is known when the policy acts. None for absolute actions.
    """
    if spec.action == "absolute":
        return None
    return {name: seen[name][:, -1:] for name in spec.pose}


def put_proprioception(
    spec: PolicySpec,
    arrays: Mapping[str, np.ndarray],
    rows: np.ndarray,
    seen: Mapping[str, np.ndarray],
    fresh: Mapping[str, np.ndarray],
) -> None:
    """Fill the proprioception of some rows of a batch, where the policy has any.

    Parameters
    ----------
    spec : PolicySpec
    arrays : mapping of str to ndarray
        A batch.
    rows : (R,) int64
    seen : mapping of str to (R, n, 7) float64 or (R, n) float32
        Of each pose and width stream the samples that are at hand at the observed steps.
    fresh : mapping of str to (R, n) bool
        Whether they are not stale.
    """
    if not spec.proprioception:
        return
    base = base_poses(spec, seen)
    valid = np.logical_and.reduce([fresh[name] for name in spec.pose + spec.width])
    for name in spec.pose if base is not None else ():
        valid &= fresh[name][:, -1:]
    arrays["proprioception"][rows] = motion_columns(spec.layout.grippers, seen, base)
    arrays["proprioception_valid"][rows] = valid
    if len(spec.pose) < 2:
        return
    first, *others = spec.pose
    between = between_poses(seen[first][:, -1:], [seen[name] for name in others])
    arrays["between"][rows] = between
    poses = np.logical_and.reduce([fresh[name] for name in others])
    arrays["between_valid"][rows] = poses & fresh[first][:, -1:]
