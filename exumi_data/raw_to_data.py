"""The map that a calibration states from a device's own values to data."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

__all__ = ["KEY", "RawToData", "read_map", "read_range"]

KEY = "raw_to_data"
"""Where a calibration item's `value` states it."""

_RANGE = "range_m"
_FEWEST = 2


@dataclass(frozen=True, slots=True, eq=False)
class RawToData:
    """Points of a map that is linear between them.

    Attributes
    ----------
    raw : (K,) float64
        The device's own values, ascending.
    data : (K,) float64
        What they stand for.
    """

    raw: npt.NDArray[np.float64]
    data: npt.NDArray[np.float64]

    @property
    def span(self) -> float:
        """How far apart the highest and the lowest value of `data` are."""
        return float(np.ptp(self.data))

    def beyond_a_turn(self, modulus: int | None) -> str | None:
        """Return what is wrong with the map where counts wrap; None where nothing is.

        Parameters
        ----------
        modulus : int, optional
            Where they wrap.
        """
        counts = self.raw[-1] - self.raw[0]
        if modulus is None or counts <= modulus:
            return None
        return f"goes over {counts:.0f} counts, which begin anew after {modulus}"

    def at(self, values: np.ndarray, modulus: int | None = None) -> npt.NDArray[np.float64]:
        """Return what values stand for.

        Parameters
        ----------
        values : (N,) numbers
            Of the device.
        modulus : int, optional
            Where they wrap: each then stands for the number equal to it modulo `modulus` that is
            nearest to the middle of the map.

        Returns
        -------
        (N,) float64
            NaN beyond the map's ends, and everywhere where the map is `beyond_a_turn`.
        """
        raw = self._turned(values, modulus)
        return np.asarray(np.interp(raw, self.raw, self.data, left=np.nan, right=np.nan))

    def held(
        self, values: np.ndarray, modulus: int | None = None
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Return what values stand for, and hold the map's ends beyond them.

        Parameters
        ----------
        values : (N,) numbers
            Of the device.
        modulus : int, optional
            As for `at`.

        Returns
        -------
        data : (N,) float64
        inside : (N,) bool
            False beyond the map's ends.
        """
        raw = self._turned(values, modulus)
        inside = (raw >= self.raw[0]) & (raw <= self.raw[-1])
        return np.asarray(np.interp(raw, self.raw, self.data)), inside

    def _turned(self, values: np.ndarray, modulus: int | None) -> npt.NDArray[np.float64]:
        """Return values at the turn of the map, where they wrap."""
        raw = values.astype(np.float64)
        if self.beyond_a_turn(modulus) is not None:
            return np.full_like(raw, np.nan)  # a count stands for several numbers
        if modulus is not None:
            middle = (self.raw[0] + self.raw[-1]) / 2
            raw -= modulus * np.floor((raw - middle) / modulus + 0.5)
        return raw


def read_map(value: object) -> RawToData | str | None:
    """Read the map out of a calibration item's `value`.

    Parameters
    ----------
    value : object

    Returns
    -------
    RawToData, str or None
        What is wrong with it, where it is no map; None where none is stated.
    """
    stated = value.get(KEY) if isinstance(value, dict) else None
    if stated is None:
        return None
    if not isinstance(stated, dict):
        return "is not an object"
    lists = {}
    for name in ("raw", "data"):
        numbers = _numbers(stated.get(name))
        if numbers is None:
            return f"has no `{name}`, a list of finite numbers"
        lists[name] = numbers
    raw, data = lists["raw"], lists["data"]
    if len(raw) != len(data) or len(raw) < _FEWEST:
        return f"has {len(raw)} numbers in `raw` and {len(data)} in `data`"
    if any(after <= before for before, after in pairwise(raw)):
        return "has a `raw` that does not ascend"
    return RawToData(np.array(raw), np.array(data))


def read_range(value: object) -> tuple[float, float] | None:
    """Read the range of widths that a calibration holds for out of its item's `value`.

    Parameters
    ----------
    value : object

    Returns
    -------
    (float, float) or None
        Lowest and highest, metres; None where none is stated, or what is stated is no range.
    """
    stated = _numbers(value.get(_RANGE)) if isinstance(value, dict) else None
    if stated is None or len(stated) != 2 or stated[0] > stated[1]:
        return None
    return stated[0], stated[1]


def _numbers(value: object) -> list[float] | None:
    if not isinstance(value, list) or not all(type(x) in (int, float) for x in value):
        return None
    try:
        numbers = [float(x) for x in value]
    except OverflowError:
        return None
    return numbers if np.isfinite(numbers).all() else None
