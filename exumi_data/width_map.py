"""From an encoder's counts to the width of a gripper."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from exumi_data.raw_to_data import KEY, RawToData, read_map, read_range

__all__ = ["NOT_CALIBRATED", "WIDTH_MAP", "WidthMap", "read_width_map"]

WIDTH_MAP = "width_map"
"""The calibration item; its value states ``raw_to_data``, and may state ``range_m``."""
NOT_CALIBRATED = "width-not-calibrated"
"""Code of the quality note of a stream that was recorded without it."""


@dataclass(frozen=True, slots=True, eq=False)
class WidthMap(RawToData):
    """The map of a gripper from counts to metres, and what it holds for.

    Attributes
    ----------
    range_m : (float, float) or None
        The widths that it holds for, where that is less than all of it.
    """

    range_m: tuple[float, float] | None = None

    def widths(
        self, counts: npt.NDArray[Any], modulus: int | None
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Return widths, and which of them are out of the calibration's range.

        No reading depends on those before it. Beyond its ends the map says nothing: its end is
        held, and the width is out of range.

        Parameters
        ----------
        counts : (N,) int
        modulus : int, optional
            Where counts wrap.

        Returns
        -------
        widths : (N,) float32
            Metres.
        outside : (N,) bool
        """
        held, inside = self.held(counts, modulus)
        # As they are stored: a width at the very end of its range lies inside of it.
        widths = held.astype(np.float32)
        if self.range_m is not None:
            inside &= (widths >= self.range_m[0]) & (widths <= self.range_m[1])
        return widths, ~inside


def read_width_map(value: object, modulus: int | None = None) -> WidthMap | str:
    """Read the map out of a calibration item's value; a text says what is wrong with it.

    Parameters
    ----------
    value : object
    modulus : int, optional
        Where the counts wrap that it is for.
    """
    stated = read_map(value)
    if not isinstance(stated, RawToData):
        return f"it states no `{KEY}`" if stated is None else f"its `{KEY}` {stated}"
    beyond = stated.beyond_a_turn(modulus)
    if beyond is not None:
        return f"its `{KEY}` {beyond}"
    return WidthMap(stated.raw, stated.data, read_range(value))
