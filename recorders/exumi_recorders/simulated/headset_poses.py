"""The poses that a simulated headset tracks, in its own left-handed world."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.geometry import compose, inverse
from exumi_data.simulation import Truth, simulate_play
from exumi_recorders.simulated.headset_options import HeadsetOptions, SimulatedSession
from exumi_recorders.world_frame import from_headset_world, to_headset_world

__all__ = [
    "T_controller_tcp",
    "Tracked",
    "app_offset",
    "session_truth",
    "track",
    "unity_quaternion",
]

Float64Array = npt.NDArray[np.float64]

_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_BLOCK = 512  # the truth needs memory for every sample and step of the session
_APART_M = (0.3, 0.0, 0.0)
_RECENTRED = (0.4, 0.0, -0.25, 0.0, 0.3826834323650898, 0.0, 0.9238795325112867)


@dataclass(frozen=True, slots=True)
class Tracked:
    """Poses x y z qx qy qz qw, left-handed and y up, (N, 7) each.

    Attributes
    ----------
    hand, other, head : ndarray of float64
        What the app sends of the gripper's hand, of the other one, and of the headset.
    """

    hand: Float64Array
    other: Float64Array
    head: Float64Array


def session_truth(session: SimulatedSession) -> Truth:
    """Return what happens in a session.

    Parameters
    ----------
    session : SimulatedSession
    """
    return simulate_play(
        seed=session.seed,
        duration_s=session.duration_s,
        objects=session.objects,
        taps=session.taps,
    ).truth


def unity_quaternion(x_deg: float, y_deg: float, z_deg: float) -> Float64Array:
    """Return Unity's ``Quaternion.Euler(x, y, z)``: first about z, then x, then y.

    Parameters
    ----------
    x_deg, y_deg, z_deg : float

    Returns
    -------
    ndarray of float64, shape (4,)
        xyzw.
    """
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("YXZ", [y_deg, x_deg, z_deg], degrees=True)
    return np.asarray(turn.as_quat(), np.float64)


def app_offset() -> Float64Array:
    """Return the pose, in the left controller's left-handed frame, that the apps send, (7,)."""
    first = np.append((-0.1, -0.04, -0.07), unity_quaternion(-30, 25, 25))
    return compose(first, np.append(np.zeros(3), unity_quaternion(45, 0, -90)))


def T_controller_tcp(options: HeadsetOptions) -> Float64Array:  # noqa: N802  # as poses are called
    """Return what leads from the recorded pose to the gripper's: the truth for a calibration.

    Parameters
    ----------
    options : HeadsetOptions

    Returns
    -------
    ndarray of float64, shape (7,)
    """
    if options.mount is None:
        return np.array(_REST)
    return inverse(compose(options.mount, from_headset_world(app_offset(), _REST)))


def track(options: HeadsetOptions, truth: Truth, time_s: Float64Array) -> Tracked:
    """Return what is tracked at some times.

    Parameters
    ----------
    options : HeadsetOptions
    truth : Truth
    time_s : ndarray of float64, shape (N,)
        Seconds since the epoch, in order.
    """
    rng = np.random.default_rng((options.seed, 1))
    held = _frozen(options, time_s)
    gripper = _noisy(rng, _gripper(truth, held - options.lag_s), options)[_same(held)]
    head = _noisy(rng, _head(options, time_s), options)
    apart = compose((*_APART_M, 0, 0, 0, 1), gripper)
    sent = (_sent(options, gripper), _sent(options, apart), to_headset_world(head, _world(options)))
    return Tracked(*(_recentred(options, time_s, poses) for poses in sent))


def _world(options: HeadsetOptions) -> Float64Array:
    return np.array(options.world_frame)


def _gripper(truth: Truth, time_s: Float64Array) -> Float64Array:
    blocks = np.array_split(time_s, len(time_s) // _BLOCK + 1)
    return np.concatenate([truth.pose(block) for block in blocks])


def _sent(options: HeadsetOptions, gripper: Float64Array) -> Float64Array:
    """Return what the app sends: the gripper's pose, or its controller's with the offset."""
    if options.mount is None:
        return to_headset_world(gripper, _world(options))
    controller = to_headset_world(compose(gripper, options.mount), _world(options))
    return compose(controller, app_offset())


def _head(options: HeadsetOptions, time_s: Float64Array) -> Float64Array:
    """Return the poses of a head that sways a little and looks down to the table."""
    from scipy.spatial.transform import Rotation

    sway = 0.01 * np.sin(np.outer(time_s, 2 * np.pi * np.array([0.23, 0.17, 0.31])))
    turn = np.zeros((len(time_s), 3))
    turn[:, 0] = -0.7
    turn[:, 2] = 0.1 * np.sin(2 * np.pi * 0.11 * time_s)
    return np.hstack([np.array(options.head) + sway, Rotation.from_rotvec(turn).as_quat()])


def _noisy(rng: np.random.Generator, poses: Float64Array, options: HeadsetOptions) -> Float64Array:
    from scipy.spatial.transform import Rotation

    shift = rng.normal(0, 1, (len(poses), 3)) * options.noise_m
    turn = Rotation.from_rotvec(rng.normal(0, 1, (len(poses), 3)) * options.noise_rad)
    return compose(poses, np.hstack([shift, turn.as_quat()]))


def _frozen(options: HeadsetOptions, time_s: Float64Array) -> Float64Array:
    """Return the times whose poses are sent: those of the freeze are all its first."""
    start = options.faults.freeze_at_s
    if start is None:
        return time_s
    frozen = (time_s >= start) & (time_s < start + options.faults.freeze_s)
    return np.where(frozen, time_s[np.argmax(frozen)], time_s) if frozen.any() else time_s


def _same(time_s: Float64Array) -> npt.NDArray[np.intp]:
    """Index of the first sample of each time, so that a frozen pose has frozen noise."""
    _, first, back = np.unique(time_s, return_index=True, return_inverse=True)
    return np.asarray(first[back], np.intp)


def _recentred(options: HeadsetOptions, time_s: Float64Array, poses: Float64Array) -> Float64Array:
    at_s = options.faults.recentre_at_s
    if at_s is None:
        return poses
    return np.where((time_s >= at_s)[:, None], compose(_RECENTRED, poses), poses)
