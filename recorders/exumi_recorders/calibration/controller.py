"""Where the tool is, seen from the controller: by turning about a point, by alignment, by a camera.

- `pivot`: the tip is held at one point while the hand turns; all poses then agree on the point.
- `aligned`: the tool stands in a known orientation, in a jig.
- `hand_eye`: a camera on the hand looks at a marker that stands still.
- `chain`: transforms that somebody else has published, multiplied.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.geometry import pose_to_matrix
from exumi_data.model.description import CalibrationItem

__all__ = [
    "CONTROLLER_TCP",
    "Aligned",
    "HandEye",
    "Pivot",
    "aligned",
    "chain",
    "chain_item",
    "hand_eye",
    "hand_eye_item",
    "pivot",
    "tcp_item",
]

CONTROLLER_TCP = "T_controller_tcp"
"""Name of the item: a 4x4 matrix, metres."""
PIVOT_METHOD = "exumi-pivot/1"
HAND_EYE_METHOD = "exumi-hand-eye/1"

Float64Array = NDArray[np.float64]

_FEWEST = 30
# Long enough that a tracker that wanders for a second or two is seen in what they differ by.
_PARTS = 6
_LEAST_TURN_RAD = math.radians(8.0)
_MOST_RESIDUAL_M = 5e-3
_MOST_RESIDUAL_RAD = math.radians(2.0)
_OUTLIER = 4.0
_ROUNDS = 3
_TO_SIGMA = 1.4826
_LEAST_VIEWS, _MOST_VIEWS = 10, 80
_VIEW_APART_RAD = math.radians(3.0)
# What a radian of the marker's orientation counts, and where errors begin to count less.
_ARM_M, _ROBUST_M = 0.05, 5e-3


@dataclass(frozen=True, eq=False)
class Pivot:
    """What turning about a point gives.

    Attributes
    ----------
    tip_m : (3,) float64
        The tip in the controller's frame.
    point_m : (3,) float64
        The point that it was held at, in the world.
    residual_m : float
        How far the tip was off the point, rms.
    sigma_m : float
        Standard deviation of the tip, all axes together.
    poses : int
        That were used; outliers are left out.
    """

    tip_m: Float64Array
    point_m: Float64Array
    residual_m: float
    sigma_m: float
    poses: int


def pivot(poses: Float64Array) -> Pivot:
    """Find the tip that stayed where it was while the hand turned.

    Least squares of R·tip + p = point over all poses; poses that are off by more than four standard
    deviations are left out. The uncertainty is a jackknife's over six stretches of time, for
    errors that follow each other.

    Parameters
    ----------
    poses : (N, 7) float64
        In order of time.

    Returns
    -------
    Pivot

    Raises
    ------
    CalibrationRefusedError
        Too few poses, the hand turned about one axis only, or the tip moved.
    """
    if len(poses) < _FEWEST:
        raise CalibrationRefusedError(f"there are {len(poses)} poses, needed are {_FEWEST}")
    matrices = pose_to_matrix(poses)
    _check_turns(matrices[:, :3, :3], "turn the hand to and fro and sideways, by 30 degrees")
    used = np.ones(len(matrices), np.bool_)
    for _ in range(_ROUNDS):
        tip, point = _pivoted(matrices[used])
        off = np.linalg.norm(matrices[:, :3, :3] @ tip + matrices[:, :3, 3] - point, axis=1)
        scale = _TO_SIGMA * float(np.median(off[used]))
        used = off <= _OUTLIER * max(scale, 1e-6)
    tip, point = _pivoted(matrices[used])
    off = np.linalg.norm(matrices[used, :3, :3] @ tip + matrices[used, :3, 3] - point, axis=1)
    residual = float(np.sqrt(np.mean(off**2)))
    if residual > _MOST_RESIDUAL_M:
        raise CalibrationRefusedError(
            f"the tip was off the point by {1e3 * residual:.1f} mm",
            fix="Hold it in a dent or a hole; nothing may slip.",
        )
    tips = np.stack([_pivoted(part)[0] for part in _without_a_part(matrices[used])])
    return Pivot(tip, point, residual, _jackknife(tips), int(used.sum()))


def _pivoted(matrices: Float64Array) -> tuple[Float64Array, Float64Array]:
    count = len(matrices)
    columns = np.concatenate(
        [matrices[:, :3, :3], np.broadcast_to(-np.eye(3), (count, 3, 3))], axis=2
    )
    solved = np.linalg.lstsq(columns.reshape(-1, 6), -matrices[:, :3, 3].ravel(), rcond=None)[0]
    return solved[:3], solved[3:]


def _check_turns(rotations: Float64Array, advice: str) -> None:
    """Refuse rotations about less than two axes: what lies along the axis is not seen."""
    away = (rotations - rotations.mean(axis=0)).reshape(-1, 3)
    # A turn by an angle a moves what is at right angles to it by a; the least-moved axis tells.
    least = float(np.linalg.svd(away, compute_uv=False)[-1]) / math.sqrt(len(rotations))
    if least < _LEAST_TURN_RAD:
        raise CalibrationRefusedError(
            f"the hand turned by {math.degrees(least):.0f} degrees (rms) about its second axis, "
            f"needed are {math.degrees(_LEAST_TURN_RAD):.0f}",
            fix=f"{advice[0].upper()}{advice[1:]}.",
        )


def _without_a_part(values: Float64Array) -> list[Float64Array]:
    edges = np.linspace(0, len(values), _PARTS + 1).astype(int)
    return [np.concatenate([values[:start], values[stop:]]) for start, stop in pairwise(edges)]


def _jackknife(estimates: Float64Array) -> float:
    """Return the standard deviation of an estimate by those that lack one part each."""
    count = len(estimates)
    away = estimates - estimates.mean(axis=0)
    return float(np.sqrt((count - 1) / count * np.sum(away**2)))


@dataclass(frozen=True, eq=False)
class Aligned:
    """What standing in a known orientation gives.

    Attributes
    ----------
    rotation : (3, 3) float64
        ``R_controller_tcp``.
    residual_rad : float
        How far single poses are off, rms.
    poses : int
    """

    rotation: Float64Array
    residual_rad: float
    poses: int


def aligned(poses: Float64Array, tool: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Aligned:
    """Find the tool's orientation in the controller from poses in which it is known in the world.

    Parameters
    ----------
    poses : (N, 7) float64
    tool : sequence of float, optional
        Quaternion xyzw of the tool in the world. Default: its axes are the world's.

    Returns
    -------
    Aligned

    Raises
    ------
    CalibrationRefusedError
        Too few poses, or the tool was not at rest.
    """
    from scipy.spatial.transform import Rotation

    if len(poses) < _FEWEST:
        raise CalibrationRefusedError(f"there are {len(poses)} poses, needed are {_FEWEST}")
    each = Rotation.from_quat(poses[:, 3:].copy()).inv() * Rotation.from_quat(list(tool))
    mean = each.mean()
    off = (mean.inv() * each).magnitude()
    residual = float(np.sqrt(np.mean(off**2)))
    if residual > _MOST_RESIDUAL_RAD:
        raise CalibrationRefusedError(
            f"the tool turned by {math.degrees(residual):.1f} degrees (rms) in its jig",
            fix="Record it at rest.",
        )
    return Aligned(np.asarray(mean.as_matrix(), np.float64), residual, len(poses))


def tcp_item(tip: Pivot, orientation: Aligned | None) -> CalibrationItem:
    """Make the item `T_controller_tcp`.

    Parameters
    ----------
    tip : Pivot
    orientation : Aligned or None
        None: the tool's axes are said to be the controller's.
    """
    matrix = np.eye(4)
    matrix[:3, 3] = tip.tip_m
    said = f"tip held at one point, {tip.poses} poses"
    if orientation is None:
        said += "; orientation not measured: that of the controller"
    else:
        matrix[:3, :3] = orientation.rotation
        off = math.degrees(orientation.residual_rad)
        said += f"; orientation from {orientation.poses} poses in a jig, {off:.2f} degrees rms"
    return _item(matrix, tip.sigma_m, tip.residual_m, PIVOT_METHOD, said)


def _item(
    matrix: Float64Array, sigma_m: float, residual_m: float, method: str, procedure: str
) -> CalibrationItem:
    return CalibrationItem(
        value=[[round(float(value), 9) for value in row] for row in matrix],
        unit="m",
        uncertainty=round(sigma_m, 7),
        residual=round(residual_m, 7),
        method=method,
        procedure=procedure,
    )


@dataclass(frozen=True, eq=False)
class HandEye:
    """What a camera on the hand says of where it sits.

    Attributes
    ----------
    T_hand_camera : (4, 4) float64
    residual_m, residual_rad : float
        How far the marker, which stood still, seems to have moved: rms, and median.
    sigma_m, sigma_rad : float
        Standard deviations by a jackknife.
    views : int
    """

    T_hand_camera: Float64Array
    residual_m: float
    residual_rad: float
    sigma_m: float
    sigma_rad: float
    views: int


def hand_eye(T_world_hand: Float64Array, T_camera_marker: Float64Array) -> HandEye:
    """Solve for the place of a camera on the hand, from views of a marker that stands still.

    Rotations of pairs of views are aligned (Park and Martin), positions follow by least squares;
    then all is refined together, so that the marker moves least, and views that are far off count
    less: a small marker's orientation has two solutions. OpenCV 5 has no such solver in Python.

    Parameters
    ----------
    T_world_hand : (N, 4, 4) float64
        In order of time.
    T_camera_marker : (N, 4, 4) float64
        At the same moments.

    Returns
    -------
    HandEye

    Raises
    ------
    CalibrationRefusedError
        Too few different views, rotation about one axis only, or no solution that fits.
    """
    chosen = _different(T_world_hand[:, :3, :3])
    if len(chosen) < _LEAST_VIEWS:
        raise CalibrationRefusedError(
            f"there are {len(chosen)} different views of the marker, needed are {_LEAST_VIEWS}",
            fix="Turn the hand about all axes while the marker is in sight.",
        )
    hand, marker = T_world_hand[chosen], T_camera_marker[chosen]
    _check_turns(hand[:, :3, :3], "turn the hand about at least two axes")
    solved = _hand_eye(hand, marker)
    if solved is None:
        raise CalibrationRefusedError("the views do not determine where the camera is")
    shifts, turns = [], []
    for part in _without_a_part(np.arange(len(chosen))[:, None].astype(np.float64)):
        kept = part[:, 0].astype(int)
        without = _hand_eye(hand[kept], marker[kept])
        if without is not None:
            shifts.append(without[:3, 3])
            turns.append(_rotvec(solved[:3, :3].T @ without[:3, :3]))
    off_m, off_rad = _unsteadiness(solved, hand, marker)
    if off_m > 2 * _MOST_RESIDUAL_M or off_rad > 2 * _MOST_RESIDUAL_RAD:
        raise CalibrationRefusedError(
            f"the marker seems to move by {1e3 * off_m:.1f} mm and {math.degrees(off_rad):.1f} "
            "degrees",
            fix="Take out the latency first (exumi calibrate latency, apply), check the marker's "
            "size and the intrinsics, and pause at each view.",
        )
    return HandEye(
        solved,
        off_m,
        off_rad,
        _jackknife(np.stack(shifts)),
        _jackknife(np.stack(turns)),
        len(chosen),
    )


def _different(rotations: Float64Array) -> list[int]:
    """Choose views that differ in rotation from all chosen ones, evenly thinned to a few dozen."""
    chosen: list[int] = []
    for i, rotation in enumerate(rotations):
        traces = np.array([np.sum(rotations[j] * rotation) for j in chosen])
        if (np.arccos(np.clip((traces - 1) / 2, -1, 1)) >= _VIEW_APART_RAD).all():
            chosen.append(i)
    if len(chosen) > _MOST_VIEWS:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, _MOST_VIEWS).astype(int)]
    return chosen


def _hand_eye(hand: Float64Array, marker: Float64Array) -> Float64Array | None:
    """Return ``T_hand_camera`` with hand·X·marker as constant as it can be; None without one."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    rotation = _aligned_turns(hand[:, :3, :3], marker[:, :3, :3])
    if rotation is None:
        return None
    # hand·X·marker has the same position in all views: linear in X's position and that one.
    turned = hand[:, :3, :3] @ rotation
    known = np.einsum("nij,nj->ni", turned, marker[:, :3, 3]) + hand[:, :3, 3]
    columns = np.concatenate(
        [hand[:, :3, :3], np.broadcast_to(-np.eye(3), (len(hand), 3, 3))], axis=2
    )
    solved = np.linalg.lstsq(columns.reshape(-1, 6), -known.ravel(), rcond=None)[0]
    first = Rotation.from_matrix(rotation)
    seen = Rotation.from_matrix(turned @ marker[:, :3, :3])
    still = seen[
        int(np.argmin([(seen[i].inv() * seen).magnitude().sum() for i in range(len(seen))]))
    ]

    def left(numbers: Float64Array) -> Float64Array:
        turn = first * Rotation.from_rotvec(numbers[:3])
        place = np.einsum("nij,nj->ni", hand[:, :3, :3] @ turn.as_matrix(), marker[:, :3, 3])
        place += np.einsum("nij,j->ni", hand[:, :3, :3], numbers[3:6]) + hand[:, :3, 3]
        stands = still * Rotation.from_rotvec(numbers[9:])
        found = Rotation.from_matrix(hand[:, :3, :3] @ turn.as_matrix() @ marker[:, :3, :3])
        off = (stands.inv() * found).as_rotvec()
        return np.concatenate([(place - numbers[6:9]).ravel(), _ARM_M * off.ravel()])

    start = np.concatenate([np.zeros(3), solved, np.zeros(3)])
    best = least_squares(left, start, loss="soft_l1", f_scale=_ROBUST_M)
    if not np.isfinite(best.x).all():
        return None
    matrix = np.eye(4)
    matrix[:3, :3] = (first * Rotation.from_rotvec(best.x[:3])).as_matrix()
    matrix[:3, 3] = best.x[3:6]
    return matrix


