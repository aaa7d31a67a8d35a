"""Intrinsics of a camera from the files that calibration programs write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from exumi_data.camera import from_open_camera_calibrator
from exumi_data.errors import SourceError
from exumi_data.model.calibration import INTRINSICS, Intrinsics
from exumi_data.model.description import CalibrationItem
from exumi_data.model.documents import dump

__all__ = ["intrinsics_item", "read_intrinsics"]

_MOST_BYTES = 1 << 20
_MATRIX = ("camera_matrix", "cameraMatrix", "K", "mtx")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D", "dist")
_ERROR = ("avg_reprojection_error", "reprojection_error", "rms")
_FISHEYE_WORDS = ("fisheye", "equidistant", "kannala_brandt4")
# Of OpenCV: radial two and tangential two, or the four of a fisheye.
_OF_EITHER = 4
_FIX = "Supported: OpenImuCameraCalibrator's JSON; OpenCV's YAML and JSON; ROS's camera_info YAML."


def read_intrinsics(
    path: Path, *, fisheye: bool | None = None, size: tuple[int, int] | None = None
) -> tuple[Intrinsics, float | None, str]:
    """Read a file of intrinsics.

    Parameters
    ----------
    path : pathlib.Path
        Of OpenImuCameraCalibrator (JSON), or with the camera's matrix and coefficients as OpenCV
        (YAML, JSON) or ROS (YAML) write them.
    fisheye : bool, optional
        Whether it is a fisheye, where the file does not say; OpenCV's own do not.
    size : (int, int), optional
        Width and height of the images, where the file does not say.

    Returns
    -------
    camera : Intrinsics
    residual : float or None
        Reprojection error, pixels.
    method : str
        What made the file.

    Raises
    ------
    SourceError
        It is none of these, numbers are missing or impossible, it does not say which model its four
        coefficients are of, or it says other than what is given.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise SourceError(f"larger than {_MOST_BYTES:,} bytes", where=path)
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"cannot be read ({error})", where=path) from None
    try:
        document = _plain_json(text)
        if document is not None and "intrinsics" in document:
            residual = document.get("final_reproj_error")
            camera = from_open_camera_calibrator(document)
            _agree(camera, fisheye, size)
            return camera, _number(residual), "OpenImuCameraCalibrator"
        values = _values(document) if document is not None else _opencv_values(text, path)
        return _camera(values, fisheye, size), _number(values.get("error")), values["method"]
    except ValidationError as error:
        raise SourceError(f"impossible numbers ({error.errors()[0]['msg']})", where=path) from None
    except (ValueError, TypeError, RecursionError) as error:
        raise SourceError(str(error), where=path, fix=_FIX) from None


