"""Poses against matrix arithmetic and SciPy's own Slerp."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from exumi_data.geometry import (
    axis_angle_to_quaternion,
    compose,
    interpolate_linear,
    interpolate_poses,
    inverse,
    make_sign_continuous,
    matrix_to_pose,
    pose_to_matrix,
    relative,
    rotation_6d,
    rotation_from_6d,
)

Array = npt.NDArray[np.float64]

metres = st.floats(-10, 10)


def _long_enough(vector: Array) -> bool:
    return bool(np.linalg.norm(vector) > 0.1)


quaternion = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(_long_enough)
pose = st.builds(
    lambda xyz, q: np.concatenate((xyz, q)), arrays(np.float64, 3, elements=metres), quaternion
)
poses = st.lists(pose, min_size=1, max_size=8).map(np.stack)


def assert_same_pose(a: Array, b: Array, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(pose_to_matrix(a), pose_to_matrix(b), atol=tolerance)


# ------------------------------------------------------------------------------ matrices, chaining


@given(poses)
def test_matrices_and_back(p: Array) -> None:
    matrix = pose_to_matrix(p)
    assert matrix.shape == (len(p), 4, 4)
    back = matrix_to_pose(matrix)
    assert_same_pose(back, p)
    np.testing.assert_allclose(np.linalg.norm(back[:, 3:], axis=1), 1)
    assert (back[:, 6] >= 0).all()


@given(pose, pose)
def test_compose_is_the_matrix_product(a: Array, b: Array) -> None:
    np.testing.assert_allclose(
        pose_to_matrix(compose(a, b)), pose_to_matrix(a) @ pose_to_matrix(b), atol=1e-9
    )


@given(pose)
def test_inverse_is_the_matrix_inverse(p: Array) -> None:
    np.testing.assert_allclose(
        pose_to_matrix(inverse(p)), np.linalg.inv(pose_to_matrix(p)), atol=1e-9
    )


@given(pose, pose)
def test_relative_leads_back(base: Array, p: Array) -> None:
    assert_same_pose(compose(base, relative(base, p)), p)
    assert_same_pose(relative(p, p), np.array([0, 0, 0, 0, 0, 0, 1.0]))


def test_a_known_pose() -> None:
    quarter_turn_about_z = [1.0, 2.0, 3.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    moved = compose(quarter_turn_about_z, [1.0, 0, 0, 0, 0, 0, 1])
    np.testing.assert_allclose(moved[:3], [1, 3, 3], atol=1e-12)


def test_leading_axes_are_kept_and_broadcast() -> None:
    rng = np.random.default_rng(0)
    p = rng.normal(size=(2, 3, 7))
    assert pose_to_matrix(p).shape == (2, 3, 4, 4)
    assert matrix_to_pose(pose_to_matrix(p)).shape == (2, 3, 7)
    assert inverse(p).shape == (2, 3, 7)
    got = relative(p[:, :1], p)
    assert got.shape == (2, 3, 7)
    for i in range(2):
        for j in range(3):
            np.testing.assert_allclose(got[i, j], relative(p[i, 0], p[i, j]), atol=1e-12)
    assert pose_to_matrix(p[0, 0]).shape == (4, 4)
    np.testing.assert_allclose(compose(p[0, 0], p[1])[2], compose(p[0, 0], p[1, 2]))
    assert compose(np.empty((0, 7)), p[0, 0]).shape == (0, 7)


def test_read_only_input_is_fine() -> None:
    p = np.random.default_rng(0).normal(size=(3, 7))
    p.setflags(write=False)
    matrices = pose_to_matrix(p)
    matrices.setflags(write=False)
    assert_same_pose(matrix_to_pose(matrices), p)
    assert_same_pose(compose(p, inverse(p)), np.tile([0.0, 0, 0, 0, 0, 0, 1], (3, 1)))
    six = rotation_6d(p[:, 3:])
    six.setflags(write=False)
    np.testing.assert_allclose(rotation_6d(rotation_from_6d(six)), six)
    assert axis_angle_to_quaternion(p[:, :3]).shape == (3, 4)
    assert interpolate_poses([0, 1, 2], p, [1], 1)[1].all()


def test_bad_matrices_and_poses_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(\.\.\., 7\)"):
        pose_to_matrix(np.zeros((2, 6)))
    with pytest.raises(ValueError, match="zero norm"):
        inverse(np.zeros(7))
    with pytest.raises(ValueError, match=r"\(\.\.\., 4, 4\)"):
        matrix_to_pose(np.eye(3))
    with pytest.raises(ValueError, match="last row"):
        matrix_to_pose(np.eye(4) * 2)
    with pytest.raises(ValueError, match="positive determinant"):
        matrix_to_pose(np.diag([1.0, 1, -1, 1]))


# ---------------------------------------------------------------------------------- 6-D, axis-angle


@given(quaternion)
def test_6d_is_the_first_two_rows(q: Array) -> None:
    matrix = Rotation.from_quat(q).as_matrix()
    six = rotation_6d(q)
    np.testing.assert_allclose(six, [*matrix[0], *matrix[1]], atol=1e-12)
    np.testing.assert_allclose(
        Rotation.from_quat(rotation_from_6d(six)).as_matrix(), matrix, atol=1e-9
    )


def test_6d_tells_rows_from_columns() -> None:
    quarter_turn_about_z = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    np.testing.assert_allclose(rotation_6d(quarter_turn_about_z), [0, -1, 0, 1, 0, 0], atol=1e-12)


@given(quaternion, st.floats(0.1, 10), st.floats(0.1, 10), st.floats(-3, 3))
def test_6d_is_made_orthogonal(q: Array, a: float, b: float, mix: float) -> None:
    rows = Rotation.from_quat(q).as_matrix()[:2]
    six = np.concatenate((a * rows[0], b * rows[1] + mix * rows[0]))
    np.testing.assert_allclose(rotation_6d(rotation_from_6d(six)), rows.ravel(), atol=1e-9)


def test_6d_shapes_and_degenerate_rows() -> None:
    assert rotation_6d(np.tile([0.0, 0, 0, 1], (2, 5, 1))).shape == (2, 5, 6)
    assert rotation_from_6d(np.tile([1.0, 0, 0, 0, 1, 0], (2, 5, 1))).shape == (2, 5, 4)
    with pytest.raises(ValueError, match="parallel"):
        rotation_from_6d([1.0, 0, 0, 2, 0, 0])
    with pytest.raises(ValueError, match=r"\(\.\.\., 6\)"):
        rotation_from_6d(np.zeros(9))
    with pytest.raises(ValueError, match=r"\(\.\.\., 4\)"):
        rotation_6d(np.zeros((3, 3)))


@given(arrays(np.float64, (3, 3), elements=st.floats(-6, 6)))
def test_axis_angle(vectors: Array) -> None:
    got = axis_angle_to_quaternion(vectors)
    assert got.shape == (3, 4)
    assert (got[:, 3] >= 0).all()
    np.testing.assert_allclose(
        Rotation.from_quat(got).as_matrix(), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-9
    )
    with pytest.raises(ValueError, match=r"\(\.\.\., 3\)"):
        axis_angle_to_quaternion(np.zeros(4))


# -------------------------------------------------------------------------------------------- signs


@given(st.lists(quaternion, min_size=1, max_size=12).map(np.stack))
def test_signs_are_continuous_and_rotations_unchanged(q: Array) -> None:
    got = make_sign_continuous(q)
    np.testing.assert_array_equal(got[0], q[0])
    assert ((got == q) | (got == -q)).all()
    assert (np.einsum("ij,ij->i", got[1:], got[:-1]) >= 0).all()


def test_signs_of_nothing_and_of_a_wrong_shape() -> None:
    assert make_sign_continuous(np.empty((0, 4))).shape == (0, 4)
    with pytest.raises(ValueError, match=r"\(N, 4\)"):
        make_sign_continuous(np.zeros((2, 3)))


# ------------------------------------------------------------------------------------ interpolation


def _smooth_motion(n: int, seed: int) -> tuple[npt.NDArray[np.int64], Array]:
    """Poses of a hand that turns and jumps in sign, at irregular times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.integers(5_000_000, 15_000_000, n))
    turns = np.cumsum(rng.normal(0, 0.2, (n, 3)), axis=0)
    quaternions = Rotation.from_rotvec(turns).as_quat() * rng.choice([-1.0, 1.0], (n, 1))
    return times, np.hstack((np.cumsum(rng.normal(0, 0.01, (n, 3)), axis=0), quaternions))


