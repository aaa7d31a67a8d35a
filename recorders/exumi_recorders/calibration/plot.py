"""The picture of a sweep: both curves as recorded, and with the value that is used."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.sweep import SweepResult

__all__ = ["draw_sweep", "draw_sweeps", "png"]

UInt8Array = NDArray[np.uint8]
Float64Array = NDArray[np.float64]

_WIDTH, _PANEL, _EDGE, _GAP = 1200, 250, 64, 46
_WHITE, _GREY, _LIGHT = (255, 255, 255), (110, 110, 110), (225, 225, 225)
# Blue and orange: told apart by everybody.
_MARKER, _POSE = (178, 114, 0), (0, 94, 213)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHOWN_S = 6.0


def draw_sweeps(results: Sequence[SweepResult], latency_ns: int) -> UInt8Array:
    """Draw sweeps of one session one below the other, all with the value that is used.

    Parameters
    ----------
    results : sequence of SweepResult
    latency_ns : int

    Returns
    -------
    (H, W, 3) uint8
        BGR.
    """
    images = [draw_sweep(result, latency_ns) for result in results]
    for number, image in enumerate(images if len(images) > 1 else [], start=1):
        _text(image, (_WIDTH // 2 - 60, _top(0) - 10), f"sweep {number} of {len(images)}")
    return np.concatenate(images)


def draw_sweep(result: SweepResult, latency_ns: int) -> UInt8Array:
    """Draw the marker against what the poses say it should be, before and after.

    Parameters
    ----------
    result : SweepResult
    latency_ns : int
        The value that is used: the item's, not what the fit said before it was rounded or averaged.

    Returns
    -------
    (H, W, 3) uint8
        BGR.
    """
    axis = int(result.explained.argmax())
    fit = result.curves.fitted(-latency_ns * 1e-9)
    if fit is None:
        msg = f"at {latency_ns} ns video and poses do not overlap"
        raise ValueError(msg)
    # One offset and trend for both panels: what differs is the shift alone.
    curve = result.curves.b @ fit.gains[:, axis]
    rest = result.marker.position_m[:, axis] - _at(result, curve, latency_ns)
    middle_ns = int(result.marker.time_ns.mean())
    trend = np.polyfit((result.marker.time_ns - middle_ns) * 1e-9, rest, 1)
    height = 3 * (_PANEL + _GAP) + 40
    image = np.full((height, _WIDTH, 3), 255, np.uint8)
    for number, shift_ns in enumerate((0, latency_ns)):
        _curves(image, _top(number), result, curve, trend, shift_ns)
    _profile(image, _top(2), result, latency_ns)
    return image


def _top(number: int) -> int:
    return 36 + number * (_PANEL + _GAP)


def _at(result: SweepResult, curve: Float64Array, shift_ns: int) -> Float64Array:
    return np.interp(result.marker.time_ns, result.pose.time_ns - shift_ns, curve)


def _curves(
    image: UInt8Array,
    top: int,
    result: SweepResult,
    curve: Float64Array,
    trend: Float64Array,
    shift_ns: int,
) -> None:
    """Draw one panel: marker as dots, poses as a line, shifted."""
    axis = int(result.explained.argmax())
    middle = int(result.marker.time_ns.mean())
    reach_ns = int(0.5 * _SHOWN_S * 1e9)
    marker_ns, marker = result.marker.time_ns, result.marker.position_m[:, axis]
    pose_ns = result.pose.time_ns - shift_ns
    pose = curve + np.polyval(trend, (pose_ns - middle) * 1e-9)
    seen = np.abs(marker_ns - middle) <= reach_ns
    shown = np.abs(pose_ns - middle) <= reach_ns
    low, high = float(marker[seen].min()), float(marker[seen].max())
    pad = 0.08 * max(high - low, 1e-3)
    low, high = low - pad, high + pad
    _frame(image, top)

    def place(time_ns: NDArray[np.int64], value: Float64Array) -> NDArray[np.int32]:
        x = _EDGE + (time_ns - middle + reach_ns) / (2 * reach_ns) * (_WIDTH - 2 * _EDGE)
        y = top + (high - value.clip(low, high)) / (high - low) * _PANEL
        return np.rint(np.stack([x, y], axis=1) * 16).astype(np.int32)

    points = place(pose_ns[shown], pose[shown]).reshape(-1, 1, 2)
    cv2.polylines(image, [points], False, _POSE, 2, cv2.LINE_AA, 4)
    for x, y in place(marker_ns[seen], marker[seen]):
        cv2.circle(image, (int(x), int(y)), 40, _MARKER, -1, cv2.LINE_AA, 4)
    apart = 1e3 * float(np.sqrt(np.mean((marker - _at(result, pose, shift_ns)) ** 2)))
    use = "refused, not used" if result.refusals else "as used"
    way = "earlier" if shift_ns > 0 else "later"
    said = "as recorded" if not shift_ns else f"poses {1e-6 * abs(shift_ns):.2f} ms {way}: {use}"
    _text(image, (_EDGE, top - 10), f"{said}   ({apart:.1f} mm apart, rms)")
    _text(image, (_WIDTH - _EDGE - 190, top - 10), "marker", _MARKER)
    _text(image, (_WIDTH - _EDGE - 90, top - 10), "poses", _POSE)
    for value in (low, high):
        y = top + 14 if value == high else top + _PANEL
        _text(image, (6, y), f"{1e3 * value:.0f} mm", size=0.42)
    for share in (0.0, 0.5, 1.0):
        seconds = (middle - int(result.marker.time_ns[0])) * 1e-9 + _SHOWN_S * (share - 0.5)
        x = _EDGE + round(share * (_WIDTH - 2 * _EDGE)) - 16
        _text(image, (x, top + _PANEL + 16), f"{seconds:.1f} s", size=0.42)


def _profile(image: UInt8Array, top: int, result: SweepResult, latency_ns: int) -> None:
    """Draw what each latency leaves, on a logarithmic scale."""
    known = np.isfinite(result.left)
    lags, left = result.lags_s[known], np.log10(np.maximum(result.left[known], 0.5))
    low, high = min(0.0, float(left.min())) - 0.05, float(left.max()) + 0.05
    _frame(image, top)

    def across(lag_s: float) -> float:
        share = (lag_s - float(lags[0])) / float(lags[-1] - lags[0])
        return _EDGE + share * (_WIDTH - 2 * _EDGE)

    y = top + (high - left) / (high - low) * _PANEL
    x = np.array([across(float(lag)) for lag in lags])
    points = np.rint(np.stack([x, y], axis=1)).astype(np.int32)
    cv2.polylines(image, [points.reshape(-1, 1, 2)], False, _GREY, 2, cv2.LINE_AA)
    used = round(across(latency_ns * 1e-9))
    cv2.line(image, (used, top), (used, top + _PANEL), _POSE, 2, cv2.LINE_AA)
    said = "what each latency leaves, in units of the least (logarithmic)"
    if result.runner_up_s is not None:
        second = round(across(result.runner_up_s))
        cv2.line(
            image, (second, top + _PANEL - 24), (second, top + _PANEL), _MARKER, 2, cv2.LINE_AA
        )
        said += f"; second best at {1e3 * result.runner_up_s:+.0f} ms: x{result.runner_up:.1f}"
    _text(image, (_EDGE, top - 10), said)
    for lag in (lags[0], latency_ns * 1e-9, lags[-1]):
        place = (round(across(float(lag))) - 30, top + _PANEL + 16)
        _text(image, place, f"{1e3 * lag:+.1f} ms", size=0.42)
    for value in (low, high):
        y_text = top + 14 if value == high else top + _PANEL
        _text(image, (6, y_text), f"x{10**value:.1f}", size=0.42)


def _frame(image: UInt8Array, top: int) -> None:
    cv2.rectangle(image, (_EDGE, top), (_WIDTH - _EDGE, top + _PANEL), _LIGHT, 1)


def _text(
    image: UInt8Array,
    place: tuple[int, int],
    text: str,
    colour: tuple[int, int, int] = _GREY,
    size: float = 0.5,
) -> None:
    cv2.putText(image, text, place, _FONT, size, colour, 1, cv2.LINE_AA)


def png(image: UInt8Array) -> bytes:
    """Return an image as a PNG file.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR.
    """
    _, file = cv2.imencode(".png", image)
    return bytes(file)
