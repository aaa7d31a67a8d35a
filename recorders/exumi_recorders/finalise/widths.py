"""From an encoder's counts to the width of a gripper."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["WIDTH_MAP", "WidthMap", "read_width_map"]

WIDTH_MAP = "width_map"
"""The calibration item; its value states ``raw_to_data``, and may state ``range_m``."""


@dataclass(frozen=True, slots=True, eq=False)
class WidthMap:
    """Points of a map that is linear between them (spec: Calibration, CAL-005).

    Attributes
    ----------
    raw : (K,) float64
        Counts, ascending, going on over the wrap.
    data : (K,) float64
        Widths, metres.
    range_m : (float, float) or None
        The widths that it holds for, where that is less than all of it.
    """

    raw: npt.NDArray[np.float64]
    data: npt.NDArray[np.float64]
    range_m: tuple[float, float] | None = None

    def widths(
        self, counts: npt.NDArray[Any], modulus: int | None
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Return widths, and which counts lie outside of the calibration.

        A count stands for the number equal to it modulo `modulus` that lies nearest to the middle
        of the map, so that no reading depends on those before it. Beyond the ends the map goes on
        in a straight line.

        Parameters
        ----------
        counts : (N,) int
        modulus : int, optional
            Where counts wrap.
        """
        raw = np.asarray(counts, np.float64)
        if modulus is not None:
            middle = (self.raw[0] + self.raw[-1]) / 2
            raw = raw - modulus * np.floor((raw - middle) / modulus + 0.5)
        widths = np.interp(raw, self.raw, self.data)
        below, above = raw < self.raw[0], raw > self.raw[-1]
        widths[below] = _line(raw[below], self.raw[:2], self.data[:2])
        widths[above] = _line(raw[above], self.raw[-2:], self.data[-2:])
        outside = below | above
        if self.range_m is not None:
            # As they are stored: a width at the very end of its range lies inside of it.
            stored = widths.astype(np.float32)
            outside |= (stored < self.range_m[0]) | (stored > self.range_m[1])
        return widths, outside


def _line(
    at: npt.NDArray[np.float64], raw: npt.NDArray[np.float64], data: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    slope = (data[1] - data[0]) / (raw[1] - raw[0])
    return np.asarray(data[0] + slope * (at - raw[0]))


def read_width_map(value: object) -> WidthMap | str:
    """Read the map out of a calibration item's value; a text says what is wrong with it.

    Parameters
    ----------
    value : object
    """
    stated = value.get("raw_to_data") if isinstance(value, Mapping) else None
    if not isinstance(stated, Mapping):
        return "it states no `raw_to_data`"
    try:
        raw, data = (np.array(stated[name], np.float64) for name in ("raw", "data"))
    except (KeyError, TypeError, ValueError):
        return "`raw_to_data` has no `raw` and `data`, lists of numbers"
    if raw.ndim != 1 or raw.shape != data.shape or len(raw) < 2:
        return "`raw` and `data` are not two lists of one length, two at least"
    if not (np.isfinite(raw).all() and np.isfinite(data).all() and (np.diff(raw) > 0).all()):
        return "`raw` does not ascend, or a number is not finite"
    return WidthMap(raw, data, _range(value))


def _range(value: object) -> tuple[float, float] | None:
    stated = value.get("range_m") if isinstance(value, Mapping) else None
    if not isinstance(stated, list) or len(stated) != 2:
        return None
    lowest, highest = stated
    if not isinstance(lowest, int | float) or not isinstance(highest, int | float):
        return None
    return float(lowest), float(highest)
