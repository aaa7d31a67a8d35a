"""Cases of signal quality: sync."""

from collections.abc import Iterator

import numpy as np

from corpus.bases import images_of
from corpus.case import EXUMI, Case, Finding, case
from corpus.draft import Draft

__all__ = ["grasp", "sync_cases", "tap"]

_MS = 1_000_000
_SIDE = 8
_LENGTH_MS = 2400
_CONTACT = 3000


def _opening(time_ms: np.ndarray) -> np.ndarray:
    """Return how far something soft is away, in 10 µm: it comes, presses from 3000 on, leaves."""
    # Parabolas, as integers: the same on every machine.
    way = np.minimum(np.maximum(time_ms - 300, 0), np.maximum(2100 - time_ms, 0))
    left = np.maximum(600 - way, 0)
    return 2750 + left * left // 200


def _active(time_ms: np.ndarray) -> np.ndarray:
    """Return how many of the 64 pixels are active."""
    depth = np.maximum(_CONTACT - _opening(time_ms), 0)
    return 60 * depth // (depth + 150)


def _touch(draft: Draft, late_ms: int, touches: int = 1, set_by_ms: int = 0) -> Draft:
    """Add a tactile stream of touches, whose times are late, from the second touch on by more."""
    time_ms = np.arange(10, touches * _LENGTH_MS, 33)
    active = _active(time_ms % _LENGTH_MS)
    late_ms = late_ms + np.where(time_ms >= _LENGTH_MS, set_by_ms, 0)
    place = np.arange(_SIDE * _SIDE)
    grain = (np.arange(len(time_ms))[:, None] * 5 + place * 3) % 7 // 3
    frames = (100 + grain + 60 * (place < active[:, None])).astype(np.uint8)
    names = ("time", "y", "x", "c")
    draft.stream(
        "tactile",
        "tactile",
        images=images_of("array", height=_SIDE, width=_SIDE, channels=1),
        reference={"method": "captured", "contact_free": True},
    )
    draft.put("streams/tactile/time", (time_ms + late_ms).astype(np.int64) * _MS)
    pixels = frames.reshape(-1, _SIDE, _SIDE, 1)
    draft.put("streams/tactile/data", pixels, names=names, chunk_rows=1, zstd=False)
    reference = np.full((_SIDE, _SIDE, 1), 101, dtype=np.uint8)
    draft.put("streams/tactile/reference", reference, names=("y", "x", "c"))
    draft.derive(
        "tactile/activity",
        (active / 64).astype(np.float32),
        names=("time",),
        algorithm="exumi-activity/1",
        parameters={"threshold": 5.828571428571429, "size": _SIDE, "active_above": 0.001},
        inputs=["streams/tactile/data", "streams/tactile/reference"],
    )
    return draft


def _add_width(draft: Draft, grasps: int, taps: int, late_ms: int = 0) -> None:
    """Add the width of a gripper that grasps, and rests meanwhile taps are made."""
    time_ms = np.arange(0, (grasps + taps) * _LENGTH_MS, 10)
    unrest = np.arange(len(time_ms)) * 7 % 3 - 1
    grasping = time_ms < grasps * _LENGTH_MS
    opening = np.where(grasping, _opening(time_ms % _LENGTH_MS), _opening(np.zeros(1, int)))
    draft.stream("width", "width")
    draft.put("streams/width/time", (time_ms + late_ms).astype(np.int64) * _MS)
    draft.put("streams/width/data", ((opening + unrest) / 100_000).astype(np.float32))


def _add_pose(draft: Draft, grasps: int, taps: int, late_ms: int = 0) -> None:
    """Add the pose of a hand that rests meanwhile grasps are made, and then taps."""
    time_ms = np.arange(0, (grasps + taps) * _LENGTH_MS, 14)
    tapping = time_ms >= grasps * _LENGTH_MS
    data = np.zeros((len(time_ms), 7))
    data[:, 0] = (np.arange(len(time_ms)) * 7 % 3 - 1) / 100_000
    way = np.where(tapping, _opening(time_ms % _LENGTH_MS), _opening(np.zeros(1, int)))
    data[:, 2] = way / 100_000
    data[:, 6] = 1.0
    draft.stream("pose", "pose", frames={"parent": "world", "child": "probe"})
    draft.put("streams/pose/time", (time_ms + late_ms).astype(np.int64) * _MS)
    draft.put("streams/pose/data", data, names=("time", "component"))


def grasp(late_ms: int) -> Draft:
    """Return an episode of one grasp whose tactile stream is late."""
    draft = _touch(Draft(regime="touch"), late_ms)
    _add_width(draft, 1, 0)
    return draft


def tap(late_ms: int) -> Draft:
    """Return an episode of one tap by a probe without fingers, whose pose is late."""
    embodiment = {"name": "probe", "gripper": "none"}
    draft = _touch(Draft(regime="touch", embodiment=embodiment), 0)
    _add_pose(draft, 0, 1, late_ms)
    return draft


def _grasp_and_tap(width_late_ms: int) -> Draft:
    """Return an episode of a grasp and a tap whose width is late."""
    draft = _touch(Draft(regime="touch"), 0, touches=2)
    _add_width(draft, 1, 1, width_late_ms)
    _add_pose(draft, 1, 1)
    return draft


def _clock_set(by_ms: int) -> Draft:
    """Return an episode of two grasps between which the tactile stream's clock is set."""
    draft = _touch(Draft(regime="touch"), 0, touches=2, set_by_ms=by_ms)
    _add_width(draft, 2, 0)
    return draft


def _clock(code: str, stream: str) -> Finding:
    return Finding(code, "zarr.json", f"{EXUMI}/streams/{stream}/clock")


def sync_cases() -> Iterator[Case]:
    """Return the cases."""
    yield case(
        "SYNC-001__tactile_late",
        "By a grasp, the tactile stream is 100 ms late.",
        grasp(100),
        _clock("SYNC-001", "tactile"),
    )
    yield case(
        "SYNC-001__tactile_early",
        "By a grasp, the tactile stream is 400 ms early.",
        grasp(-400),
        _clock("SYNC-001", "tactile"),
    )
    yield case(
        "SYNC-001__pose_late",
        "By a tap, the pose is 120 ms late.",
        tap(120),
        _clock("SYNC-001", "pose"),
    )
    yield case(
        "SYNC-002__tactile_late",
        "By a grasp, the tactile stream is 20 ms late.",
        grasp(20),
        _clock("SYNC-002", "tactile"),
    )
    yield case(
        "SYNC-001__width_late",
        "By a grasp and a tap, tactile stream and pose agree, and the width is 150 ms late.",
        _grasp_and_tap(150),
        _clock("SYNC-001", "width"),
    )
    yield case(
        "TIME-006__clock_set",
        "A clock that is set by 200 ms between two grasps: no gap, and no latency either.",
        _clock_set(200),
        Finding("TIME-006", "streams/tactile/time", index=73),
    )
