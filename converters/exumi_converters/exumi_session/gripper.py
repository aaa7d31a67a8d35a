"""From the encoder's counts to the gripper's opening, by exUMI's calibration file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_data.errors import ExumiError, UsageError
from exumi_data.gripper_readings import fit_gripper, gripper_item, read_gripper_file
from exumi_data.model import CalibrationItem
from exumi_data.width_map import WidthMap, read_width_map

__all__ = ["MODULUS", "gripper_calibration", "widths_of"]

MODULUS = 4096
"""Where the AS5600's counts wrap."""


def gripper_calibration(
    named: Path | None, lying: Sequence[Path]
) -> tuple[CalibrationItem | None, list[str]]:
    """Return the gripper's map as a calibration item, and what there is to say.

    Parameters
    ----------
    named : pathlib.Path or None
        The file that the user named.
    lying : sequence of pathlib.Path
        Those that lie in the session.

    Raises
    ------
    UsageError
        The file that the user named is none, or makes no map.
    """
    if named is not None:
        try:
            return gripper_item(fit_gripper(read_gripper_file(named))), []
        except ExumiError as error:
            raise UsageError(
                f"no calibration of a gripper: {error.what}", where=named, fix=error.fix
            ) from None
    said: list[str] = []
    for path in lying:
        try:
            return gripper_item(fit_gripper(read_gripper_file(path))), said
        except ExumiError as error:
            said.append(f"{path.name} is not used: {error.what}")
    return None, said


def widths_of(
    item: CalibrationItem | None, counts: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return openings of counts.

    Parameters
    ----------
    item : CalibrationItem or None
        Without it no opening is known.
    counts : (N,) int64

    Returns
    -------
    widths : (N,) float32
        Metres; NaN where it is not known.
    invalid : (N,) bool
        Counts that the encoder does not have, or all of them without a map.
    outside : (N,) bool
        Counts beyond the map's ends: its end is held.
    """
    invalid = (counts < 0) | (counts >= MODULUS)
    none = np.zeros(len(counts), np.bool_)
    read = None if item is None else read_width_map(item.value)
    if not isinstance(read, WidthMap):
        return np.full(len(counts), np.nan, np.float32), ~none, none
    widths, outside = read.widths(np.where(invalid, 0, counts), MODULUS)
    return np.where(invalid, np.float32(np.nan), widths), invalid, outside & ~invalid
