"""The headset's world and ours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from exumi_data.geometry import pose_to_matrix
from exumi_recorders.world_frame import from_headset_world, to_headset_world

Q = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
NUMBER = st.floats(-5, 5, allow_nan=False)


@st.composite
def pose(draw: st.DrawFn) -> np.ndarray:
    quaternion = np.array([draw(st.floats(-1, 1)) for _ in range(4)])
    norm = float(np.linalg.norm(quaternion))
    quaternion = quaternion / norm if norm > 0.1 else np.array([0.0, 0, 0, 1])
    return np.append([draw(NUMBER) for _ in range(3)], quaternion)


def in_words_of_matrices(sent: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R, R_WF = (Rotation.from_quat(each[3:]).as_matrix() for each in (sent, frame))
    return Q @ R_WF.T @ (sent[:3] - frame[:3]), Q @ R_WF.T @ R @ Q.T


@given(pose(), pose())
def test_it_is_the_formula(sent: np.ndarray, frame: np.ndarray) -> None:
    place, turn = in_words_of_matrices(sent, frame)
    found = pose_to_matrix(from_headset_world(sent, frame))
    assert_allclose(found[:3, 3], place, atol=1e-9)
    assert_allclose(found[:3, :3], turn, atol=1e-9)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)


@given(pose(), pose())
def test_there_and_back(sent: np.ndarray, frame: np.ndarray) -> None:
    back = to_headset_world(from_headset_world(sent, frame), frame)
    assert_allclose(back[:3], sent[:3], atol=1e-9)
    assert_allclose(np.abs(back[3:] @ sent[3:]), 1, atol=1e-9)
    again = from_headset_world(back, frame)
    assert_allclose(again[:3], from_headset_world(sent, frame)[:3], atol=1e-9)


@pytest.mark.parametrize(
    ("sent", "place"),
    [((1, 0, 0), (1, 0, 0)), ((0, 1, 0), (0, 0, 1)), ((0, 0, 1), (0, 1, 0))],
    ids=["right is x", "up is z", "forward is y"],
)
def test_axes(sent: tuple[float, ...], place: tuple[float, ...]) -> None:
    assert_allclose(from_headset_world((*sent, 0, 0, 0, 1), REST)[:3], place)


def test_a_turn_to_the_right_is_clockwise_from_above() -> None:
    # Unity: a turn of +90 degrees about y takes forward to the right.
    half = np.sqrt(0.5)
    found = pose_to_matrix(from_headset_world((0, 0, 0, 0, half, 0, half), REST))[:3, :3]
    assert_allclose(found @ (0, 1, 0), (1, 0, 0), atol=1e-12)
    assert_allclose(found, Rotation.from_euler("z", -90, degrees=True).as_matrix(), atol=1e-12)


def test_what_lies_ahead_of_a_turned_frame() -> None:
    half = np.sqrt(0.5)
    frame = (1, 0.8, 2, 0, half, 0, half)  # looks along Unity's x
    assert_allclose(from_headset_world((1.5, 1.0, 2, 0, half, 0, half), frame)[:3], (0, 0.5, 0.2))


def test_signs_stay_continuous() -> None:
    angle = np.linspace(0, 4 * np.pi, 200)
    spin = np.zeros((200, 7))
    spin[:, 4], spin[:, 6] = np.sin(angle / 2), np.cos(angle / 2)
    found = from_headset_world(spin, (0, 1, 0, 0.5, 0.5, 0.5, 0.5))
    assert (np.einsum("ij,ij->i", found[1:, 3:], found[:-1, 3:]) > 0).all()


def test_what_is_no_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        to_headset_world(np.zeros(6), REST)
    with pytest.raises(ValueError, match=r"zero|norm"):
        from_headset_world(np.zeros(7), REST)
