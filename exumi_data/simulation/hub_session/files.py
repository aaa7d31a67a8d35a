"""The files of an exUMI hub: chunks of tactile video, of poses and counts.

Named and filled as its released program does it (``tactile_collection_process.py``).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from exumi_data.model.calibration import Intrinsics

__all__ = [
    "GRIPPER_FILE",
    "INTRINSICS_FILE",
    "chunks_of",
    "write_angles",
    "write_gripper_file",
    "write_intrinsics_file",
    "write_tactile",
]

GRIPPER_FILE = "gripper_calibration.json"
INTRINSICS_FILE = "gopro_intrinsics.json"
# tan θ = θ + θ³/3 + 2θ⁵/15 + 17θ⁷/315 + 62θ⁹/2835 + ...
_PINHOLE = (1 / 3, 2 / 15, 17 / 315, 62 / 2835)
_RATE = 30
_FOURCC = "mp4v"


def chunks_of(stamps_s: NDArray[np.float64], edges_s: NDArray[np.float64]) -> list[slice]:
    """Divide stamps at the moments when the hub saves what it has.

    Parameters
    ----------
    stamps_s : (N,) float64
    edges_s : (K,) float64
        Ascending; after the last one nothing is saved.
    """
    cuts = np.searchsorted(stamps_s, edges_s).tolist()
    return [slice(first, last) for first, last in zip([0, *cuts[:-1]], cuts, strict=True)]


def write_tactile(
    folder: Path,
    side: str,
    number: int,
    stamps_s: Sequence[float],
    frames: Iterator[NDArray[np.uint8]],
) -> None:
    """Write one chunk of a finger: ``<side>_<number>.mp4`` and ``.json``.

    Parameters
    ----------
    folder : pathlib.Path
    side : str
    number : int
    stamps_s : sequence of float
        Unix time of each frame.
    frames : iterator of (H, W, 3) uint8
        RGB, as many.
    """
    writer = None
    for frame in frames:
        if writer is None:
            size = frame.shape[1::-1]
            path = str(folder / f"{side}_{number}.mp4")
            writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*_FOURCC), _RATE, size)
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
    if writer is not None:
        writer.release()
    (folder / f"{side}_{number}.json").write_text(json.dumps(list(stamps_s)))


def write_angles(
    folder: Path,
    number: int,
    stamps_s: NDArray[np.float64],
    counts: NDArray[np.integer],
    poses: NDArray[np.float64],
) -> None:
    """Write one chunk of counts and poses: ``angle_<number>.json``.

    Parameters
    ----------
    folder : pathlib.Path
    number : int
    stamps_s : (N,) float64
        Unix time.
    counts : (N,) int
    poses : (N, 7) float64
        x y z qx qy qz qw.
    """
    said = {
        "angles": [[int(count)] for count in counts],
        "data": poses.tolist(),
        "timestamps": stamps_s.tolist(),
    }
    (folder / f"angle_{number}.json").write_text(json.dumps(said))


def write_gripper_file(path: Path, openings_m: Sequence[float], counts: Sequence[int]) -> None:
    """Write a gripper's calibration as exUMI's ``calibrate_as5600.py`` does, wrong unit included.

    Parameters
    ----------
    path : pathlib.Path
    openings_m : sequence of float
    counts : sequence of int
    """
    pairs = [list(pair) for pair in zip(openings_m, counts, strict=True)]
    said = {"metadata": {"unit": "cm", "sensor_range": [0, 4095]}, "calibration": pairs}
    path.write_text(json.dumps(said, indent=2))


def write_intrinsics_file(path: Path, camera: Intrinsics) -> None:
    """Write a camera without distortion as OpenImuCameraCalibrator writes fisheyes.

    Parameters
    ----------
    path : pathlib.Path
    camera : Intrinsics
        A pinhole: its picture is that of a fisheye with these coefficients, to a part of a pixel.
    """
    said = {
        "final_reproj_error": 0.0,
        "fps": 59.94,
        "image_height": camera.height,
        "image_width": camera.width,
        "intrinsic_type": "FISHEYE",
        "intrinsics": {
            "aspect_ratio": camera.fy / camera.fx,
            "focal_length": camera.fx,
            "principal_pt_x": camera.cx,
            "principal_pt_y": camera.cy,
            "skew": 0.0,
            **{f"radial_distortion_{i}": value for i, value in enumerate(_PINHOLE, start=1)},
        },
        "nr_calib_images": 0,
        "stabelized": False,
    }
    path.write_text(json.dumps(said, indent=2))
