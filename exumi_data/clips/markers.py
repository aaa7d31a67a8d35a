"""Where a printed ArUco marker is, in the frames of a camera whose intrinsics are known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from exumi_data.camera import matrix
from exumi_data.model.calibration import Intrinsics
from exumi_data.synchronisation.sweep import MarkerTrack

__all__ = [
    "MarkerFinder",
    "MarkerSettings",
    "MarkerView",
    "as_track",
    "dictionary_names",
    "marker_views",
    "track_marker",
]

Float64Array = NDArray[np.float64]
UInt8Array = NDArray[np.uint8]

_SEARCHED_PX = 1000
_UNTIL = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 30, 0.01)


def dictionary_names() -> list[str]:
    """Return the names of the dictionaries that OpenCV has."""
    return sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))


@dataclass(frozen=True, slots=True)
class MarkerSettings:
    """Which marker to look for.

    Attributes
    ----------
    dictionary : str
        As OpenCV calls it.
    number : int
        The marker's id.
    side_m : float
        Edge of the black square, metres.

    Raises
    ------
    ValueError
        There is no such dictionary or marker, or the side is not positive.
    """

    dictionary: str = "DICT_4X4_50"
    number: int = 4
    side_m: float = 0.06

    def __post_init__(self) -> None:
        if self.dictionary not in dictionary_names():
            msg = f"no dictionary {self.dictionary!r}, such as DICT_4X4_50"
            raise ValueError(msg)
        count = len(self.patterns.bytesList)
        if not 0 <= self.number < count or not self.side_m > 0:
            msg = f"marker {self.number} of {self.side_m} m; {self.dictionary} has 0 to {count - 1}"
            raise ValueError(msg)

    @property
    def patterns(self) -> cv2.aruco.Dictionary:
        """OpenCV's dictionary."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))


def _refined(grey: UInt8Array, corners: Float64Array, step: int) -> Float64Array:
    """Return corners that were found in a smaller image to parts of a pixel of the whole one."""
    rough = corners.astype(np.float32).reshape(-1, 1, 2)
    reach = (2 * step + 1, 2 * step + 1)
    made = cv2.cornerSubPix(grey, rough, reach, (-1, -1), _UNTIL)
    return np.asarray(made, np.float64).reshape(4, 2)


