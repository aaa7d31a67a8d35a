"""Where tool and camera are on the hand: found in spite of noise, refused without turns."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.geometry import pose_to_matrix
from exumi_recorders.calibration.controller import (
    aligned,
    chain,
    chain_item,
    hand_eye,
    hand_eye_item,
    pivot,
    tcp_item,
)

TIP = np.array([0.02, -0.05, 0.18])
POINT = np.array([0.3, 0.1, 0.8])
COUNT = 400


def turns(size: float = 0.5, axes: tuple[float, float, float] = (1.0, 1.0, 0.6)) -> Rotation:
    time = np.linspace(0, 20, COUNT)
    waves = np.stack([np.sin(time), np.sin(0.7 * time + 1), np.sin(0.4 * time)], axis=1)
    return Rotation.from_rotvec(size * waves * axes)


def pivoting(seed: int = 0, noise_m: float = 5e-4, **how: object) -> np.ndarray:
    rng, rotation = np.random.default_rng(seed), turns(**how)  # type: ignore[arg-type]  # as turns has them
    position = POINT - rotation.apply(TIP) + noise_m * rng.standard_normal((COUNT, 3))
    noisy = rotation * Rotation.from_rotvec(2e-3 * rng.standard_normal((COUNT, 3)))
    return np.hstack([position, noisy.as_quat()])


def test_the_tip_and_its_uncertainty() -> None:
    found = [pivot(pivoting(seed)) for seed in range(12)]
    off = np.array([np.linalg.norm(one.tip_m - TIP) for one in found])
    sigma = np.array([one.sigma_m for one in found])
    assert off.max() < 5e-4
    assert 0.5 < float(np.sqrt(np.mean((off / sigma) ** 2))) < 1.6
    assert np.linalg.norm(found[0].point_m - POINT) < 5e-4
    assert 5e-4 < found[0].residual_m < 2e-3


def test_slips_do_little_harm() -> None:
    poses = pivoting()
    poses[100:110, :3] += 0.03
    found = pivot(poses)
    assert found.poses < COUNT
    assert np.linalg.norm(found.tip_m - TIP) < 5e-4


@pytest.mark.parametrize(
    ("poses", "said"),
    [
        (pivoting()[:10], "10 poses"),
        (pivoting(axes=(1.0, 0.02, 0.02)), "about its second axis"),
        (pivoting(size=0.05), "about its second axis"),
        (pivoting(noise_m=0.01), "off the point"),
    ],
)
def test_what_is_no_pivot(poses: np.ndarray, said: str) -> None:
    with pytest.raises(CalibrationRefusedError, match=said):
        pivot(poses)


def test_the_orientation_in_a_jig() -> None:
    rng = np.random.default_rng(3)
    true = Rotation.from_euler("xyz", [10, -20, 90], degrees=True)
    tool = Rotation.from_euler("z", 30, degrees=True)
    controller = tool * true.inv() * Rotation.from_rotvec(3e-3 * rng.standard_normal((100, 3)))
    poses = np.hstack([np.zeros((100, 3)), controller.as_quat()])
    found = aligned(poses, tool.as_quat().tolist())
    assert np.abs(found.rotation - true.as_matrix()).max() < 2e-3
    assert found.residual_rad == pytest.approx(3e-3 * math.sqrt(3), rel=0.2)
    item = tcp_item(pivot(pivoting()), found)
    assert np.abs(np.array(item.value)[:3, :3] - true.as_matrix()).max() < 2e-3
    assert np.array(item.value)[:3, 3] == pytest.approx(TIP, abs=5e-4)
    assert item.unit == "m"
    assert "not measured" in (tcp_item(pivot(pivoting()), None).procedure or "")
    with pytest.raises(CalibrationRefusedError, match="in its jig"):
        aligned(pivoting())


def views(seed: int = 0, **how: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hand poses, marker poses, and the camera's place. One view in ten is flipped."""
    rng, time = np.random.default_rng(seed), np.linspace(0, 20, COUNT)
    hand = np.tile(np.eye(4), (COUNT, 1, 1))
    hand[:, :3, :3] = turns(**how).as_matrix()  # type: ignore[arg-type]  # as turns has them
    hand[:, :3, 3] = np.stack([0.1 * np.sin(time), 0.1 * np.cos(0.6 * time), 0.5 + 0 * time], 1)
    place = pose_to_matrix([0.03, 0.06, -0.02, *Rotation.from_euler("y", 80, True).as_quat()])
    world = pose_to_matrix([0.3, 0.1, 0.0, 0.0, 0.0, 0.0, 1.0])
    marker = np.linalg.inv(hand @ place) @ world
    marker[:, :3, 3] += 1e-3 * rng.standard_normal((COUNT, 3))
    off = Rotation.from_rotvec(0.01 * rng.standard_normal((COUNT, 3))).as_matrix()
    flipped = rng.random(COUNT) < 0.1
    off[flipped] = off[flipped] @ Rotation.from_euler("x", 40, True).as_matrix()
    marker[:, :3, :3] = marker[:, :3, :3] @ off
    return hand, marker, place


def test_hand_and_eye() -> None:
    hand, marker, place = views()
    found = hand_eye(hand, marker)
    off_m = float(np.linalg.norm(found.T_hand_camera[:3, 3] - place[:3, 3]))
    assert off_m < min(3e-3, 4 * found.sigma_m)
    assert np.abs(found.T_hand_camera[:3, :3] - place[:3, :3]).max() < 4e-3
    assert found.residual_m < 4e-3
    item = hand_eye_item(found)
    assert item.uncertainty == pytest.approx(found.sigma_m, abs=1e-6)
    assert np.array(item.value).shape == (4, 4)


def test_hand_and_eye_without_turns_or_of_two_scenes() -> None:
    hand, marker, _ = views(axes=(1.0, 0.0, 0.0))
    with pytest.raises(CalibrationRefusedError, match="about its second axis"):
        hand_eye(hand, marker)
    with pytest.raises(CalibrationRefusedError, match="different views"):
        hand_eye(hand[:30], marker[:30])
    hand, marker, _ = (part[::8] if part.ndim == 3 else part for part in views())
    with pytest.raises(CalibrationRefusedError, match="seems to move"):
        hand_eye(hand, marker[::-1])


def test_a_chain() -> None:
    steps: list[dict[str, Any]] = [
        {"translation_m": [1, 0, 0], "euler_xyz_deg": [0, 0, 90], "inverse": True},
        {"euler_xyz_deg": [0, 0, 90]},
        {"translation_m": [0, 0, 0.1]},
    ]
    assert chain(steps) == pytest.approx(
        np.array([[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 0.1], [0, 0, 0, 1]])
    )
    name, item = chain_item({"name": "T_controller_tcp", "method": "published", "steps": steps})
    assert (name, item.unit, item.method) == ("T_controller_tcp", "m", "published")
    wrongs: list[dict[str, Any]] = [{"rotation": [0, 0, 1]}, {"translation_m": [1, 2]}]
    for wrong in wrongs:
        with pytest.raises(ValueError, match="step 0 has"):
            chain([wrong])
    with pytest.raises(ValueError, match="no chain of transforms"):
        chain_item({"name": "x"})
