"""What a simulated headset sends."""

from collections import Counter

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from exumi_data.geometry import compose
from exumi_data.simulation import Truth
from exumi_recorders.drivers.quest_dialects import Command, Frame, Message, Poses, Rejected, parse
from exumi_recorders.simulated.headset_messages import number
from exumi_recorders.simulated.headset_options import (
    HeadsetFaults,
    HeadsetOptions,
    SimulatedSession,
)
from exumi_recorders.simulated.headset_plan import Planned, plan
from exumi_recorders.simulated.headset_poses import (
    T_controller_tcp,
    app_offset,
    session_truth,
    track,
    unity_quaternion,
)
from exumi_recorders.world_frame import from_headset_world

EXACT = {"noise_m": 0.0, "noise_rad": 0.0}


@pytest.fixture(scope="module")
def truth() -> Truth:
    return session_truth(SimulatedSession(duration_s=3))


def messages(planned: list[Planned]) -> list[Message | Rejected]:
    return [parse(each.data) for each in planned]


@pytest.mark.parametrize("dialect", ["a", "b", "c", "d"])
@pytest.mark.parametrize("hand", ["left", "right", "both"])
def test_all_of_it_can_be_parsed(dialect: str, hand: str, truth: Truth) -> None:
    options = HeadsetOptions.model_validate(
        {"dialect": dialect, "hand": hand, "duration_s": 1, "toggles_s": (0.3, 0.6)}
    )
    found = messages(plan(options, truth))
    assert not [each for each in found if isinstance(each, Rejected)]
    poses = [each for each in found if isinstance(each, Poses)]
    assert {dialect}.issubset(poses[0].dialects)
    assert Counter(each.flag for each in poses) == {True: 22, False: 50}
    assert sum(isinstance(each, Frame) for each in found) == 1
    commands = [each.name for each in found if isinstance(each, Command)]
    wanted = ["stop"] * 22 + ["start"] + ["stop"] * 28 if dialect == "a" else []
    assert commands == wanted


def test_it_is_the_same_again(truth: Truth) -> None:
    faults = HeadsetFaults(lost=0.1, late=0.1, twice=0.1)
    options = HeadsetOptions(duration_s=1, faults=faults)
    assert plan(options, truth) == plan(options, truth)
    assert plan(options, truth) != plan(options.model_copy(update={"seed": 1}), truth)


def test_faults_are_as_frequent_as_they_should_be(truth: Truth) -> None:
    faults = HeadsetFaults(lost=0.2, late=0.1, twice=0.05)
    found = plan(HeadsetOptions(duration_s=60, rate_hz=90, faults=faults), truth)
    came = [each for each in found if each.pose_ns is not None]
    counts = Counter(each.index for each in came)
    assert len(counts) / 5400 == pytest.approx(0.8, abs=0.02)
    assert sum(n == 2 for n in counts.values()) / len(counts) == pytest.approx(0.05, abs=0.01)
    behind = np.array([each.send_ns for each in came]) - [each.index * 10**9 // 90 for each in came]
    assert (behind >= 10**9 // 90).mean() == pytest.approx(0.12, abs=0.03)
    assert [each.send_ns for each in found] == sorted(each.send_ns for each in found)


def test_the_world_frame_is_repeated_in_dialect_d_alone(truth: Truth) -> None:
    for dialect, times in (("b", [1.5]), ("d", [1.5, 2.5, 3.5])):
        options = HeadsetOptions.model_validate(
            {"dialect": dialect, "duration_s": 4, "world_frame_at_s": 1.5}
        )
        found = [each.send_ns for each in plan(options, truth) if b"WF" in each.data]
        assert_allclose(np.array(found) * 1e-9, times, atol=1 / 72)


def test_a_pose_is_as_old_as_the_lag(truth: Truth) -> None:
    options = HeadsetOptions.model_validate({"lag_s": 0.02, **EXACT})
    time_s = np.linspace(0.5, 2.5, 50)
    found = from_headset_world(track(options, truth, time_s).hand, options.world_frame)
    assert_allclose(found[:, :3], truth.pose(time_s - 0.02)[:, :3], atol=1e-9)


def test_what_the_app_adds_is_undone_by_the_calibration(truth: Truth) -> None:
    mount = (0.01, 0.05, -0.08, *Rotation.from_euler("xyz", (20, -10, 5), degrees=True).as_quat())
    options = HeadsetOptions.model_validate({"mount": mount, "lag_s": 0, **EXACT})
    time_s = np.linspace(0.5, 2.5, 50)
    sent = from_headset_world(track(options, truth, time_s).hand, options.world_frame)
    assert np.linalg.norm(sent[:, :3] - truth.pose(time_s)[:, :3], axis=1).min() > 0.03
    found = compose(sent, T_controller_tcp(options))
    expected = truth.pose(time_s)
    assert_allclose(found[:, :3], expected[:, :3], atol=1e-9)
    assert_allclose(np.abs(np.einsum("ij,ij->i", found[:, 3:], expected[:, 3:])), 1, atol=1e-12)


def test_angles_turn_as_in_unity() -> None:
    right = Rotation.from_quat(unity_quaternion(0, 90, 0)).apply((0, 0, 1))
    assert_allclose(right, (1, 0, 0), atol=1e-12)  # a turn about y takes forward to the right
    down = Rotation.from_quat(unity_quaternion(90, 0, 0)).apply((0, 0, 1))
    assert_allclose(down, (0, -1, 0), atol=1e-12)  # about x: nose down
    both = Rotation.from_quat(unity_quaternion(90, 0, 90)).apply((1, 0, 0))
    assert_allclose(both, (0, 0, 1), atol=1e-12)  # z before x: right, up, forward
    assert_allclose(app_offset()[:3], (-0.1, -0.04, -0.07))


def test_frozen_poses_are_the_same_to_the_last_digit(truth: Truth) -> None:
    faults = HeadsetFaults(freeze_at_s=0.5, freeze_s=0.5)
    options = HeadsetOptions(dialect="c", duration_s=1.5, world_frame_at_s=None, faults=faults)
    found = [each.data for each in plan(options, truth)]
    assert len(set(found[36:72])) == 1
    assert len(set(found)) == 108 - 35


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"),
        (-1.0, "-1"),
        (1e-5, "1E-05"),
        (123.45678, "123.4568"),
        (0.00012345678, "0.0001234568"),
    ],
)
def test_numbers_are_written_as_in_c_sharp(value: float, text: str) -> None:
    assert number(value) == text
    assert number(value, decimal_comma=True) == text.replace(".", ",")