class MarkerFinder:
    """Finds one marker in the frames of one camera.

    Parameters
    ----------
    camera : Intrinsics
        Of the frames.
    settings : MarkerSettings
    """

    def __init__(self, camera: Intrinsics, settings: MarkerSettings) -> None:
        self._camera = camera
        self._settings = settings
        parameters = cv2.aruco.DetectorParameters()
        # Corners to parts of a pixel: what is measured is where the marker is, not that it is.
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detector = cv2.aruco.ArucoDetector(settings.patterns, parameters)
        half = settings.side_m / 2
        self._corners = np.array(
            [[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]], np.float64
        )

    def find(self, frame: UInt8Array) -> tuple[Float64Array, Float64Array] | None:
        """Find the marker in a frame.

        Parameters
        ----------
        frame : (H, W) or (H, W, 1|3) uint8

        Returns
        -------
        pose : (4, 4) float64
            ``T_camera_marker``: camera right, down, forward, metres.
        corners : (4, 2) float64
            Column and row of the corners.
        None
            It is not there, or is there twice.

        Raises
        ------
        ValueError
            The frame is not of the camera's size.
        """
        if frame.shape[1::-1] != (self._camera.width, self._camera.height):
            msg = (
                f"frames of {frame.shape[1]}x{frame.shape[0]}, intrinsics for "
                f"{self._camera.width}x{self._camera.height}"
            )
            raise ValueError(msg)
        grey = np.ascontiguousarray(frame.mean(axis=2) if frame.ndim == 3 else frame, np.uint8)
        # A marker that can be measured is large: it is looked for in fewer pixels.
        step = max(1, grey.shape[1] // _SEARCHED_PX)
        size = grey.shape[1] // step, grey.shape[0] // step
        small = grey if step == 1 else cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        found, numbers, _ = self._detector.detectMarkers(small)
        if not len(found):
            return None
        own = np.flatnonzero(np.asarray(numbers).ravel() == self._settings.number)
        if len(own) != 1:
            return None
        corners = np.asarray(found[int(own[0])], np.float64).reshape(4, 2)
        if step > 1:
            corners = _refined(grey, (corners + 0.5) * step - 0.5, step)
        pose = self._pose(corners)
        return None if pose is None else (pose, corners)

    def _pose(self, corners: Float64Array) -> Float64Array | None:
        """Return ``T_camera_marker`` from the corners, straightened to a camera without a lens."""
        straight = self._straight(corners)
        if not np.isfinite(straight).all():
            return None
        worked, turn, shift = cv2.solvePnP(
            self._corners, straight, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        if not worked or float(shift[2, 0]) <= 0:
            return None
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(turn)[0]
        pose[:3, 3] = shift.ravel()
        return pose

    def _straight(self, corners: Float64Array) -> Float64Array:
        distortion = np.array(self._camera.distortion or [0.0] * 4, np.float64)
        points = corners.reshape(-1, 1, 2)
        if self._camera.model == "fisheye":
            made = cv2.fisheye.undistortPoints(points, matrix(self._camera), distortion)
        else:
            made = cv2.undistortPoints(points, matrix(self._camera), distortion)
        return np.asarray(made, np.float64).reshape(-1, 1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class MarkerView:
    """The marker in one frame.

    Attributes
    ----------
    time_ns : int
        Of the frame.
    pose : (4, 4) float64
        ``T_camera_marker``, metres.
    row : float
        In which row of the frame its middle is: 0 the first, 1 the last.
    """

    time_ns: int
    pose: Float64Array
    row: float


def marker_views(
    frames: Iterable[tuple[int, UInt8Array]], camera: Intrinsics, settings: MarkerSettings
) -> Iterator[tuple[int, MarkerView | None]]:
    """Look for a marker in frames, one after the other.

    Parameters
    ----------
    frames : iterable of (int, (H, W[, C]) uint8)
        Time, ns, and frame. One is held at a time.
    camera : Intrinsics
    settings : MarkerSettings

    Yields
    ------
    int
        The frame's time.
    MarkerView or None
        None where it is not found.

    Raises
    ------
    ValueError
        The frames are not of the camera's size.
    """
    finder = MarkerFinder(camera, settings)
    for time_ns, frame in frames:
        found = finder.find(frame)
        if found is None:
            yield time_ns, None
            continue
        pose, corners = found
        row = float(corners[:, 1].mean()) / max(frame.shape[0] - 1, 1)
        yield time_ns, MarkerView(time_ns, pose, row)


def as_track(views: Sequence[MarkerView], frames: int) -> MarkerTrack:
    """Put the views of a marker together.

    Parameters
    ----------
    views : sequence of MarkerView
        In the order of time.
    frames : int
        How many frames were looked at.
    """
    return MarkerTrack(
        np.array([view.time_ns for view in views], np.int64),
        np.array([view.pose[:3, 3] for view in views], np.float64).reshape(-1, 3),
        np.array([view.row for view in views], np.float64),
        frames,
    )


def track_marker(
    frames: Iterable[tuple[int, UInt8Array]], camera: Intrinsics, settings: MarkerSettings
) -> tuple[MarkerTrack, Float64Array]:
    """Find a marker in all frames of a recording.

    Parameters
    ----------
    frames : iterable of (int, (H, W[, C]) uint8)
        Time, ns, and frame. One is held at a time.
    camera : Intrinsics
    settings : MarkerSettings

    Returns
    -------
    MarkerTrack
    poses : (N, 4, 4) float64
        ``T_camera_marker`` of the same frames.

    Raises
    ------
    ValueError
        The frames are not of the camera's size.
    """
    count, views = 0, []
    for _, view in marker_views(frames, camera, settings):
        count += 1
        if view is not None:
            views.append(view)
    poses = np.array([view.pose for view in views], np.float64).reshape(-1, 4, 4)
    return as_track(views, count), poses
