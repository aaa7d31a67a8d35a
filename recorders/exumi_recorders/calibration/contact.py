"""Latency of touch and images by closing on something rigid, against the encoder.

When the gripper closes on a rigid object and opens again, the gel shows what the width does, and
the camera on the wrist sees the fingers move. The encoder is read in no time, so its width is what
the others are compared with; what is found is added to the latency that a stream had.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.model.description import CalibrationItem
from exumi_data.synchronisation import estimate_touch_latency, find_touches
from exumi_recorders.calibration.finger_motion import METHOD, finger_lag

__all__ = [
    "ContactLatency",
    "contact_item",
    "encoder_stops",
    "image_latency",
    "touch_latency",
]

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

_FEWEST_TOUCHES = 3
_MOST_SIGMA_S = 0.02
_STOP_SPEED_M_PER_S = 2e-3
_LEAST_CLOSING_M = 5e-3
_STOP_S = 0.15
_LEAST_STREAM = 8
# A touch begins about when the encoder stops: of another stop otherwise.
_SAME_TOUCH_S = 0.5


@dataclass(frozen=True, slots=True)
class ContactLatency:
    """By how much a stream is late, by its stamps.

    Attributes
    ----------
    latency_s : float
    sigma_s : float
    events : int
        Touches; 1 for an image, which is compared as a whole.
    method : str
    onset_s : float or None
        From where the encoder stopped to where the stream's touch began, median over the touches,
        by the stamps: what simple methods take for the latency. It is shorter by the time that the
        gel takes to be pressed in.
    """

    latency_s: float
    sigma_s: float
    events: int
    method: str
    onset_s: float | None = None


def encoder_stops(time_ns: Int64Array, width_m: NDArray[np.floating]) -> Int64Array:
    """Find the moments at which a closing gripper came to a stop.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    width_m : (N,) float
        Metres.

    Returns
    -------
    (K,) int64
        Nanoseconds.
    """
    if len(time_ns) < _LEAST_STREAM:
        return np.zeros(0, np.int64)
    period_s = float(np.median(np.diff(time_ns))) * 1e-9
    smooth = max(1, round(0.02 / period_s))
    kernel = np.ones(smooth) / smooth
    width = np.convolve(np.pad(width_m, smooth, mode="edge"), kernel, "same")[smooth:-smooth]
    speed = np.gradient(width, time_ns * 1e-9)
    closing = speed < -_STOP_SPEED_M_PER_S
    edges = np.flatnonzero(np.diff(np.concatenate(([False], closing, [False])).astype(np.int8)))
    stops = []
    for start, end in edges.reshape(-1, 2):
        stays = np.searchsorted(time_ns, time_ns[min(end, len(width) - 1)] + int(_STOP_S * 1e9))
        rest = speed[end : int(stays)]
        if (
            width[start] - width[end - 1] >= _LEAST_CLOSING_M
            and len(rest)
            and (np.abs(rest) < 4 * _STOP_SPEED_M_PER_S).all()
        ):
            stops.append(int(time_ns[end - 1]))
    return np.array(stops, np.int64)


def touch_latency(
    tactile_ns: Int64Array,
    activity: NDArray[np.floating],
    width_ns: Int64Array,
    width_m: NDArray[np.floating],
) -> ContactLatency:
    """Estimate the latency of a tactile stream by its stamps.

    Parameters
    ----------
    tactile_ns : (N,) int64
        Stamps, strictly increasing.
    activity : (N,) float
        Share of active pixels.
    width_ns : (M,) int64
        Times of the widths, their own latency taken out.
    width_m : (M,) float
        Metres.

    Returns
    -------
    ContactLatency

    Raises
    ------
    CalibrationRefusedError
        Too few grasps tell, or they tell too little.
    """
    touches = find_touches(tactile_ns, activity)
    found = estimate_touch_latency(tactile_ns, activity, width_ns, width_m)
    if found is None or found.n_events < _FEWEST_TOUCHES:
        told = 0 if found is None else found.n_events
        raise CalibrationRefusedError(
            f"{told} of {len(touches)} touches tell the latency, needed are {_FEWEST_TOUCHES}",
            fix="Close on something rigid ten times, slowly, and open again until nothing is "
            "touched.",
        )
    _check_sigma(found.sigma_s)
    stops = encoder_stops(width_ns, width_m)
    onsets = np.array([tactile_ns[touch.first] for touch in touches], np.int64)
    onset = None
    if len(stops) and len(onsets):
        nearest = stops[np.abs(stops[None] - onsets[:, None]).argmin(axis=1)]
        apart = (onsets - nearest) * 1e-9
        apart = apart[np.abs(apart) <= _SAME_TOUCH_S]
        onset = float(np.median(apart)) if len(apart) >= _FEWEST_TOUCHES else None
    return ContactLatency(found.offset_s, found.sigma_s, found.n_events, found.method, onset)


def _check_sigma(sigma_s: float) -> None:
    if sigma_s > _MOST_SIGMA_S:
        raise CalibrationRefusedError(
            f"the latency is known to {1e3 * sigma_s:.0f} ms only, needed are "
            f"{1e3 * _MOST_SIGMA_S:.0f}",
            fix="Close and open at the same slow pace; take something that does not give way.",
        )


def image_latency(
    frame_ns: Int64Array,
    energy: NDArray[np.floating],
    width_ns: Int64Array,
    width_m: NDArray[np.floating],
) -> ContactLatency:
    """Estimate the latency of a camera that sees the fingers move, by its stamps.

    Parameters
    ----------
    frame_ns : (N,) int64
        Stamps, strictly increasing.
    energy : (N - 1,) float
        By how much each frame differs from the one before it.
    width_ns : (M,) int64
        Times of the widths, their own latency taken out.
    width_m : (M,) float
        Metres.

    Returns
    -------
    ContactLatency

    Raises
    ------
    CalibrationRefusedError
        The images do not tell: the camera itself moved, or does not see the fingers.
    """
    if len(frame_ns) < _LEAST_STREAM or len(width_ns) < _LEAST_STREAM:
        raise CalibrationRefusedError("too few frames or widths")
    found = finger_lag(frame_ns, energy, width_ns, width_m)
    if found is None:
        raise CalibrationRefusedError(
            "the images do not show when the fingers move",
            fix="Hold the hand still while the gripper closes and opens, ten times at uneven "
            "intervals, with the fingers in sight.",
        )
    _check_sigma(found.sigma_s)
    # A frame shows the middle of its exposure, which the latency then holds; nothing is added.
    return ContactLatency(found.lag_s, found.sigma_s, 1, METHOD)


def contact_item(found: ContactLatency, *, width_sigma_s: float = 0.0) -> CalibrationItem:
    """Make the item ``latency/<stream>``.

    Parameters
    ----------
    found : ContactLatency
    width_sigma_s : float, optional
        How well the latency of the width is known, seconds.
    """
    said = f"{found.events} grasps against the encoder's width"
    if found.onset_s is not None:
        said += (
            f"; touch begins {1e3 * found.onset_s:+.1f} ms after the encoder stops, by the stamps"
        )
    if found.events == 1:
        said = "motion of the fingers in the images against the speed of the width"
    return CalibrationItem(
        value=round(found.latency_s * 1e9),
        unit="ns",
        uncertainty=round(math.hypot(found.sigma_s, width_sigma_s) * 1e9),
        method=found.method,
        procedure=said,
    )
