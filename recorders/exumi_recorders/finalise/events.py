"""What the events of a journal say about its streams."""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from exumi_recorders.journal.reading import Block

__all__ = [
    "COUNTERS",
    "DEVICE_BACK",
    "DEVICE_LOST",
    "FROZEN",
    "POSE_JUMP",
    "REFERENCE",
    "STOPPED",
    "SUCCESS",
    "EventSummary",
    "read_events",
]

COUNTERS = "counters"
"""The recorder's own: what was lost of each stream so far, and how well it is stamped."""
DEVICE_LOST = "device_lost"
DEVICE_BACK = "device_back"
FROZEN = "frozen"
"""A pose has repeated itself for so long that it is not tracked: ``stream``."""
POSE_JUMP = "pose_jump"
"""A pose is further from the last one than a hand moves: ``port``, ``distance_m``."""
REFERENCE = "reference"
"""No contact between two host times: ``stream``, ``from_ns``, ``until_ns``."""
STOPPED = "stopped"
"""The recorder's own: until when it recorded; not there where it was ended otherwise."""
SUCCESS = "success"
"""Whether the task was done, as the operator says: ``value``; the last one holds."""
_MOST_KEPT = 500
# What the episode's document may hold of events, as its commas and brackets are counted.
_MOST_PARTS = 20_000
_MOST_PARTS_OF_ONE = 200
_DEEPEST = 16
_MOST_BYTES_OF_ONE = 16_384
_CAUSE = re.compile(r"[A-Za-z0-9_.:-]{1,64}")


@dataclass(slots=True)
class EventSummary:
    """What is left of the events.

    Attributes
    ----------
    world_frames : dict of str to list of (int, tuple of float)
        Of each device: host time and pose as it was sent, in order.
    counters : dict
        The last one.
    gone : dict of str to int
        Devices that were lost and did not come back, and since when.
    losses : dict of str to int
        How often each device was lost.
    frozen : dict of str to int
        How often each stream's pose was not tracked.
    jumps : dict of (str, str) to list of float
        Of each device's port, how far its pose has jumped, metres; the first ones.
    references : dict of str to (int, int)
        Of each stream, when nothing touched it: the last such time.
    stopped_ns : int or None
        Host time at which the recording was stopped.
    success : bool or None
        Whether the task was done; None where nobody said.
    kept : list of (int, str, str, dict)
        Host time, device, name and detail of the others, the first ones.
    unkept : int
        How many others there were beyond that.
    parts : int
        Commas and brackets of all of them.
    """

    world_frames: dict[str, list[tuple[int, tuple[float, ...]]]] = field(default_factory=dict)
    counters: dict[str, Any] = field(default_factory=dict)
    gone: dict[str, int] = field(default_factory=dict)
    losses: dict[str, int] = field(default_factory=dict)
    frozen: dict[str, int] = field(default_factory=dict)
    jumps: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    references: dict[str, tuple[int, int]] = field(default_factory=dict)
    stopped_ns: int | None = None
    success: bool | None = None
    kept: list[tuple[int, str, str, dict[str, Any]]] = field(default_factory=list)
    unkept: int = 0
    parts: int = 0

    def lost_of(self, stream: str) -> dict[str, int]:
        """Return what the recorder counted as lost of a stream, by cause.

        Parameters
        ----------
        stream : str
        """
        stated = _dict(_dict(self.counters.get("lost")).get(stream))
        found: dict[str, int] = {}
        for cause, number in stated.items():
            if isinstance(number, int) and not isinstance(number, bool) and number > 0:
                name = cause if _CAUSE.fullmatch(cause) else "other"
                found[name] = found.get(name, 0) + number
        return found

    def stamp_sigma_of(self, device: str) -> float | None:
        """Return how well the samples of a device are stamped, ns.

        Parameters
        ----------
        device : str
        """
        sigma = _dict(self.counters.get("stamp_sigma_ns")).get(device)
        if not isinstance(sigma, int | float) or isinstance(sigma, bool):
            return None
        return float(sigma) if np.isfinite(sigma) and sigma >= 0 else None


