"""Gates of the calibration: what is missing, old, or of another camera."""

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from exumi_data.model.description import CalibrationItem
from exumi_recorders.rig.calibration_gates import calibration_gates, width_gate
from exumi_recorders.rig.gate import Gate
from tests.exumi_recorders.rig.probes import camera_port, encoder_port, port

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
MAP = {"raw_to_data": {"raw": [4000, 4500], "data": [0.0, 0.08]}}
SEEN = {"model": "pinhole", "width": 128, "height": 96, "fx": 90, "fy": 90, "cx": 64, "cy": 48}


def item(value: Any, *, unit: str | None = None, age: timedelta | None = None) -> CalibrationItem:
    time = None if age is None else (NOW - age).strftime("%Y-%m-%dT%H:%M:%SZ")
    return CalibrationItem(value=value, unit=unit, uncertainty=1e6, time=time)


def gates_of(name: str, of: Any, **items: CalibrationItem) -> dict[str, Gate]:
    named = {key.replace("__", "/"): value for key, value in items.items()}
    return {gate.name: gate for gate in calibration_gates({name: of}, named, NOW)}


def test_an_encoder_without_a_map_fails() -> None:
    gate = gates_of("width", encoder_port())["width_map"]
    assert (gate.verdict, gate.found) == ("fail", "none")
    assert "exumi calibrate gripper" in gate.what_to_do
    gate = gates_of("width", encoder_port(), width_map=item({"raw_to_data": 3}))["width_map"]
    assert gate.verdict == "fail"
    assert gate.found.startswith("a wrong one")
    gate = gates_of("width", encoder_port(), width_map=item(MAP))["width_map"]
    assert (gate.verdict, gate.found) == ("pass", "2 points")
    assert "width_map" not in gates_of("force", port())
    long = {"raw_to_data": {"raw": [400, 9000], "data": [0.0, 0.08]}}
    gate = gates_of("width", encoder_port(), width_map=item(long))["width_map"]
    assert gate.verdict == "fail"
    assert "goes over 8600 counts" in gate.found
    assert "by `home`" in gate.what_to_do


@pytest.mark.parametrize(
    ("count", "found", "verdict"),
    [
        (4000, "0.0 mm now", "pass"),
        (404, "80.0 mm now", "pass"),  # 4500, wrapped at 4096
        (405, "80.0 mm now, beyond the map's ends", "warn"),
        (3999, "0.0 mm now, beyond the map's ends", "warn"),
    ],
)
def test_the_count_of_now_lies_on_the_map(count: int, found: str, verdict: str) -> None:
    latest = np.array([count], "<u2").tobytes()
    gate = width_gate("width", encoder_port(), {"width_map": item(MAP)}, latest)
    assert (gate.found, gate.verdict) == (found, verdict)


@pytest.mark.parametrize(
    ("age", "verdict", "found"),
    [
        (timedelta(hours=5), "pass", "12.5 ± 1.0 ms, 5 h old"),
        (timedelta(days=7), "pass", "12.5 ± 1.0 ms, 7 days old"),
        (timedelta(days=7, seconds=1), "warn", "12.5 ± 1.0 ms, 7 days old"),
        (None, "warn", "12.5 ± 1.0 ms, of an unknown day"),
    ],
)
def test_latencies_grow_old(age: timedelta | None, verdict: str, found: str) -> None:
    known = item(12_500_000, unit="ns", age=age)
    gate = gates_of("pose", port("pose"), latency__pose=known)["latency"]
    assert (gate.verdict, gate.found) == (verdict, found)
    assert bool(gate.what_to_do) == (verdict == "warn")


@pytest.mark.parametrize("time", ["2026-02-30T12:00:00Z", "0000-01-01T00:00:00Z"])
def test_days_that_cannot_be(time: str) -> None:
    known = item(1, unit="ns").model_copy(update={"time": time})
    gate = gates_of("pose", port("pose"), latency__pose=known)["latency"]
    assert (gate.verdict, gate.found.split(", ")[1]) == ("warn", "of an unknown day")
    leap = item(1, unit="ns").model_copy(update={"time": "2016-12-31T23:59:60.123456789Z"})
    gate = gates_of("pose", port("pose"), latency__pose=leap)["latency"]
    assert "days old" in gate.found


def test_latencies_that_are_missing_or_no_number() -> None:
    assert gates_of("tactile", camera_port())["latency"].verdict == "warn"
    assert gates_of("width", encoder_port())["latency"].verdict == "pass"
    wrong = item("soon", unit="ns", age=timedelta(0))
    assert gates_of("pose", port("pose"), latency__pose=wrong)["latency"].verdict == "fail"
    seconds = item(0.0125, unit="s", age=timedelta(0))
    assert gates_of("pose", port("pose"), latency__pose=seconds)["latency"].verdict == "fail"
    for value in (60_000_000_001, -1e300, 10**400):
        wrong = item(value, unit="ns", age=timedelta(0))
        assert gates_of("pose", port("pose"), latency__pose=wrong)["latency"].verdict == "fail"
    assert "latency" not in gates_of("headset", port("pose", name="headset"))
    assert "latency" not in gates_of("sound", port("audio"))


def test_intrinsics_are_of_the_cameras_size() -> None:
    camera = camera_port("rgb")
    assert gates_of("rgb", camera)["intrinsics"].verdict == "warn"
    assert gates_of("rgb", camera, intrinsics__rgb=item(SEEN))["intrinsics"].verdict == "pass"
    other = gates_of("rgb", camera, intrinsics__rgb=item({**SEEN, "width": 129}))["intrinsics"]
    assert (other.verdict, other.found) == ("fail", "pinhole, of 129x96")
    assert other.expected == "of images of 128x96"
    wrong = gates_of("rgb", camera, intrinsics__rgb=item({**SEEN, "fx": -1}))["intrinsics"]
    assert wrong.verdict == "fail"
    assert "intrinsics" not in gates_of("tactile", camera_port())
