"""Gates of the calibration: what is missing, out of date, or of another camera."""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta

import numpy as np
from pydantic import ValidationError

from exumi_data.calibration_items import moment_of
from exumi_data.model.calibration import INTRINSICS, Intrinsics
from exumi_data.model.description import CalibrationItem
from exumi_data.width_map import WIDTH_MAP, WidthMap, read_width_map
from exumi_recorders.contract import Files, Port, Rows
from exumi_recorders.finalise.rows import row_dtype
from exumi_recorders.recording.headers import LATENCY, latency_of
from exumi_recorders.rig.gate import Gate, Verdict

__all__ = ["calibration_gates", "width_gate"]

# The way from a sensor to its stamp changes with cables, firmware and settings; an app's with every
# start. A week is what a careful laboratory lets pass.
_OLD = timedelta(days=7)
_TIMED_KINDS = ("pose", "width", "taxels", "tactile", "rgb", "wrench")
_MOST_SHOWN = 80
_EXPECTED_MAP = "a map from counts to widths"
_EXPECTED_LATENCY = f"measured within {_OLD.days} days"
_MAP_FIX = (
    "Calibrate it: exumi calibrate gripper --help; and name the file as `calibration` in [rig]. "
    "To record the calibration itself: exumi record --uncalibrated."
)
_TURNS_FIX = (
    "The gripper turns the encoder more than once: let its driver count the turns, by `home`, the "
    "count where the gripper is closed."
)
_LATENCY_FIXES: Mapping[str, str] = {
    "pose": "Sweep the hand before a marker: exumi calibrate latency --help.",
    "tactile": "Close on something rigid, ten times: exumi calibrate contact --help.",
    "taxels": "Close on something rigid, ten times: exumi calibrate contact --help.",
    "rgb": "Close on something rigid before the camera: exumi calibrate contact --help.",
}


def calibration_gates(
    ports: Mapping[str, Port],
    items: Mapping[str, CalibrationItem],
    now: datetime | None = None,
) -> list[Gate]:
    """Judge a calibration by what the streams need; no device has to be open.

    Parameters
    ----------
    ports : mapping of str to Port
        By the streams' names.
    items : mapping of str to CalibrationItem
    now : datetime, optional
        UTC.
    """
    now = now or datetime.now(UTC)
    gates = []
    for name, port in ports.items():
        if port.transform == "encoder_map":
            gates.append(width_gate(name, port, items))
        # The headset's own pose comes in the datagrams of the controller's, and is looked at only.
        if port.kind in _TIMED_KINDS and port.name != "headset":
            gates.append(_latency(name, port, items, now))
        if port.kind == "rgb":
            gates.append(_intrinsics(name, port, items))
    return gates


def width_gate(
    stream: str, port: Port, items: Mapping[str, CalibrationItem], latest: bytes | None = None
) -> Gate:
    """Judge the map from an encoder's counts to widths, and the newest count by it.

    Parameters
    ----------
    stream : str
    port : Port
    items : mapping of str to CalibrationItem
    latest : bytes, optional
        The newest payload.
    """
    item = items.get(WIDTH_MAP)
    modulus = (port.metadata.get("raw") or {}).get("modulus")
    known = "none" if item is None else read_width_map(item.value, modulus)
    if not isinstance(known, WidthMap):
        found = known if item is None else f"a wrong one: {known}"
        is_long = item is not None and isinstance(read_width_map(item.value), WidthMap)
        fix = _TURNS_FIX if is_long else _MAP_FIX
        return Gate(WIDTH_MAP, stream, "fail", found, _EXPECTED_MAP, fix)
    if latest is None or not isinstance(port.payload, Rows):
        return Gate(WIDTH_MAP, stream, "pass", f"{len(known.raw)} points", _EXPECTED_MAP)
    counts = np.frombuffer(latest, row_dtype(port.payload))["raw"]
    widths, outside = known.widths(counts, modulus)
    found = f"{1e3 * float(widths[0]):.1f} mm now"
    if outside[0]:
        fix = "The encoder or its magnet has turned since: calibrate the gripper again."
        found += ", beyond the map's ends"
        return Gate(WIDTH_MAP, stream, "warn", found, _EXPECTED_MAP, fix)
    return Gate(WIDTH_MAP, stream, "pass", found, _EXPECTED_MAP)


def _latency(stream: str, port: Port, items: Mapping[str, CalibrationItem], now: datetime) -> Gate:
    item = items.get(f"{LATENCY}{stream}")
    # What the others are compared with: a bus that is read in a tenth of a millisecond.
    if item is None and port.stamp_point == "bracket_mid":
        found = "none; the stamp lies around the reading itself"
        return Gate("latency", stream, "pass", found, "not needed")
    fix = _LATENCY_FIXES.get(port.kind, "See docs/recording.md on calibration.")
    if item is None:
        found = "none: times are those of arrival"
        return Gate("latency", stream, "warn", found, _EXPECTED_LATENCY, fix)
    latency_ns = latency_of(item)
    if latency_ns is None or item.unit != "ns":
        found = f"{str(item.value)[:_MOST_SHOWN]} {item.unit or ''}".strip()
        return Gate("latency", stream, "fail", found, "a number in ns, of a minute at most", fix)
    sigma = "" if item.uncertainty is None else f" ± {item.uncertainty / 1e6:.1f}"
    found = f"{latency_ns / 1e6:.1f}{sigma} ms"
    moment = moment_of(item)
    if moment is None:
        return Gate(
            "latency", stream, "warn", f"{found}, of an unknown day", _EXPECTED_LATENCY, fix
        )
    age = now - moment
    found += f", {_age(age)} old"
    verdict: Verdict = "warn" if age > _OLD else "pass"
    return Gate(
        "latency", stream, verdict, found, _EXPECTED_LATENCY, fix if verdict == "warn" else ""
    )


def _age(age: timedelta) -> str:
    hours = max(0.0, age.total_seconds() / 3600)
    return f"{hours:.0f} h" if hours < 48 else f"{age.days} days"


def _intrinsics(stream: str, port: Port, items: Mapping[str, CalibrationItem]) -> Gate:
    assert isinstance(port.payload, Files)  # noqa: S101  # cameras send files
    size = f"{port.payload.width}x{port.payload.height}"
    expected = f"of images of {size}"
    item = items.get(f"{INTRINSICS}{stream}")
    fix = "Calibrate the camera at this size: exumi calibrate camera --help."
    if item is None:
        return Gate("intrinsics", stream, "warn", "none", expected, fix)
    try:
        found = Intrinsics.model_validate(item.value)
    except ValidationError as error:
        what = f"wrong ones: {error.errors()[0]['msg']}"
        return Gate("intrinsics", stream, "fail", what, expected, fix)
    said = f"{found.model}, of {found.width}x{found.height}"
    if (found.width, found.height) != (port.payload.width, port.payload.height):
        fix = f"{fix} Or set `width` and `height` of the camera to what it was calibrated at."
        return Gate("intrinsics", stream, "fail", said, expected, fix)
    return Gate("intrinsics", stream, "pass", said, expected)
