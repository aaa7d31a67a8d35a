"""The truth of a play session: smooth, consistent, and evaluable anywhere."""

from typing import cast

import numpy as np
import pytest

from exumi_data.simulation import OBJECTS, Finger, Truth, simulate_play
from exumi_data.simulation.motion import Float64Array, minimum_jerk, minimum_jerk_inverse

DURATION_S = 25.0


@pytest.fixture(scope="module")
def truth() -> Truth:
    return simulate_play(seed=5, duration_s=DURATION_S, tactile_size=(48, 64)).truth


@pytest.fixture(scope="module")
def times() -> Float64Array:
    return np.linspace(0.0, DURATION_S, 25_001)


def test_minimum_jerk_inverse_undoes_minimum_jerk() -> None:
    for progress in (0.0, 1e-3, 0.2, 0.5, 0.9, 1.0):
        assert minimum_jerk(minimum_jerk_inverse(progress)) == pytest.approx(progress, abs=1e-9)
    with pytest.raises(ValueError, match="must lie in"):
        minimum_jerk_inverse(1.5)


def test_pose_is_smooth_and_its_quaternion_unit_and_continuous_in_sign(
    truth: Truth, times: Float64Array
) -> None:
    pose = truth.pose(times)
    step_s = times[1] - times[0]
    speed = np.linalg.norm(np.diff(pose[:, :3], axis=0), axis=1) / step_s
    acceleration = np.linalg.norm(np.diff(pose[:, :3], n=2, axis=0), axis=1) / step_s**2
    turning = 2 * np.linalg.norm(np.diff(pose[:, 3:], axis=0), axis=1) / step_s

    np.testing.assert_allclose(np.linalg.norm(pose[:, 3:], axis=1), 1.0, atol=1e-12)
    assert 0.2 < speed.max() < 1.0  # it moves, as a hand does
    assert acceleration.max() < 10.0
    assert 0.3 < turning.max() < 4.0  # a flipped sign would read as 2000 rad/s


def test_pose_does_not_depend_on_how_it_is_sampled(truth: Truth, times: Float64Array) -> None:
    chosen = np.array([17_003, 4, 9_999, 24_000])
    one_by_one = np.concatenate([truth.pose(t) for t in times[chosen]])
    np.testing.assert_allclose(one_by_one, truth.pose(times)[chosen], atol=1e-12)


def test_every_grasp_touches_its_object_and_grasps_follow_each_other(truth: Truth) -> None:
    assert [grasp.object_name for grasp in truth.grasps] == [item.name for item in OBJECTS]
    for grasp in truth.grasps:
        assert grasp.t_start_s < grasp.t_contact_s < grasp.t_release_s < grasp.t_end_s
        assert grasp.t_release_s - grasp.t_contact_s > 1.0
    starts = [grasp.t_start_s for grasp in truth.grasps[1:]]
    assert starts == [grasp.t_end_s for grasp in truth.grasps[:-1]]


def test_width_is_the_objects_width_at_contact_and_release(truth: Truth) -> None:
    for grasp in truth.grasps:
        edges = truth.width_m([grasp.t_contact_s, grasp.t_release_s])
        np.testing.assert_allclose(edges, grasp.object_width_m, atol=1e-9)


def test_width_and_indentations_add_up_to_the_objects_width_during_contact(
    truth: Truth, times: Float64Array
) -> None:
    touching = truth.in_contact(times)
    depth = [truth.contact_depth_m("left", times), truth.contact_depth_m("right", times)]
    widths = np.array([item.width_m for item in truth.objects])
    held = widths[truth.object_index(times)[touching]]

    assert 0.3 < touching.mean() < 0.7
    total = truth.width_m(times) + depth[0] + depth[1]
    np.testing.assert_allclose(total[touching], held, atol=1e-12)
    for one in depth:
        assert (one[touching] >= 0).all()
        assert (one[~touching] == 0).all()
        assert 0.4e-3 < one.max() < 2.0e-3


