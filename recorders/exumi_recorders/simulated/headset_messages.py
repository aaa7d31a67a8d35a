"""Messages as Quest apps write them; see `exumi_recorders.drivers.quest_dialects`."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["frame_message", "number", "poses_message"]

_SIDES = {"left": "L", "right": "R", "both": "B"}
_FRAMES = {"a": "WorldFrame:", "b": "WF,", "c": "worldframe,", "d": "XU,WF,"}


def number(value: float, *, decimal_comma: bool = False) -> str:
    """Write a number as C# writes a ``float``: seven digits, ``1E-05``.

    Parameters
    ----------
    value : float
    decimal_comma : bool
    """
    text = f"{np.float32(value):.7G}"
    return text.replace(".", ",") if decimal_comma else text


def frame_message(dialect: str, pose: npt.ArrayLike, *, decimal_comma: bool = False) -> str:
    """Write a world frame.

    Parameters
    ----------
    dialect : str
    pose : array_like, shape (7,)
    decimal_comma : bool
    """
    return _FRAMES[dialect] + _join([np.asarray(pose)], decimal_comma=decimal_comma)


def poses_message(
    dialect: str,
    *,
    flag: bool,
    side: str,
    hands: Sequence[npt.NDArray[np.float64]],
    head: npt.NDArray[np.float64],
    sequence: int,
    time_device_ns: int,
    decimal_comma: bool = False,
) -> str:
    """Write the poses of one instant.

    Parameters
    ----------
    dialect : str
    flag : bool
    side : {"left", "right", "both"}
    hands : sequence of ndarray, shape (7,)
        One, or left and right. Dialects b and c send the first alone.
    head : ndarray, shape (7,)
    sequence, time_device_ns : int
        Of dialect d.
    decimal_comma : bool
    """
    letter = "Y" if flag else "N"
    if dialect in {"b", "c"}:
        return f"EE,{letter}," + _join(hands[:1], decimal_comma=decimal_comma)
    poses = _join([*hands, head], decimal_comma=decimal_comma)
    if dialect == "a":
        return f"{letter}{_SIDES[side]}Hand:{poses}"
    return f"XU,P,{sequence},{time_device_ns},{letter},{_SIDES[side]},{poses}"


def _join(poses: Sequence[npt.NDArray[np.float64]], *, decimal_comma: bool) -> str:
    return ",".join(number(x, decimal_comma=decimal_comma) for pose in poses for x in pose)