@given(n=st.integers(2, 40), seed=st.integers(0, 2**32 - 1))
def test_poses_agree_with_scipy(n: int, seed: int) -> None:
    times, samples = _smooth_motion(n, seed)
    ticks = np.linspace(times[0], times[-1], 57).astype(np.int64)
    got, valid = interpolate_poses(times, samples, ticks, 10**9)
    assert valid.all()
    expected = Slerp(times.astype(float), Rotation.from_quat(samples[:, 3:]))(ticks.astype(float))
    np.testing.assert_allclose(
        Rotation.from_quat(got[:, 3:]).as_matrix(), expected.as_matrix(), atol=1e-7
    )
    for axis in range(3):
        np.testing.assert_allclose(got[:, axis], np.interp(ticks, times, samples[:, axis]))
    assert (np.einsum("ij,ij->i", got[1:, 3:], got[:-1, 3:]) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(got[:, 3:], axis=1), 1)


def test_the_shorter_arc_is_taken() -> None:
    turn = Rotation.from_rotvec([[0, 0, 0], [0, 0, 0.2]]).as_quat() * [[1], [-1]]
    samples = np.hstack((np.zeros((2, 3)), turn))
    got, _ = interpolate_poses([0, 100], samples, [50], 100)
    np.testing.assert_allclose(Rotation.from_quat(got[0, 3:]).magnitude(), 0.1)


