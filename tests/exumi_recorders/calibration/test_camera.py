"""Intrinsics from the files of other programs."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from exumi_data.errors import SourceError
from exumi_data.model.calibration import Intrinsics
from exumi_recorders.calibration.camera import intrinsics_item, read_intrinsics

MATRIX = np.array([[500.0, 0, 320], [0, 501, 240], [0, 0, 1]])
EXPECTED: dict[str, Any] = {
    "width": 640,
    "height": 480,
    "fx": 500.0,
    "fy": 501.0,
    "cx": 320.0,
    "cy": 240.0,
}
ROS = """image_width: 640
image_height: 480
camera_name: wrist
camera_matrix:
  rows: 3
  cols: 3
  data: [500., 0., 320., 0., 501., 240., 0., 0., 1.]
distortion_model: equidistant
distortion_coefficients:
  rows: 1
  cols: 4
  data: [0.1, 0.2, 0.3, 0.4]
"""
OPEN_IMU = {
    "final_reproj_error": 0.29,
    "image_height": 480,
    "image_width": 640,
    "intrinsic_type": "FISHEYE",
    "intrinsics": {
        "aspect_ratio": 1.002,
        "focal_length": 500.0,
        "principal_pt_x": 320.0,
        "principal_pt_y": 240.0,
        "radial_distortion_1": 0.1,
        "radial_distortion_2": 0.2,
        "radial_distortion_3": 0.3,
        "radial_distortion_4": 0.4,
        "skew": 0.0,
    },
}


@pytest.mark.parametrize("name", ["a.yml", "a.json", "a.xml"])
def test_what_opencv_writes(tmp_path: Path, name: str) -> None:
    storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", np.array([[0.1, -0.2, 0, 0, 0.01]]))
    storage.write("avg_reprojection_error", 0.31)
    storage.release()
    camera, residual, method = read_intrinsics(tmp_path / name)
    expected = Intrinsics(model="pinhole", distortion=[0.1, -0.2, 0, 0, 0.01], **EXPECTED)
    assert (camera, residual) == (expected, 0.31)
    assert "OpenCV" in method


def test_what_ros_writes(tmp_path: Path) -> None:
    (tmp_path / "head.yaml").write_text(ROS)
    camera, residual, _ = read_intrinsics(tmp_path / "head.yaml")
    assert camera == Intrinsics(model="fisheye", distortion=[0.1, 0.2, 0.3, 0.4], **EXPECTED)
    assert residual is None


def test_plain_json_and_what_it_does_not_say(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"K": MATRIX.tolist(), "D": [[0.1], [0.2], [0.3], [0.4]]}))
    with pytest.raises(SourceError, match="give --size"):
        read_intrinsics(path)
    # Four coefficients may be either's.
    with pytest.raises(SourceError, match="give --fisheye or --pinhole"):
        read_intrinsics(path, size=(640, 480))
    assert read_intrinsics(path, size=(640, 480), fisheye=False)[0].model == "pinhole"
    camera = read_intrinsics(path, size=(640, 480), fisheye=True)[0]
    assert camera == Intrinsics(model="fisheye", distortion=[0.1, 0.2, 0.3, 0.4], **EXPECTED)


def test_what_is_given_must_agree_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "head.yaml"
    path.write_text(ROS)
    assert read_intrinsics(path, size=(640, 480), fisheye=True)[0].model == "fisheye"
    with pytest.raises(SourceError, match="images of 640x480"):
        read_intrinsics(path, size=(1280, 960))
    with pytest.raises(SourceError, match="it is a fisheye"):
        read_intrinsics(path, fisheye=False)
    path.write_text(ROS.replace("image_width: 640", "image_width: 300"))
    with pytest.raises(SourceError, match="320, 240, is outside of images of 300x480"):
        read_intrinsics(path)
    gopro = tmp_path / "gopro.json"
    gopro.write_text(json.dumps(OPEN_IMU))
    with pytest.raises(SourceError, match="images of 640x480"):
        read_intrinsics(gopro, size=(1920, 1080))
    with pytest.raises(SourceError, match="it is a fisheye"):
        read_intrinsics(gopro, fisheye=False)


def test_open_camera_calibrator(tmp_path: Path) -> None:
    path = tmp_path / "gopro.json"
    path.write_text(json.dumps(OPEN_IMU))
    camera, residual, method = read_intrinsics(path)
    assert (camera.fy, residual, method) == (501.0, 0.29, "OpenImuCameraCalibrator")
    name, item = intrinsics_item(camera, residual, method, "rgb")
    assert name == "intrinsics/rgb"
    assert Intrinsics.model_validate(item.value) == camera
    assert (item.unit, item.residual) == ("px", 0.29)


def test_the_real_gopro(real_data: Path) -> None:
    camera, residual, _ = read_intrinsics(real_data / "exumi/gopro_intrinsics_2_7k.json")
    assert (camera.width, camera.model) == (2704, "fisheye")
    assert residual == pytest.approx(0.2916, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no camera matrix"),
        ("not: [yaml", "neither JSON"),
        ("{", "Supported"),
        ("[1]", "Supported|no camera matrix|neither"),
        ('{"K": [1, 2]}', "no camera matrix"),
        ('{"K": [[1,0,0],[0,1,0],[0,0,2]], "image_size": [4, 4]}', "matrix is none"),
        ('{"K": [[-1,0,0],[0,1,0],[0,0,1]], "image_size": [4, 4]}', "impossible"),
        ('{"K": [[1,0,0],[0,1,0],[0,0,1]], "D": [1], "image_size": [4, 4]}', "impossible"),
        ('{"intrinsics": {}, "intrinsic_type": "PINHOLE"}', "intrinsic_type"),
    ],
)
def test_files_that_hold_something_else(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(SourceError, match=said):
        read_intrinsics(path)
