"""Latency between streams, estimated from what they say of the same events.

All functions take plain arrays, times in int64 nanoseconds, and return a `LatencyEstimate`: by how
much the first curve is late, with its uncertainty, or None where the data does not tell.

- `estimate_touch_latency`: tactile activity against the gripper's width, by grasps.
- `estimate_tap_latency`: tactile activity against a position, by taps.
- `search_lag`: any curve against another one, by trying lags.
"""

from exumi_data.synchronisation.curves import search_lag
from exumi_data.synchronisation.estimate import LatencyEstimate, combine
from exumi_data.synchronisation.events import (
    Touch,
    find_touches,
    holding_time_s,
    still_touches,
)
from exumi_data.synchronisation.taps import estimate_tap_latency
from exumi_data.synchronisation.touches import estimate_touch_latency

__all__ = [
    "LatencyEstimate",
    "Touch",
    "combine",
    "estimate_tap_latency",
    "estimate_touch_latency",
    "find_touches",
    "holding_time_s",
    "search_lag",
    "still_touches",
]