@given(seed=st.integers(0, 2**32 - 1), ticks=st.lists(st.integers(-10, 200), max_size=20))
def test_what_is_not_measured_holds_the_nearest_sample(seed: int, ticks: list[int]) -> None:
    rng = np.random.default_rng(seed)
    times = np.array([0, 10, 20, 100, 110])
    samples = np.hstack((rng.normal(size=(5, 3)), rng.normal(size=(5, 4))))
    got, valid = interpolate_poses(times, samples, ticks, 15)
    values, also_valid = interpolate_linear(times, samples[:, 0], ticks, 15)
    assert valid.tolist() == also_valid.tolist()
    np.testing.assert_array_equal(values, got[:, 0])
    assert np.isfinite(got).all()
    for tick, p, good in zip(ticks, got, valid.tolist(), strict=True):
        assert good == (0 <= tick <= 20 or 100 <= tick <= 110)
        if not good:
            nearest = samples[np.abs(times - tick).argmin()]
            assert_same_pose(p, nearest, 1e-12)


@given(
    values=st.one_of(
        arrays(np.float32, (6,), elements=st.floats(-1e6, 1e6, width=32)),
        arrays(np.float64, (6, 3), elements=st.floats(-1e6, 1e6)),
        arrays(np.int64, (6, 2), elements=st.integers(-(10**6), 10**6)),
    )
)
def test_linear_is_numpys(values: npt.NDArray[np.float64]) -> None:
    times = np.array([0, 3, 7, 20, 21, 40])
    ticks = np.arange(41)
    got, valid = interpolate_linear(times, values, ticks, 100)
    assert valid.all()
    assert got.dtype == np.float64
    assert got.shape == (41, *values.shape[1:])
    columns = values.reshape(6, -1).T
    expected = np.stack([np.interp(ticks, times, column) for column in columns], axis=1)
    np.testing.assert_allclose(got.reshape(41, -1), expected, atol=1e-9)
    np.testing.assert_array_equal(got[times], values)


def test_one_sample_is_valid_only_at_its_own_time() -> None:
    got, valid = interpolate_linear([5], [2.5], [4, 5, 6], 10)
    assert got.tolist() == [2.5, 2.5, 2.5]
    assert valid.tolist() == [False, True, False]


def test_interpolation_refuses_what_it_cannot_do() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        interpolate_linear([0, 1], [1.0], [0], 1)
    with pytest.raises(ValueError, match="sample 1 is not finite"):
        interpolate_linear([0, 1], [1.0, np.nan], [0], 1)
    with pytest.raises(ValueError, match="without samples"):
        interpolate_linear([], np.empty(0), [0], 1)
    with pytest.raises(ValueError, match="must be of shape"):
        interpolate_linear([0], np.zeros((1, 1, 1)), [0], 1)
    with pytest.raises(ValueError, match="zero"):
        interpolate_poses([0, 1], np.zeros((2, 7)), [0], 1)
    with pytest.raises(ValueError, match="do not fit"):
        interpolate_poses([0, 1], np.zeros(7), [0], 1)


def test_products_of_quaternions_are_those_of_scipy() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 500, 7))
    expected = Rotation.from_quat(a[:, 3:]) * Rotation.from_quat(b[:, 3:])
    np.testing.assert_allclose(compose(a, b)[:, 3:], expected.as_quat(), rtol=0, atol=4e-16)