def _plain_json(text: str) -> dict[str, Any] | None:
    """Return a JSON object of lists and numbers; None for OpenCV's own and for YAML."""
    if not text.lstrip().startswith("{"):
        return None
    document = json.loads(text)
    if not isinstance(document, dict):
        raise ValueError("no JSON object")  # noqa: TRY004  # a file's fault, not a caller's
    own = any(isinstance(value, dict) and "type_id" in value for value in document.values())
    return None if own else document


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _first(document: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((document[name] for name in names if document.get(name) is not None), None)


def _values(document: Mapping[str, Any]) -> dict[str, Any]:
    size = document.get("image_size") or (None, None)
    return {
        "matrix": _array(_first(document, _MATRIX)),
        "distortion": _array(_first(document, _DISTORTION)),
        "width": document.get("image_width", document.get("width", size[0])),
        "height": document.get("image_height", document.get("height", size[1])),
        "model": str(_first(document, ("distortion_model", "model", "camera_model")) or ""),
        "error": _first(document, _ERROR),
        "method": "OpenCV, from a JSON file",
    }


def _array(value: Any) -> NDArray[np.float64] | None:
    if isinstance(value, Mapping):
        value = value.get("data")
    return None if value is None else np.array(value, np.float64)


def _opencv_values(text: str, path: Path) -> dict[str, Any]:
    """Read OpenCV's YAML or JSON, or ROS's YAML, with OpenCV's own parser."""
    import cv2

    if not text.lstrip().startswith(("{", "%YAML", "<")):
        # ROS leaves out the line that OpenCV insists on.
        text = f"%YAML:1.0\n---\n{text.lstrip().removeprefix('---')}"
    flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
    try:
        storage = cv2.FileStorage(text, flags)
    except (cv2.error, SystemError):  # the second is how OpenCV's constructor reports the first
        raise ValueError("neither JSON nor YAML nor XML that OpenCV can read") from None
    try:
        missed = _first_node(storage, _ERROR)
        model = _first_node(storage, ("distortion_model", "camera_model"))
        return {
            "matrix": _node_array(_first_node(storage, _MATRIX)),
            "distortion": _node_array(_first_node(storage, _DISTORTION)),
            "width": _node_int(_first_node(storage, ("image_width", "width"))),
            "height": _node_int(_first_node(storage, ("image_height", "height"))),
            "model": "" if model is None or not model.isString() else model.string(),
            "error": None if missed is None else missed.real(),
            "method": f"OpenCV, from {path.suffix.lstrip('.').upper() or 'a file'}",
        }
    except cv2.error as error:
        raise ValueError(f"cannot be read by OpenCV ({str(error).strip()[:120]})") from None
    finally:
        storage.release()


def _first_node(storage: Any, names: tuple[str, ...]) -> Any:
    for name in names:
        node = storage.getNode(name)
        if not node.empty():
            return node
    return None


def _node_array(node: Any) -> NDArray[np.float64] | None:
    if node is None:
        return None
    if node.isMap() and node.getNode("dt").empty():  # ROS: rows, cols, data
        node = node.getNode("data")
    if node.isSeq():
        return np.array([node.at(i).real() for i in range(node.size())], np.float64)
    found = node.mat()
    return None if found is None else np.asarray(found, np.float64)


def _node_int(node: Any) -> int | None:
    return None if node is None else int(node.real())


def _camera(
    values: Mapping[str, Any], fisheye: bool | None, size: tuple[int, int] | None
) -> Intrinsics:
    matrix, distortion = values["matrix"], values["distortion"]
    if matrix is None or matrix.size != 9:
        raise ValueError("no camera matrix of 3x3 numbers")
    (fx, skew, cx), (other, fy, cy), last = matrix.reshape(3, 3).tolist()
    if last != [0.0, 0.0, 1.0] or other:
        raise ValueError("the camera matrix is none")
    stated = (values["width"], values["height"])
    width, height = stated if all(stated) else size or (None, None)
    if not width or not height:
        raise ValueError("the file does not say for images of which size it holds: give --size")
    coefficients = [] if distortion is None else distortion.ravel().tolist()
    if not any(coefficients):
        coefficients = []
    camera = Intrinsics(
        model=_model(values["model"].lower(), len(coefficients), fisheye),
        width=int(width),
        height=int(height),
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        skew=skew,
        distortion=coefficients,
    )
    _agree(camera, fisheye, size)
    if not (0 <= camera.cx <= camera.width and 0 <= camera.cy <= camera.height):
        raise ValueError(
            f"the middle of the picture, {camera.cx:.0f}, {camera.cy:.0f}, is outside of images of "
            f"{camera.width}x{camera.height}: it holds for another size"
        )
    return camera


def _model(said: str, coefficients: int, fisheye: bool | None) -> Literal["pinhole", "fisheye"]:
    """Return the model that a file says, or a user where it does not."""
    if any(word in said for word in _FISHEYE_WORDS):
        return "fisheye"
    if fisheye is not None and not said:
        return "fisheye" if fisheye else "pinhole"
    if coefficients == _OF_EITHER and not said:
        raise ValueError(
            f"{coefficients} coefficients are those of a fisheye or of a pinhole, and the file "
            "does not say which: give --fisheye or --pinhole"
        )
    return "pinhole"


def _agree(camera: Intrinsics, fisheye: bool | None, size: tuple[int, int] | None) -> None:
    """Refuse what a user says and a file says otherwise."""
    if size not in (None, (camera.width, camera.height)):
        raise ValueError(f"the file is of images of {camera.width}x{camera.height}")
    if fisheye is not None and (camera.model == "fisheye") != fisheye:
        raise ValueError(f"the file says that it is a {camera.model}")


def intrinsics_item(
    camera: Intrinsics, residual_px: float | None, method: str, stream: str
) -> tuple[str, CalibrationItem]:
    """Make the item ``intrinsics/<stream>``.

    Parameters
    ----------
    camera : Intrinsics
    residual_px : float or None
        Reprojection error.
    method : str
    stream : str

    Returns
    -------
    name : str
    item : CalibrationItem
    """
    item = CalibrationItem(
        value=dump(camera),
        unit="px",
        residual=residual_px,
        uncertainty=None,
        method=method,
        procedure=f"imported: {camera.model}, {camera.width}x{camera.height}, focal length "
        f"{camera.fx:.1f} and {camera.fy:.1f} px, {len(camera.distortion or ())} coefficients",
    )
    return INTRINSICS + stream, item
