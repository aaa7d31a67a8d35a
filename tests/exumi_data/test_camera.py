"""Intrinsics and undistorted frames, against OpenCV and against what a pinhole would see."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from exumi_data.camera import Undistorter, from_open_camera_calibrator, matrix, pinhole, resized
from exumi_data.model.calibration import Intrinsics

FISHEYE = Intrinsics(
    model="fisheye",
    width=320,
    height=240,
    fx=100.0,
    fy=101.0,
    cx=158.0,
    cy=121.0,
    distortion=[-0.02, -0.019, 0.0017, -0.0002],
)
NARROW = Intrinsics(
    model="pinhole",
    width=320,
    height=240,
    fx=300.0,
    fy=310.0,
    cx=161.0,
    cy=117.0,
    distortion=[-0.2, 0.05, 0.001, -0.002, 0.01],
)


def board(directions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """What is seen in some directions (..., 2): a chequered wall at distance 1."""
    cells = np.floor(directions * 3 + 0.25).sum(axis=-1)
    return np.where(cells % 2, 210.0, 40.0)


def seen_by(camera: Intrinsics, *, fine: int = 3) -> npt.NDArray[np.uint8]:
    """The wall through a lens: each pixel the mean of `fine` by `fine` directions."""
    y, x = (np.mgrid[: camera.height * fine, : camera.width * fine] + 0.5) / fine - 0.5
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    lens = matrix(camera), np.array(camera.distortion)
    undo = cv2.fisheye.undistortPoints if camera.model == "fisheye" else cv2.undistortPoints
    seen = board(np.asarray(undo(pixels, *lens), np.float64).reshape(*y.shape, 2))
    mean = seen.reshape(camera.height, fine, camera.width, fine).mean(axis=(1, 3))
    return np.repeat(mean[..., None], 3, axis=2).round().astype(np.uint8)


@pytest.mark.parametrize(("camera", "fov_deg"), [(FISHEYE, 80), (FISHEYE, 100), (NARROW, 40)])
def test_straight_lines_are_straight_again(camera: Intrinsics, fov_deg: float) -> None:
    target = pinhole(96, fov_deg)
    undistorter = Undistorter(camera, target)
    assert undistorter.outside == 0
    made = undistorter(seen_by(camera)).astype(float)
    truth = seen_by(target, fine=8).astype(float)
    # Edges are soft: what counts is that they are where they belong.
    inner = np.s_[2:-2, 2:-2]
    assert np.abs(made - truth)[inner].mean() < 10
    shifted = np.abs(made - np.roll(truth, 2, axis=1))[inner].mean()
    assert np.abs(made - truth)[inner].mean() < 0.5 * shifted


@pytest.mark.parametrize("camera", [FISHEYE, NARROW])
def test_without_shrinking_it_is_opencv_s_own_map(camera: Intrinsics) -> None:
    target = pinhole(512, 60)
    noise = np.random.default_rng(1).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    frame = np.asarray(cv2.GaussianBlur(noise, (0, 0), 2), np.uint8)
    lens = matrix(camera), np.array(camera.distortion)
    make = cv2.initUndistortRectifyMap
    if camera.model == "fisheye":
        make = cv2.fisheye.initUndistortRectifyMap  # type: ignore[assignment]  # the same arguments
    maps = make(*lens, np.eye(3), matrix(target), (512, 512), cv2.CV_32FC1)
    expected = cv2.remap(frame, *maps, interpolation=cv2.INTER_LINEAR).astype(int)
    made = Undistorter(camera, target)(frame).astype(int)
    inside = np.s_[100:-100, 100:-100]
    # Places are rounded to a 32nd of a pixel, not always to the same.
    assert np.abs(made - expected)[inside].max() <= 2


def test_what_the_lens_did_not_see_is_black_and_counted() -> None:
    white = np.full((240, 320, 1), 255, np.uint8)
    undistorter = Undistorter(NARROW, pinhole(64, 120))
    made = undistorter(white)
    assert made.shape == (64, 64, 1)
    assert 0.5 < undistorter.outside < 1
    assert (made[[0, -1]] == 0).all()
    assert made[32, 32] == 255
    assert float((made == 0).mean()) == pytest.approx(undistorter.outside, abs=0.03)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(8, 700),
    st.integers(8, 700),
    st.floats(-0.6, 0.6),
    st.floats(-0.6, 0.6),
    st.sampled_from([FISHEYE, NARROW]),
    st.floats(-3, 3),
)
def test_resized_intrinsics_hit_the_same_place(
    width: int, height: int, x: float, y: float, camera: Intrinsics, skew: float
) -> None:
    camera = camera.model_copy(update={"skew": skew})
    small = resized(camera, width, height)
    assert (small.width, small.height, small.distortion) == (width, height, camera.distortion)
    # From the image's edge, a share of it stays the same share.
    for one, size, other, other_size in (
        (camera, (camera.width, camera.height), small, (width, height)),
    ):
        ray = np.array([x, y, 1.0])
        before = (matrix(one) @ ray)[:2] + 0.5
        after = (matrix(other) @ ray)[:2] + 0.5
        assert after / other_size == pytest.approx(before / size, abs=1e-9)


def test_a_field_of_view_reaches_from_edge_to_edge() -> None:
    camera = pinhole(224, 90)
    assert camera.fx == pytest.approx(112)
    # The outer edge of the last pixel is half a pixel beyond its centre.
    left = math.degrees(math.atan((camera.cx + 0.5) / camera.fx))
    assert left == pytest.approx(45)
    for fov in (0.0, 180.0, math.nan):
        with pytest.raises(ValueError, match="field of view"):
            pinhole(224, fov)


def test_frames_and_targets_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="distortion"):
        Undistorter(FISHEYE, NARROW)
    with pytest.raises(ValueError, match=r"the frame is \(64, 48\)"):
        Undistorter(FISHEYE, pinhole(32, 60))(np.zeros((48, 64, 3), np.uint8))
    endless = NARROW.model_copy(update={"distortion": [1e308] * 5})
    with pytest.raises(ValueError, match="lead nowhere"):
        Undistorter(endless, pinhole(32, 60))


@pytest.mark.parametrize(
    ("model", "count", "fits"),
    [("fisheye", 4, True), ("fisheye", 5, False), ("pinhole", 5, True), ("pinhole", 6, False)],
)
def test_models_have_their_own_numbers_of_coefficients(model: str, count: int, fits: bool) -> None:
    values = {**NARROW.model_dump(), "model": model, "distortion": [0.0] * count}
    if fits:
        assert len(Intrinsics.model_validate(values).distortion) == count
    else:
        with pytest.raises(ValidationError, match="coefficients of distortion"):
            Intrinsics.model_validate(values)


def test_a_gopro_s_file(real_data: Path) -> None:
    document = json.loads((real_data / "exumi" / "gopro_intrinsics_2_7k.json").read_text())
    camera = from_open_camera_calibrator(document)
    assert (camera.model, camera.width, camera.height) == ("fisheye", 2704, 2028)
    assert camera.fy / camera.fx == pytest.approx(1.0029788958491257)
    assert camera.distortion[3] == -0.00016807228608000285
    assert Undistorter(camera, pinhole(224, 90)).outside == 0


def test_another_file_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Invalid intrinsic_type \('PINHOLE'\)"):
        from_open_camera_calibrator({"intrinsic_type": "PINHOLE"})
    with pytest.raises(ValueError, match="focal_length"):
        from_open_camera_calibrator({"intrinsic_type": "FISHEYE", "intrinsics": {}})
