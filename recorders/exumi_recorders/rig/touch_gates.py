"""Which finger is which, by touching them: for gels that look alike, and before any reference.

The operator presses one finger after the other, and the camera that sees it has to be the one that
the rig file names so.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from exumi_data.tactile import ACTIVE_THRESHOLD, ActivityMeter, reference_image
from exumi_recorders.rig.devices import recorded_devices
from exumi_recorders.rig.finger_gates import decoded_frames
from exumi_recorders.rig.gate import Gate
from exumi_recorders.rig.model import Rig
from exumi_recorders.rig.probing import ProbedStream, probe

__all__ = ["touch_gates"]

Image = npt.NDArray[np.uint8]

_SECONDS = 2.0
# What shakes the hand is seen by both fingers; what presses one, by that one above all.
_CLEARLY = 2.0
_EXPECTED = "the finger that is pressed"


def touch_gates(
    rig: Rig,
    untouched: Sequence[ProbedStream],
    ask: Callable[[str], str],
    *,
    seconds: float = _SECONDS,
) -> list[Gate]:
    """Have each finger pressed, and see which camera shows it.

    Parameters
    ----------
    rig : Rig
    untouched : sequence of ProbedStream
        What came while nothing was touched; those that are not tactile are left out.
    ask : callable
        Tells the operator what to do, and returns when it is done.
    seconds : float, optional
        How long to look at each.
    """
    rest = {
        stream.name: reference_image(frames)
        for stream in untouched
        if stream.port.kind == "tactile" and (frames := decoded_frames(stream))
    }
    if len(rest) < 2:
        return [Gate("touched", "", "skipped", "there are no two tactile cameras", _EXPECTED)]
    gates = []
    for name in rest:
        ask(f"press the gel of {name} with a finger and hold it; then Enter: ")
        gates.append(_judged(name, _activities(rig, rest, seconds)))
    return gates


def _activities(rig: Rig, rest: dict[str, Image], seconds: float) -> dict[str, float]:
    """Return which share of each gel is active now; cameras that cannot be read are left out."""
    wanted = [
        device for device in recorded_devices(rig) if set(device.streams.values()) & set(rest)
    ]
    found = {}
    for device in probe(wanted, seconds):
        for name, stream in device.streams.items():
            frames = decoded_frames(stream) if name in rest else []
            if frames:
                meter = ActivityMeter(rest[name])
                found[name] = float(np.median([meter.measure(frame) for frame in frames]))
    return found


def _judged(name: str, active: dict[str, float]) -> Gate:
    if set(active) < {name} or len(active) < 2:
        return Gate("touched", name, "skipped", "no frame came", _EXPECTED)
    by_activity = sorted(active, key=lambda each: active[each], reverse=True)
    first, second = by_activity[:2]
    said = ", ".join(f"{each} active on {active[each]:.1%}" for each in by_activity)
    if active[first] <= ACTIVE_THRESHOLD or active[first] < _CLEARLY * active[second]:
        fix = "Press one gel harder, without moving the hand, and check again."
        return Gate("touched", name, "warn", f"not clear: {said}", _EXPECTED, fix)
    if first == name:
        return Gate("touched", name, "pass", said, _EXPECTED)
    fix = "The plugs are exchanged: exchange `device` of the two in the rig file, or the fingers."
    return Gate("touched", name, "fail", f"{first} saw it ({said})", _EXPECTED, fix)
