"""Where the tool is on the hand, with the operator led from pose to pose; nothing is recorded.

What does not tell is said at once, and done again: the tip held at a point while the hand turns,
and, where its orientation is wanted, the tool at rest in a jig.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.errors import UsageError
from exumi_data.standard import flags
from exumi_recorders.calibration.controller import Aligned, Pivot, aligned, pivot
from exumi_recorders.calibration.live import LivePort, ports_of
from exumi_recorders.contract import Event, Rows, Sample
from exumi_recorders.finalise.poses import IDENTITY, to_world
from exumi_recorders.finalise.rows import row_dtype
from exumi_recorders.rig.model import Rig

__all__ = ["LivePoses", "guided_jig", "guided_tip", "poses_of"]

Ask = Callable[[str], str]
Tell = Callable[[str], None]
Float64Array = NDArray[np.float64]

_READ_S = 0.05
_TURN_S, _REST_S = 10.0, 2.0
_HEADSET = "headset"


def poses_of(rig: Rig, stream: str | None) -> LivePort:
    """Return the port of the hand's poses.

    Parameters
    ----------
    rig : Rig
    stream : str or None
        Which stream, where there are several hands.

    Raises
    ------
    UsageError
        There is none, or more than one.
    """
    found = [
        port
        for port in ports_of(rig, lambda port: port.kind == "pose" and port.name != _HEADSET)
        if stream in (None, port.stream)
    ]
    if len(found) != 1:
        named = ", ".join(port.stream for port in found) or "none"
        raise UsageError(f"which poses: {named}", where=rig.path, fix="Name them with --pose.")
    return found[0]


class LivePoses:
    """Reads the poses of an open device in the world that is marked, the newest mark.

    Parameters
    ----------
    port : LivePort
        Open.

    Attributes
    ----------
    has_world : bool
        Whether the world is known that poses are given in. The tip's place on the hand is the same
        in any.
    """

    def __init__(self, port: LivePort) -> None:
        self._port = port
        self._moved = port.port.transform == "world_frame"
        self._world: Sequence[float] = IDENTITY
        self.has_world = not self._moved

    def read(self, seconds: float) -> Float64Array:
        """Return the valid poses that are stamped from now on.

        Parameters
        ----------
        seconds : float

        Returns
        -------
        (N, 7) float64
            Metres and unit quaternions xyzw.

        Raises
        ------
        DeviceLostError
            The device is gone.
        """
        start_ns = time.monotonic_ns()
        stop_ns = start_ns + round(seconds * 1e9)
        invalid = flags()["invalid"].mask
        payload = []
        while time.monotonic_ns() < stop_ns:
            for item in self._port.driver.read(_READ_S):
                if isinstance(item, Event):
                    self._hear(item)
                elif self._is_wanted(item, start_ns) and not item.flags & invalid:
                    payload.append(item.payload)
        assert isinstance(self._port.port.payload, Rows)  # noqa: S101  # poses are rows
        rows = np.frombuffer(b"".join(payload), row_dtype(self._port.port.payload))
        given = np.asarray(rows["raw" if self._moved else "data"], np.float64)
        if not self._moved:
            return given[np.isfinite(given).all(axis=1)]
        poses, valid = to_world(given, self._world)
        return poses[valid]

    def _hear(self, event: Event) -> None:
        if self._moved and event.name == "world_frame":
            self._world, self.has_world = event.detail["pose"], True

    def _is_wanted(self, sample: Sample, start_ns: int) -> bool:
        return sample.port == self._port.port.name and sample.time_host_ns >= start_ns


def guided_tip(poses: LivePoses, ask: Ask, tell: Tell, *, seconds: float = _TURN_S) -> Pivot:
    """Find the tip, again and again until it is known.

    Parameters
    ----------
    poses : LivePoses
    ask : callable
        Tells the operator what to do, and returns when it is begun.
    tell : callable
        Shows what was found, or why it was not.
    seconds : float, optional
    """
    while True:
        ask(
            f"hold the tip in a dent; Enter, then turn the hand to and fro and sideways for "
            f"{seconds:g} s: "
        )
        try:
            found = pivot(poses.read(seconds))
        except CalibrationRefusedError as error:
            tell(_not_taken(error))
            continue
        place = ", ".join(f"{1e3 * value:.1f}" for value in found.tip_m)
        tell(
            f"  tip at {place} mm ± {1e3 * found.sigma_m:.2f}; it was off its point by "
            f"{1e3 * found.residual_m:.2f} mm, rms"
        )
        return found


def guided_jig(
    poses: LivePoses,
    tool: Sequence[float],
    ask: Ask,
    tell: Tell,
    *,
    seconds: float = _REST_S,
) -> Aligned:
    """Find the tool's orientation in a jig, again and again until it is known.

    Parameters
    ----------
    poses : LivePoses
    tool : sequence of float
        Quaternion xyzw of the tool in the world, as it stands in the jig.
    ask, tell : callable
        As for `guided_tip`.
    seconds : float, optional
    """
    while True:
        ask("put the tool into its jig, at rest; then Enter: ")
        try:
            given = poses.read(seconds)
            if not poses.has_world:
                tell("  not taken: the world is not known. Mark it in the app, now.")
                continue
            found = aligned(given, tool)
        except CalibrationRefusedError as error:
            tell(_not_taken(error))
            continue
        tell(f"  poses differ by {np.degrees(found.residual_rad):.2f} degrees, rms")
        return found


def _not_taken(error: CalibrationRefusedError) -> str:
    return f"  not taken: {error.what}. {error.fix or ''}".rstrip()