def read_events(blocks: Iterable[Block]) -> EventSummary:
    """Read the events' log; memory stays small, however many there are.

    Parameters
    ----------
    blocks : iterable of Block
    """
    summary = EventSummary()
    for block in blocks:
        for time_ns, payload in zip(block.time_host.tolist(), block.files, strict=True):
            try:
                document = json.loads(payload)
            except (ValueError, RecursionError):
                continue
            if isinstance(document, dict):
                _take(summary, time_ns, document, payload)
    return summary


def _take(summary: EventSummary, time_ns: int, document: dict[str, Any], payload: bytes) -> None:
    name, device = str(document.get("name", "")), str(document.get("device", ""))
    detail = _dict(document.get("detail"))
    if name == COUNTERS:
        summary.counters = detail
        return
    if name == STOPPED and not device:
        summary.stopped_ns = time_ns
        return
    if name == "world_frame":
        pose = _pose(detail.get("pose"))
        if pose is not None:
            frames = summary.world_frames.setdefault(device, [])
            if len(frames) < _MOST_KEPT and (not frames or frames[-1][1] != pose):
                frames.append((time_ns, pose))
    elif name == DEVICE_LOST:
        summary.gone[device] = time_ns
        summary.losses[device] = summary.losses.get(device, 0) + 1
    elif name == DEVICE_BACK:
        summary.gone.pop(device, None)
    elif name == REFERENCE:
        times = detail.get("from_ns"), detail.get("until_ns")
        if isinstance(times[0], int) and isinstance(times[1], int):
            summary.references[str(detail.get("stream", ""))] = times[0], times[1]
    elif name == SUCCESS and isinstance(detail.get("value"), bool):
        summary.success = detail["value"]
    else:
        _take_tracking(summary, name, device, detail)
    parts = sum(map(payload.count, (b",", b"[", b"{")))
    summary.parts += parts
    if len(summary.kept) >= _MOST_KEPT or summary.parts > _MOST_PARTS:
        summary.unkept += 1
        return
    fits = parts <= _MOST_PARTS_OF_ONE and len(payload) <= _MOST_BYTES_OF_ONE
    kept = (device, name, detail) if fits and _is_plain(document) else ("", "unreadable", {})
    summary.kept.append((time_ns, *kept))


def _take_tracking(summary: EventSummary, name: str, device: str, detail: dict[str, Any]) -> None:
    if name == FROZEN:
        stream = str(detail.get("stream", ""))
        summary.frozen[stream] = summary.frozen.get(stream, 0) + 1
    elif name == POSE_JUMP:
        distance_m = detail.get("distance_m")
        jumps = summary.jumps.setdefault((device, str(detail.get("port", ""))), [])
        if isinstance(distance_m, float) and len(jumps) < _MOST_KEPT:
            jumps.append(distance_m)


def _is_plain(document: dict[str, Any]) -> bool:
    """Whether a document of JSON can hold it: no NaN, no half of a letter, not too deep."""
    try:
        json.dumps(document, ensure_ascii=False, allow_nan=False).encode()
    except (ValueError, RecursionError):
        return False
    return _depth(document) <= _DEEPEST


def _depth(value: object) -> int:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + max(map(_depth, inner), default=0)


def _dict(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _pose(value: object) -> tuple[float, ...] | None:
    """Return seven finite numbers with a quaternion that is not zero."""
    if not isinstance(value, list) or len(value) != 7:
        return None
    if not all(isinstance(x, int | float) and not isinstance(x, bool) for x in value):
        return None
    pose = tuple(float(x) for x in value)
    norm = float(np.linalg.norm(pose[3:]))
    return pose if np.isfinite(pose).all() and norm > 1e-6 else None