def test_contact_lasts_exactly_from_contact_to_release(truth: Truth, times: Float64Array) -> None:
    expected = np.zeros(len(times), dtype=bool)
    for grasp in truth.grasps:
        expected |= (times > grasp.t_contact_s) & (times < grasp.t_release_s)
    np.testing.assert_array_equal(truth.in_contact(times), expected)
    assert truth.object_name(truth.grasps[1].t_contact_s - 0.01) == (None,)
    assert truth.object_name(truth.grasps[1].t_contact_s + 0.01) == (OBJECTS[1].name,)


def test_closing_speed_kinks_at_contact(truth: Truth) -> None:
    for grasp in truth.grasps:
        t = grasp.t_contact_s + np.array([-2e-4, -1e-4, 1e-4, 2e-4])
        before, _, after = np.diff(truth.width_m(t)) / np.diff(t)
        assert after / before == pytest.approx(truth.gel.give, rel=0.02)


def test_both_fingers_see_the_same_object_mirrored(truth: Truth, times: Float64Array) -> None:
    left, right = truth.contact_pose("left", times), truth.contact_pose("right", times)
    touching = truth.in_contact(times)
    np.testing.assert_allclose(left[touching], right[touching] * [-1, 1, -1])
    assert np.isnan(left[~touching]).all()


def test_objects_slide_and_turn_while_they_are_held(truth: Truth) -> None:
    for grasp in truth.grasps:
        t = np.linspace(grasp.t_contact_s + 1e-3, grasp.t_release_s - 1e-3, 200)
        contact = truth.contact_pose("left", t)
        assert np.ptp(contact[:, 2]) > 0.03
        assert np.ptp(contact[:, 0]) > 0.2e-3
        shear = truth.skin_shear("left", t)
        np.testing.assert_allclose(shear[0], 0.0, atol=1e-6)
        assert np.hypot(shear[:, 0], shear[:, 1]).max() < 0.7e-3


def test_objects_never_jump_and_move_only_in_the_hand(truth: Truth, times: Float64Array) -> None:
    for index, item in enumerate(truth.objects):
        place = truth.object_pose(index, times)[:, :3]
        step = np.linalg.norm(np.diff(place, axis=0), axis=1)
        held = truth.object_index(times) == index
        assert step.max() < 1.5e-3  # in 1 ms: no jump at contact or release
        assert (step[~held[1:] & ~held[:-1]] == 0).all()
        np.testing.assert_allclose(place[~held, 2], item.rest_height_m, atol=1e-9)
        assert place[held, 2].max() > item.rest_height_m + 0.04


def test_unknown_finger_is_refused(truth: Truth) -> None:
    with pytest.raises(ValueError, match="Supported values are left, right"):
        truth.contact_depth_m(cast("Finger", "thumb"), 1.0)


@pytest.fixture(scope="module")
def tapping() -> Truth:
    return simulate_play(seed=5, duration_s=DURATION_S, tactile_size=(48, 64), taps=4).truth


def test_a_tapping_hand_closes_and_opens_before_it_grasps(tapping: Truth) -> None:
    contacts = []
    for grasp in tapping.grasps:
        times = np.arange(grasp.t_start_s, grasp.t_end_s, 0.01)
        touching = tapping.in_contact(times)
        began = times[1:][~touching[:-1] & touching[1:]]
        assert began[0] == pytest.approx(grasp.t_contact_s, abs=0.02)
        contacts.append(len(began))
        # While it taps, the hand trembles but stays, and nothing is lifted.
        tapped = times[(times >= began[0]) & (times < began[-1])]
        place = tapping.pose(tapped)[:, :3]
        assert np.ptp(place, axis=0).max(initial=0.0) < 2e-3
        resting = tapping.object_pose(grasp.object_index, tapped)[:, 2]
        height = tapping.objects[grasp.object_index].rest_height_m
        assert np.abs(resting - height).max(initial=0.0) < 2e-3
    assert max(contacts) > 2


def test_a_hand_taps_only_where_it_is_asked_to(truth: Truth, tapping: Truth) -> None:
    assert len(tapping.grasps) < len(truth.grasps)
    again = simulate_play(seed=5, duration_s=DURATION_S, tactile_size=(48, 64), taps=0).truth
    assert again.grasps == truth.grasps
    with pytest.raises(ValueError, match="taps"):
        simulate_play(taps=-1)
