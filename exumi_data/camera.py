"""Cameras: intrinsics for images of another size, and frames without distortion.

Models and the order of coefficients are OpenCV's; whole numbers are the centres of pixels.
OpenCV is imported where it is used.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.model.calibration import Intrinsics

__all__ = ["Undistorter", "from_open_camera_calibrator", "matrix", "pinhole", "resized"]


def matrix(camera: Intrinsics) -> npt.NDArray[np.float64]:
    """Return a camera's matrix, (3, 3) float64."""
    return np.array(
        [[camera.fx, camera.skew, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    )


def pinhole(size: int, fov_deg: float) -> Intrinsics:
    """Return a camera without distortion that sees a square.

    Parameters
    ----------
    size : int
        Edge of its images, pixels.
    fov_deg : float
        Angle between its left and right edge, degrees, as between upper and lower.

    Raises
    ------
    ValueError
        The angle is not between 0 and 180 degrees.
    """
    if not 0 < fov_deg < 180:
        raise ValueError(
            f"Invalid field of view ({fov_deg}). Supported: above 0, below 180 degrees"
        )
    focal = size / 2 / math.tan(math.radians(fov_deg) / 2)
    middle = (size - 1) / 2
    return Intrinsics(
        model="pinhole", width=size, height=size, fx=focal, fy=focal, cx=middle, cy=middle
    )


def resized(camera: Intrinsics, width: int, height: int) -> Intrinsics:
    """Return the intrinsics that hold once a camera's images have been resized.

    Each axis is scaled by its own factor. Distortion acts on directions and stays as it is.

    Parameters
    ----------
    camera : Intrinsics
    width, height : int
        Of the images afterwards, pixels.
    """
    across, down = width / camera.width, height / camera.height
    changed = camera.model_copy(deep=True)
    changed.width, changed.height = width, height
    changed.fx, changed.skew = camera.fx * across, camera.skew * across
    changed.fy = camera.fy * down
    # The edge of an image lies half a pixel before the centre of its first pixel.
    changed.cx = (camera.cx + 0.5) * across - 0.5
    changed.cy = (camera.cy + 0.5) * down - 0.5
    return changed


def from_open_camera_calibrator(document: Mapping[str, Any]) -> Intrinsics:
    """Return the intrinsics in a file of OpenImuCameraCalibrator, as UMI and exUMI have them.

    Its ``aspect_ratio`` is fy / fx. Both projects' own readers leave it out (0.3 % of the height).

    Parameters
    ----------
    document : mapping
        The JSON document, of type FISHEYE.

    Raises
    ------
    ValueError
        It is of another type, or a number is missing or impossible.
    """
    kind = document.get("intrinsic_type")
    if kind != "FISHEYE":
        raise ValueError(f"Invalid intrinsic_type ({kind!r}). Supported: 'FISHEYE'")
    try:
        numbers = document["intrinsics"]
        focal = float(numbers["focal_length"])
        return Intrinsics(
            model="fisheye",
            width=document["image_width"],
            height=document["image_height"],
            fx=focal,
            fy=focal * float(numbers["aspect_ratio"]),
            cx=float(numbers["principal_pt_x"]),
            cy=float(numbers["principal_pt_y"]),
            skew=float(numbers["skew"]),
            distortion=[float(numbers[f"radial_distortion_{i}"]) for i in range(1, 5)],
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"no intrinsics of OpenImuCameraCalibrator: {error!r}") from None


class Undistorter:
    """Makes frames of one camera look as if another, without distortion, had taken them.

    Where the source has finer pixels, it is first shrunk by a whole factor (the mean over each
    area, OpenCV's INTER_AREA) so that nothing is skipped; then pixels are interpolated linearly.
    What the source did not see is black.

    Parameters
    ----------
    camera : Intrinsics
        That the frames are of.
    target : Intrinsics
        Without distortion.

    Attributes
    ----------
    outside : float
        Share of target pixels that the source did not see.

    Raises
    ------
    ValueError
        The target has distortion, or the camera's numbers lead nowhere.
    """

    def __init__(self, camera: Intrinsics, target: Intrinsics) -> None:
        import cv2

        if target.distortion:
            raise ValueError("the target camera has distortion")
        self._size = camera.width, camera.height
        self._factors = _shrinking(camera, target)
        shrunk = _shrunk(camera, *self._factors)
        across, down = _places(shrunk, target)
        seen = (across > -0.5) & (across < shrunk.width - 0.5)
        seen &= (down > -0.5) & (down < shrunk.height - 0.5)
        self.outside = float(1 - seen.mean())
        # Pixels at the border are interpolated with themselves, those beyond it are black.
        across = np.where(seen, across.clip(0, shrunk.width - 1), -9).astype(np.float32)
        down = np.where(seen, down.clip(0, shrunk.height - 1), -9).astype(np.float32)
        self._maps = cv2.convertMaps(across, down, cv2.CV_16SC2)

    def __call__(self, frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return a frame as the target camera would have seen it.

        Parameters
        ----------
        frame : (H, W, C) uint8
            Of the camera's size.

        Returns
        -------
        (target.height, target.width, C) uint8

        Raises
        ------
        ValueError
            The frame is of another size.
        """
        import cv2

        if frame.shape[1::-1] != self._size:
            raise ValueError(f"the frame is {frame.shape[1::-1]}, the camera's are {self._size}")
        across, down = self._factors
        shrunk = frame
        if self._factors != (1, 1):
            width, height = frame.shape[1] // across, frame.shape[0] // down
            whole = frame[: height * down, : width * across]
            shrunk = np.asarray(
                cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8
            )
        made = cv2.remap(shrunk, *self._maps, interpolation=cv2.INTER_LINEAR)
        return np.asarray(made, np.uint8).reshape(*made.shape[:2], -1)


def _shrinking(camera: Intrinsics, target: Intrinsics) -> tuple[int, int]:
    """Return by how much, across and down, the source's pixels are finer than the target's.

    A fisheye's are so in the middle more than at the edge: it is the median. Whole numbers, because
    an image is shrunk ten times as fast then.
    """
    across, down = _places(camera, target)
    steps = [np.abs(np.diff(across, axis=1)), np.abs(np.diff(down, axis=0))]
    factors = [int(np.median(step)) if step.size else 1 for step in steps]
    return min(max(1, factors[0]), camera.width), min(max(1, factors[1]), camera.height)


def _shrunk(camera: Intrinsics, across: int, down: int) -> Intrinsics:
    """Return the intrinsics of shrunk images; what is left over right and below is cut off."""
    width, height = camera.width // across, camera.height // down
    cut = camera.model_copy(update={"width": width * across, "height": height * down})
    return resized(cut, width, height)


def _places(
    camera: Intrinsics, target: Intrinsics
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return where in the camera's image each pixel of the target lies, across and down."""
    import cv2

    down, across = np.mgrid[: target.height, : target.width].astype(np.float64)
    y = (down - target.cy) / target.fy
    x = (across - target.cx - target.skew * y) / target.fx
    directions = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    lens, coefficients = np.eye(3), np.array(camera.distortion)
    if camera.model == "fisheye":
        four = coefficients if len(coefficients) else np.zeros(4)
        bent = cv2.fisheye.distortPoints(directions, lens, four)
    else:
        rays = np.concatenate([directions, np.ones((*directions.shape[:2], 1))], axis=-1)
        bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), lens, coefficients)[0]
    homogeneous = np.concatenate([bent.reshape(-1, 2), np.ones((len(directions), 1))], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):  # found out below
        found = (homogeneous @ matrix(camera).T)[:, :2].reshape(target.height, target.width, 2)
    if not np.isfinite(found).all():
        raise ValueError("the camera's intrinsics lead nowhere")
    return found[..., 0], found[..., 1]
