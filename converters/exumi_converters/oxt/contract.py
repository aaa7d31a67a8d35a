"""Words of the contract of Open-X-Tactile (FTP-1): both directions use them."""

import re
from collections.abc import Mapping
from typing import NamedTuple

__all__ = [
    "CAMERAS",
    "GRIPPER_SLOT",
    "INDEX",
    "INSTRUCTION",
    "MARK",
    "NUMBERED_TYPES",
    "SENSORS",
    "THUMB",
    "TIMESTAMPS",
    "TORQUE_AREAS",
    "UNKNOWN_SENSOR",
    "WRIST_TORQUE",
    "TactileKey",
    "key_of",
    "tactile_key",
]

TIMESTAMPS = "timestamps"
INSTRUCTION = "sub_task_instruction"
CAMERAS = (
    "camera_main_rgb",
    "camera_ego_rgb",
    "right_wrist_camera_rgb",
    "left_wrist_camera_rgb",
)
"""Keys of cameras, in the order in which FTP-1's loader looks for one."""

GRIPPER_SLOT = 28
"""Of the 32 slots of a hand's joints, that of a gripper's one number."""
THUMB, INDEX = 0, 1
"""Areas that the two pads of a gripper share with the tips of thumb and index finger."""
WRIST_TORQUE = 15
TORQUE_AREAS = range(15, 21)
"""Areas that stand for forces and torques of joints, not for skin."""
NUMBERED_TYPES = ("state", "binary", "matrix")
"""Types of tactile data that are no images; ``matrix`` is in releases, not in the document."""

SENSORS: Mapping[str, str] = {"gelsight-mini": "GelSightMini"}
"""Our name of a sensor model to theirs, where both are published; other names stay."""
UNKNOWN_SENSOR = "unknown"

MARK = "exumi"
"""Key of the root's attributes under which our own stores say what their arrays are."""

_TACTILE = re.compile(r"(left|right)_tactile_(data|area|sensor|type)_([A-Za-z0-9_.-]{1,128})")


class TactileKey(NamedTuple):
    """The parts of the name of an array of a tactile group."""

    side: str
    what: str
    group: str


def tactile_key(name: str) -> TactileKey | None:
    """Take the name of an array of a tactile group apart; None if it is none.

    Parameters
    ----------
    name : str
        Such as ``right_tactile_area_gripper``.
    """
    match = _TACTILE.fullmatch(name)
    return None if match is None else TactileKey(*match.groups())


def key_of(data_key: str, what: str) -> str:
    """Return the name of another array of the group.

    Parameters
    ----------
    data_key : str
        Such as ``right_tactile_data_gripper``.
    what : str
        ``area``, ``sensor`` or ``type``.
    """
    return data_key.replace("_tactile_data_", f"_tactile_{what}_", 1)
