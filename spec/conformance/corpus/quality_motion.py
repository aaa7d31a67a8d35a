"""Cases of signal quality: motion."""

from collections.abc import Iterator

import numpy as np

from corpus import bases
from corpus.case import Case, Finding, case
from corpus.draft import Draft

__all__ = ["motion_cases"]

POSE = "streams/pose/data"
WIDTH = "streams/width/data"
STEP_NS = 20_000_000
TURNED = (0.0, 0.0, 0.28, 0.96)  # by 32.5 degrees


def _slow(count: int) -> np.ndarray:
    """Return poses that move by 1 mm a step, which is 5 cm/s."""
    poses = np.zeros((count, 7))
    poses[:, 0], poses[:, 6] = np.arange(count) / 1000, 1
    return poses


def _track(poses: np.ndarray) -> Draft:
    draft = Draft()
    stream = draft.stream("pose", "pose", frames={"parent": "world", "child": "gripper"})
    stream["clock"] = {"source": "hub_monotonic", "stamp_point": "kernel_rx"}
    draft.put("streams/pose/time", bases.times(len(poses), STEP_NS))
    draft.put(POSE, poses, names=("time", "component"))
    return draft


def _pose_cases() -> Iterator[Case]:
    poses = _slow(20)
    poses[11, 1] = 1.0
    at = Finding("POSE-003", POSE, index=11)
    yield case("POSE-003__glitch", "One pose a metre off, and back.", _track(poses), at)
    poses = _slow(20)
    poses[:, 0] *= 1000
    at = Finding("POSE-003", POSE, index=1)
    yield case("POSE-003__millimetres", "Millimetres in place of metres.", _track(poses), at)
    poses = _slow(20)
    poses[11, 3:] = TURNED
    at = Finding("POSE-003", POSE, index=11)
    yield case("POSE-003__turned_glitch", "One pose turned, and back.", _track(poses), at)
    poses = _slow(20)
    poses[12:, 1] += 0.25
    at = Finding("POSE-004", POSE, index=12)
    yield case("POSE-004__moved", "A world that moves by 25 cm.", _track(poses), at)
    poses = _slow(20)
    poses[12:, 3:] = TURNED
    at = Finding("POSE-004", POSE, index=12)
    yield case("POSE-004__turned", "A world that turns by 33 degrees.", _track(poses), at)
    poses = _slow(60)
    poses[10:45] = poses[10]
    at = Finding("POSE-005", POSE, index=10)
    yield case("POSE-005__leaps", "Tracking that hangs, and goes on elsewhere.", _track(poses), at)
    poses = _slow(60)
    poses[:, 0] *= 10
    poses[30:] = poses[30]
    at = Finding("POSE-005", POSE, index=30)
    yield case("POSE-005__to_the_end", "Tracking that is lost for good.", _track(poses), at)


def _counts(values: np.ndarray, *, modulus: int | None = 1024) -> Draft:
    """Return counts of 0.1 mm, and widths that are made of them without unwrapping."""
    draft = Draft()
    value = {"m_per_count": 0.0001, "zero": 0, "range_m": [0.0, 0.1024]}
    draft.metadata["calibration"] = {"encoder": {"value": value, "method": "by gauge blocks"}}
    raw = {"unit": "count", "transform": "encoder"}
    draft.stream("width", "width", raw=raw if modulus is None else {**raw, "modulus": modulus})
    draft.put("streams/width/time", bases.times(len(values), 5_000_000))
    draft.put(WIDTH, (values * 0.0001).astype(np.float32))
    draft.put("streams/width/raw", values.astype(np.uint16))
    return draft


def _width_cases() -> Iterator[Case]:
    turning = (900 + 10 * np.arange(24)) % 1024
    at = Finding("WIDTH-003", WIDTH, index=13)
    about = "A width that falls to zero where the counts wrap."
    yield case("WIDTH-003__wrapped", about, _counts(turning), at)
    about = "Counts that wrap, of which nobody says where."
    yield case("WIDTH-003__unknown_modulus", about, _counts(turning, modulus=None), at)
    opening = 100 + 10 * np.arange(24)
    draft = _counts(opening)
    draft.metadata["calibration"]["encoder"]["value"]["range_m"] = [0.0, 0.03]
    at = Finding("WIDTH-004", WIDTH, index=21)
    yield case("WIDTH-004__not_flagged", "A width that was never calibrated.", draft, at)
    opening[7] = 0
    draft = _counts(opening)
    at = Finding("WIDTH-005", WIDTH, index=7)
    yield case("WIDTH-005__one_zero", "A reading that failed.", draft, at)


def motion_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from _pose_cases()
    yield from _width_cases()
