"""How late poses are against a gyroscope, by how far both turn."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from exumi_data.clips.gpmf import GyroTrack
from exumi_data.simulation.demonstrations import Demonstrations, simulate_demonstrations
from exumi_data.synchronisation.turns import search_turns


@pytest.fixture(scope="module")
def hand() -> Demonstrations:
    return simulate_demonstrations(2, seed=4, seconds=6.0)


def measured(
    hand: Demonstrations, late_s: float, *, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, GyroTrack]:
    """Poses of 30 a second with a tracker's noise, and a gyroscope that is mounted somehow."""
    rng = np.random.default_rng(seed)
    start, stop = hand.spans_s[0]
    at = np.arange(start - 1.0, stop + 1.0, 1 / 30)
    at += rng.normal(0, 5e-4, len(at))
    poses = hand.pose(at)
    noise = Rotation.from_rotvec(rng.normal(0, 8e-4, (len(at), 3)))
    poses[:, 3:] = (Rotation.from_quat(poses[:, 3:]) * noise).as_quat()
    clip_s = np.arange(0.0, stop - start, 1 / 200)
    turned = Rotation.from_euler("xyz", (31, -12, 97), degrees=True).apply(
        hand.rad_per_s(start + clip_s)
    )
    turned += np.array([0.02, -0.01, 0.015]) + rng.normal(0, 0.01, turned.shape)
    time_ns = np.rint((at - start + late_s) * 1e9).astype(np.int64)
    return time_ns, poses, GyroTrack(clip_s, turned, 0.0)


@pytest.mark.parametrize("late_s", [-0.021, 0.0, 0.0043, 0.024])
def test_the_lag_is_found_to_a_fraction_of_a_millisecond(
    hand: Demonstrations, late_s: float
) -> None:
    found = search_turns(*measured(hand, late_s), offset_ns=0)
    assert found is not None
    assert found.sigma_s < 1e-3
    assert abs(found.offset_s - late_s) < max(4 * found.sigma_s, 5e-4)


def test_what_it_claims_holds(hand: Demonstrations) -> None:
    away = []
    for seed in range(12):
        found = search_turns(*measured(hand, 0.0, seed=seed), offset_ns=0)
        assert found is not None
        away.append(found.offset_s / found.sigma_s)
    assert 0.4 < np.sqrt(np.mean(np.square(away))) < 2.5


def test_it_says_nothing_where_nothing_turns(hand: Demonstrations) -> None:
    time_ns, poses, gyro = measured(hand, 0.0)
    still = poses.copy()
    still[:, 3:] = poses[0, 3:]
    assert search_turns(time_ns, still, gyro, offset_ns=0) is None
    assert search_turns(time_ns[:40], poses[:40], gyro, offset_ns=0) is None


def test_it_says_nothing_of_another_motion(hand: Demonstrations) -> None:
    time_ns, poses, _ = measured(hand, 0.0)
    other = simulate_demonstrations(2, seed=99, seconds=6.0)
    _, _, gyro = measured(other, 0.0)
    assert search_turns(time_ns, poses, gyro, offset_ns=0) is None
