"""Tactile activity against the position of the hand, by taps.

When a hand with its gripper at rest presses a pad against something and leaves again, the gel is
pressed in as the hand goes on, and comes back as it returns. That is a grasp with the way of the
hand in the place of the width.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.estimate import LatencyEstimate, combine
from exumi_data.synchronisation.events import Touch
from exumi_data.synchronisation.touches import touch_delay

__all__ = ["TAP_METHOD", "estimate_tap_latency"]

TAP_METHOD = "exumi-tap-latency/1"

_MOST_TAPS = 32
_AROUND_NS = 150_000_000
# A hand gives way and turns as it presses.
_FLOOR_S = 5e-3


def estimate_tap_latency(
    tactile_ns: NDArray[np.int64],
    activity: NDArray[np.floating],
    position_ns: NDArray[np.int64],
    position_m: NDArray[np.floating],
    taps: Sequence[Touch],
) -> LatencyEstimate | None:
    """Estimate by how much tactile activity is late relative to a position.

    Parameters
    ----------
    tactile_ns : (N,) int64
        Strictly increasing.
    activity : (N,) float
        Share of active pixels, 0 to 1.
    position_ns : (M,) int64
        Strictly increasing, of the same clock.
    position_m : (M, 3) float
        Metres.
    taps : sequence of Touch
        Touches of this activity during which the gripper did not move.

    Returns
    -------
    LatencyEstimate or None
        None where no tap tells.
    """
    if not taps or len(position_ns) < 2:
        return None
    chosen = np.unique(np.linspace(0, len(taps) - 1, _MOST_TAPS).round().astype(int))
    found: list[LatencyEstimate | None] = []
    for tap in (taps[i] for i in chosen):
        way = _way_m(tactile_ns, position_ns, position_m, tap)
        delay = None
        if way is not None:
            delay = touch_delay(tactile_ns, activity, position_ns, way, tap)
        found.append(delay)
    return combine(found, floor_s=_FLOOR_S, method=TAP_METHOD)


def _way_m(
    tactile_ns: NDArray[np.int64],
    position_ns: NDArray[np.int64],
    position_m: NDArray[np.floating],
    tap: Touch,
) -> NDArray[np.float64] | None:
    """Return the position along the direction of the tap, growing away from what is tapped."""
    edges = tactile_ns[[tap.first, tap.last]] + np.array([-_AROUND_NS, _AROUND_NS])
    start, stop = np.searchsorted(position_ns, edges)
    if stop - start < 4:
        return None
    near = position_m[start:stop]
    pressed = near[(stop - start) // 3 : -((stop - start) // 3)].mean(axis=0)
    away = 0.5 * (near[0] + near[-1]) - pressed
    length = float(np.linalg.norm(away))
    if length == 0.0:
        return None
    return np.asarray(position_m @ (away / length), dtype=np.float64)