def _aligned_turns(hand: Float64Array, marker: Float64Array) -> Float64Array | None:
    """Return the rotation that turns the camera's relative rotations into the hand's."""
    from scipy.spatial.transform import Rotation

    first, second = (
        np.array(index) for index in zip(*combinations(range(len(hand)), 2), strict=True)
    )
    turns = hand[second].transpose(0, 2, 1) @ hand[first]
    views = marker[second] @ marker[first].transpose(0, 2, 1)
    wanted = Rotation.from_matrix(turns).as_rotvec()
    given = Rotation.from_matrix(views).as_rotvec()
    weight = np.ones(len(wanted))
    rotation = np.eye(3)
    for _ in range(_ROUNDS):
        u, size, vt = np.linalg.svd((wanted * weight[:, None]).T @ given)
        if size[1] < 1e-9 * max(float(size[0]), 1e-9):
            return None
        rotation = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
        off = np.linalg.norm(wanted - given @ rotation.T, axis=1)
        scale = max(_TO_SIGMA * float(np.median(off)), 1e-6)
        weight = 1.0 / (1.0 + (off / scale) ** 2)
    return np.asarray(rotation, np.float64)


def _unsteadiness(
    T_hand_camera: Float64Array, hand: Float64Array, marker: Float64Array
) -> tuple[float, float]:
    """Return by how much the marker moves in the world: metres, rms, and radians, median.

    The median, because a small marker's orientation has two solutions, and some views take the
    wrong one.
    """
    from scipy.spatial.transform import Rotation

    seen = hand @ T_hand_camera @ marker
    away = seen[:, :3, 3] - seen[:, :3, 3].mean(axis=0)
    rotation = Rotation.from_matrix(seen[:, :3, :3])
    turned = (rotation.mean().inv() * rotation).magnitude()
    return (
        float(np.sqrt(np.mean(np.sum(away**2, axis=1)))),
        float(np.median(turned)),
    )


