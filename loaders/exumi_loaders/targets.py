"""Actions of a policy as where its grippers are to be, and when."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.errors import UsageError
from exumi_data.geometry import compose, rotation_from_6d
from exumi_data.ticks import tick_times_ns
from exumi_loaders.policy_spec import PolicySpec

__all__ = ["Targets", "targets_of"]


@dataclass(frozen=True)
class Targets:
    """Where the grippers are to be, and when.

    Attributes
    ----------
    time_ns : (A,) int64
        On the clock of the samples.
    pose : dict of str to (A, 7) float64
        Of each pose stream: x y z qx qy qz qw in its parent frame, metres.
    width : dict of str to (A,) float64
        Of each width stream, metres.
    """

    time_ns: np.ndarray
    pose: dict[str, np.ndarray]
    width: dict[str, np.ndarray]


def targets_of(
    spec: PolicySpec,
    action: npt.ArrayLike,
    base: Mapping[str, np.ndarray] | None,
    at_ns: int,
) -> Targets:
    """Turn an action into targets.

    Parameters
    ----------
    spec : PolicySpec
    action : (A, D) array or tensor
        As `PolicyWindows` has it, not normalised. Rotations need not be orthogonal.
    base : mapping of str to (7,) float64, optional
        Of each pose stream the pose that its action is relative to; None for absolute actions.
    at_ns : int
        The time of step 0.

    Raises
    ------
    UsageError
        The shape is another, a number is not finite, or a rotation is none.
    """
    numbers = _as_action(action, (len(spec.action_steps), len(spec.action_columns)))
    pose, width, column = {}, {}, 0
    for pose_name, width_name in spec.layout.grippers:
        if pose_name is not None:
            moved = _as_poses(numbers[:, column : column + 9])
            pose[pose_name] = moved if base is None else compose(base[pose_name], moved)
            column += 9
        if width_name is not None:
            width[width_name] = numbers[:, column].copy()
            column += 1
    time = at_ns + tick_times_ns(np.array(spec.action_steps), spec.tick)
    return Targets(time, pose, width)


def _as_action(action: Any, shape: tuple[int, int]) -> np.ndarray:
    if hasattr(action, "detach"):
        action = action.detach().cpu().numpy()
    numbers = np.asarray(action, dtype=np.float64)
    if numbers.shape != shape:
        raise UsageError(f"an action of shape {numbers.shape}, expected {shape}")
    if not np.isfinite(numbers).all():
        raise UsageError("the action has numbers that are not finite")
    return numbers


def _as_poses(columns: np.ndarray) -> np.ndarray:
    try:
        rotation = rotation_from_6d(columns[:, 3:])
    except ValueError as error:
        raise UsageError(f"the action has a rotation that is none ({error})") from None
    return np.concatenate((columns[:, :3], rotation), axis=1)
