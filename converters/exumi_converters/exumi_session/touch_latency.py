"""By how much the hub's stamps of tactile frames are late: from grasps, against the encoder.

The hub stamps a frame before it asks the camera for it, so nothing about poses tells of this. A few
grasps of the session are decoded; the reference is made of their own quiet frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_converters.exumi_session.hub import StampedChunk
from exumi_converters.exumi_session.tables import read_stamps
from exumi_data.errors import ExumiError
from exumi_data.store.video import FramePixels, VideoDecoder
from exumi_data.synchronisation import LatencyEstimate, estimate_touch_latency
from exumi_data.tactile import ActivityMeter, choose_reference, reference_image, thumbnail
from exumi_data.time import strictly_increasing

__all__ = ["grasps", "touch_late"]

Int64Array = NDArray[np.int64]
Float64Array = NDArray[np.float64]
UInt8Array = NDArray[np.uint8]

_CLOSING_M = 5e-3
_MOST_GRASP_NS = 12_000_000_000
_AROUND_NS = 900_000_000
_MOST_GRASPS = 10
_MOST_SIGMA_S = 0.02
_FEWEST = 2
_MOST_FRAMES = 2400
_KEPT_PX = 40_000


def grasps(time_ns: Int64Array, width_m: Float64Array) -> list[tuple[int, int]]:
    """Find when a gripper closes and opens again, (start, stop) with some time around.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    width_m : (N,) float64
        NaN where it is not known.
    """
    known = np.isfinite(width_m)
    time, width = time_ns[known], width_m[known]
    found: list[tuple[int, int]] = []
    if len(width) < 3:
        return found
    high = low = float(width[0])
    closed_at: int | None = None
    top_at = int(time[0])
    for at, now in zip(time.tolist(), width.tolist(), strict=True):
        if closed_at is None:
            if now >= high:
                high, top_at = now, at
            elif high - now > _CLOSING_M:
                closed_at, low = top_at, now
        elif now <= low:
            low = now
        elif now - low > _CLOSING_M:
            if at - closed_at <= _MOST_GRASP_NS:
                found.append((closed_at - _AROUND_NS, at + _AROUND_NS))
            closed_at, high, top_at = None, now, at
    return found


@dataclass(slots=True)
class _Frames:
    """Small grey frames of some grasps, with their stamps."""

    time_ns: list[int]
    grey: list[UInt8Array]


def touch_late(
    chunks: Sequence[StampedChunk],
    spans: Sequence[tuple[int, int]],
    epoch_ns: int,
    width_ns: Int64Array,
    width_m: Float64Array,
) -> LatencyEstimate | None:
    """Estimate the latency of a finger's stamps.

    Parameters
    ----------
    chunks : sequence of StampedChunk
    spans : sequence of (int, int)
        Grasps, in the session's time; some of them are looked at.
    epoch_ns : int
        Unix time of the session's second 0.
    width_ns : (N,) int64
        In the session's time.
    width_m : (N,) float64

    Returns
    -------
    LatencyEstimate or None
        None where too few grasps tell.
    """
    if not spans:
        return None
    chosen = np.unique(np.linspace(0, len(spans) - 1, _MOST_GRASPS).round().astype(int))
    frames = _Frames([], [])
    for index in chosen.tolist():
        if len(frames.grey) >= _MOST_FRAMES:
            break
        _collect(chunks, spans[index], epoch_ns, frames)
    if len(frames.grey) < 8:
        return None
    choice = choose_reference([thumbnail(grey) for grey in frames.grey])
    meter = ActivityMeter(reference_image([frames.grey[i][..., None] for i in choice.frames]))
    activity = np.array([meter.measure(grey) for grey in frames.grey], np.float64)
    known = np.isfinite(width_m)
    found = estimate_touch_latency(
        np.array(frames.time_ns, np.int64), activity, width_ns[known], width_m[known]
    )
    if found is None or found.n_events < _FEWEST or found.sigma_s > _MOST_SIGMA_S:
        return None
    return found


def _collect(
    chunks: Sequence[StampedChunk], span: tuple[int, int], epoch_ns: int, frames: _Frames
) -> None:
    """Decode the frames of a span, each stamp once."""
    pixels = FramePixels()
    for piece in chunks:
        if not piece.holds(span[0] + epoch_ns, span[1] + epoch_ns):
            continue
        video = piece.chunk.video
        assert video is not None  # noqa: S101  # chunks of fingers have one
        try:
            stamps, _ = strictly_increasing(read_stamps(piece.chunk.table) - epoch_ns)
            with VideoDecoder(str(video), video) as decoder:
                for stamp, frame in zip(stamps.tolist(), decoder.frames(), strict=False):
                    if stamp > span[1]:
                        break
                    last = frames.time_ns[-1] if frames.time_ns else -(1 << 62)
                    # A repeated frame was nudged by a nanosecond: it tells nothing new.
                    if stamp < span[0] or stamp - last < 1000:
                        continue
                    grey = _small(pixels.grey(frame))
                    if frames.grey and grey.shape != frames.grey[0].shape:
                        break
                    frames.time_ns.append(stamp)
                    frames.grey.append(grey)
        except (ExumiError, ValueError, OSError):
            continue  # converting says what is the matter with it


def _small(grey: UInt8Array) -> UInt8Array:
    """Return a frame of few pixels: what touches is large."""
    import cv2

    height, width = grey.shape
    scale = min(1.0, (_KEPT_PX / (height * width)) ** 0.5)
    if scale == 1.0:
        return grey.copy()
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