def _rotvec(rotation: Float64Array) -> Float64Array:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(), np.float64)


def hand_eye_item(found: HandEye) -> CalibrationItem:
    """Make the item of a camera's place on the hand, ``T_<hand>_<camera>``.

    Parameters
    ----------
    found : HandEye
    """
    said = (
        f"{found.views} views of a marker that stands still; it seems to move by "
        f"{1e3 * found.residual_m:.2f} mm and {math.degrees(found.residual_rad):.2f} degrees; "
        f"orientation to {math.degrees(found.sigma_rad):.2f} degrees"
    )
    return _item(found.T_hand_camera, found.sigma_m, found.residual_m, HAND_EYE_METHOD, said)


def chain(steps: Sequence[Mapping[str, Any]]) -> Float64Array:
    """Multiply transforms that are stated as published ones are.

    Parameters
    ----------
    steps : sequence of mapping
        From left to right. Each may have ``translation_m`` (3 numbers), ``euler_xyz_deg`` (3
        numbers: about the fixed axes x, y, z in this order, degrees) and ``inverse``.

    Returns
    -------
    (4, 4) float64

    Raises
    ------
    ValueError
        A step has other keys, or numbers are missing.
    """
    from scipy.spatial.transform import Rotation

    product = np.eye(4)
    for number, step in enumerate(steps):
        odd = set(step) - {"translation_m", "euler_xyz_deg", "inverse", "comment"}
        if odd:
            msg = f"step {number} has {', '.join(sorted(odd))}, which means nothing"
            raise ValueError(msg)
        shift, angles = (
            np.array(step.get(key, (0.0, 0.0, 0.0)), np.float64)
            for key in ("translation_m", "euler_xyz_deg")
        )
        if shift.shape != (3,) or angles.shape != (3,):
            msg = f"step {number} has no three numbers"
            raise ValueError(msg)
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        matrix[:3, 3] = shift
        product = product @ (np.linalg.inv(matrix) if step.get("inverse") is True else matrix)
    return product


def chain_item(document: Mapping[str, Any]) -> tuple[str, CalibrationItem]:
    """Make an item of a document with a chain.

    Parameters
    ----------
    document : mapping
        ``name`` (of the item), ``method`` (who says so), ``steps`` (see `chain`), and perhaps
        ``uncertainty_m``.

    Returns
    -------
    name : str
    item : CalibrationItem

    Raises
    ------
    ValueError
        Something is missing or of another kind.
    """
    try:
        name, method, steps = document["name"], document["method"], document["steps"]
        matrix = chain(steps)
        sigma = document.get("uncertainty_m")
        item = CalibrationItem(
            value=[[round(float(value), 9) for value in row] for row in matrix],
            unit="m",
            uncertainty=None if sigma is None else float(sigma),
            method=str(method),
            procedure=f"product of {len(steps)} published transforms",
        )
    except (KeyError, TypeError, AttributeError) as error:
        msg = f"no chain of transforms ({error!r})"
        raise ValueError(msg) from None
    return str(name), item
