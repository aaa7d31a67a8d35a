"""Fixed transforms of exUMI's own rig, as its released code has them.

``scripts_slam_pipeline/utils/constants.py`` and ``AR_06_generate_dataset_plan.py`` turn a pose of
the headset's app into one of the tool: T = Rz(-90) · T_wrist · inv(tx_arhand) · Rz(90) · Ry(90) ·
T_camera_tcp. The numbers are of their rig; in an episode they are calibration items.
"""

import numpy as np

from exumi_data.model import CalibrationItem

__all__ = ["rig_items"]

_ARHAND_M = (0.03227652, -0.0598839, -0.0737011)
_ARHAND_DEG = (16.2832578, -1.30209369, 23.76593208)
_TCP_M = (0.0, 0.080, 0.01465 + 0.089)
_SAID = "constants of exUMI's released code, for its own rig; not measured on this one"


def rig_items() -> dict[str, CalibrationItem]:
    """Return the transforms by name, 4 by 4, metres."""
    from scipy.spatial.transform import Rotation

    hand = np.eye(4)
    hand[:3, :3] = Rotation.from_euler("xyz", _ARHAND_DEG, degrees=True).as_matrix()
    hand[:3, 3] = _ARHAND_M
    controller_camera = np.linalg.inv(hand) @ _turned("z", 90) @ _turned("y", 90)
    camera_tcp = np.eye(4)
    camera_tcp[:3, 3] = _TCP_M
    matrices = {
        "T_controller_camera": controller_camera,
        "T_controller_tcp": controller_camera @ camera_tcp,
        "T_base_world": _turned("z", -90),
    }
    return {
        name: CalibrationItem(value=np.round(matrix, 9).tolist(), unit="m", method=_SAID)
        for name, matrix in matrices.items()
    }


def _turned(axis: str, degrees: float) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return matrix
