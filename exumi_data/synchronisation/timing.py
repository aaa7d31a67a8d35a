"""When a camera saw what its frame shows, and how well that is known.

A frame's rows are exposed one after the other (the readout), each for the exposure time; what a row
shows is of the middle of its exposure. Neither is in the frame's stamp.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["EXPOSURE_RANGE_S", "HEADSET_LAG_RANGE_S", "READOUT_RANGE_S", "CameraTiming", "Range"]

EXPOSURE_RANGE_S = (1e-3, 16e-3)
"""Exposure of a camera that does not say."""
READOUT_RANGE_S = (8e-3, 16e-3)
"""From the first row's readout to the last one's."""
HEADSET_LAG_RANGE_S = (0.0, 20e-3)
"""How far a headset's pose trails the hand: filter and prediction, which depend on the motion."""

_UNIFORM = math.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class Range:
    """A number that is known to lie between two others, every value as likely.

    Attributes
    ----------
    low, high : float
        The same where it is known.

    Raises
    ------
    ValueError
        They are negative, not finite or in the wrong order.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.low <= self.high < math.inf:
            msg = f"a range from {self.low} to {self.high}"
            raise ValueError(msg)

    @property
    def middle(self) -> float:
        """The best guess."""
        return 0.5 * (self.low + self.high)

    @property
    def sigma(self) -> float:
        """Standard deviation."""
        return (self.high - self.low) / _UNIFORM


@dataclass(frozen=True, slots=True)
class CameraTiming:
    """How a camera's stamps lie to what its frames show.

    Attributes
    ----------
    exposure_s, readout_s : Range
        Of one row; from the first row to the last.
    stamped : {"start", "end"}
        Whether a frame's stamp is that of the first row's exposure beginning, or of the last row's
        having been read out.
    known_sigma_s : float
        Standard deviation of what has been taken out of the stamps already.
    """

    exposure_s: Range = Range(*EXPOSURE_RANGE_S)
    readout_s: Range = Range(*READOUT_RANGE_S)
    stamped: Literal["start", "end"] = "start"
    known_sigma_s: float = 0.0

    def event_ns(self, stamp_ns: NDArray[np.int64], row: NDArray[np.floating]) -> NDArray[np.int64]:
        """Return when rows saw what they show.

        Parameters
        ----------
        stamp_ns : (N,) int64
        row : (N,) float
            Which row of the frame: 0 the first, 1 the last.

        Returns
        -------
        (N,) int64
        """
        exposure, readout = 0.5 * self.exposure_s.middle, self.readout_s.middle
        if self.stamped == "start":
            shift_s = exposure + readout * np.asarray(row)
        else:
            shift_s = -exposure - readout * (1.0 - np.asarray(row))
        return np.asarray(stamp_ns + np.rint(1e9 * shift_s).astype(np.int64), np.int64)

    def sigma_s(self, row: float) -> float:
        """Return the standard deviation of these moments, common to all frames; seconds.

        Parameters
        ----------
        row : float
            Mean row, 0 to 1.
        """
        lever = row if self.stamped == "start" else 1.0 - row
        return math.hypot(
            0.5 * self.exposure_s.sigma, lever * self.readout_s.sigma, self.known_sigma_s
        )
