"""The whole preflight: a rig file, its drivers, simulated devices; and gates of the rig as such."""

import shutil
import socket
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.model.description import CalibrationItem
from exumi_recorders.calibration.files import Calibration, array_path, write_calibration
from exumi_recorders.journal import space
from exumi_recorders.rig import probing
from exumi_recorders.rig.checking import RigReport, check_rig, disk_gate, hook_gates
from exumi_recorders.rig.devices import recorded_devices
from exumi_recorders.rig.gate import Gate
from exumi_recorders.rig.loading import load_rig, parse_rig
from exumi_recorders.rig.model import Rig
from exumi_recorders.rig.touch_gates import touch_gates
from exumi_recorders.simulated.camera_setup import CameraSetup
from exumi_recorders.simulated.serving import serve_frames
from tests.exumi_recorders.rig.probes import camera_port, gel, pressed, shot

RIG = """
format = "exumi-rig"
version = "1.0"
[rig]
name = "x"
licence = "CC0-1.0"
data = "recordings"
calibration = ["calibration.json"]
[devices.encoder]
driver = "as5600"
rate_hz = 50
simulated = {{ seed = 7, epoch_ns = 0, magnet_gap_mm = {gap} }}
streams = {{ width = "width" }}
"""
FINGER = """
[devices.{name}]
driver = "9dtact"
device = "unix:{socket}"
side = "{name}"
width = 128
height = 96
streams = {{ images = "tactile_{name}" }}
"""
SIDES = {"left": 1, "right": 2}


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probing, "_SETTLE_S", 0.1)


def write_rig(folder: Path, text: str = "", *, gap: float = 2.0, calibrated: bool = True) -> Rig:
    if calibrated:
        counts = {"raw": [2000, 6000], "data": [-0.5, 1.0]}
        items = {"width_map": CalibrationItem(value={"raw_to_data": counts})}
        arrays: dict[str, Any] = {}
        for name, seed in SIDES.items():
            key = f"tactile_reference/tactile_{name}"
            items[key] = CalibrationItem(value=None, array=array_path(key))
            arrays[key] = gel(seed)
        write_calibration(folder / "calibration.json", Calibration(items, arrays))
    path = folder / "rig.toml"
    path.write_text(RIG.format(gap=gap) + text, encoding="utf-8")
    return load_rig(path)


def verdicts(report: RigReport) -> dict[tuple[str, str], str]:
    return {(gate.name, gate.where): gate.verdict for gate in report.gates}


@contextmanager
def fingers(folder: Path, shown: dict[str, int], touched: Collection[str] = ()) -> Iterator[str]:
    """Two cameras on sockets that show gels; yield their part of a rig file."""
    text = ""
    stop = threading.Event()
    threads = []
    for name, seed in shown.items():
        place = str(folder / f"{name}.sock")
        setup = CameraSetup(socket=place, epoch_ns=time.monotonic_ns(), width=128, height=96)
        seen = {False: shot(gel(seed)), True: shot(pressed(gel(seed)))}
        content = {"content": lambda _, name=name, seen=seen: seen[name in touched]}
        threads.append(
            threading.Thread(target=serve_frames, args=(setup,), kwargs={**content, "stop": stop})
        )
        text += FINGER.format(name=name, socket=place)
    for thread in threads:
        thread.start()
    end = time.monotonic() + 5
    while not all((folder / f"{name}.sock").exists() for name in shown):
        assert time.monotonic() < end
        time.sleep(0.01)
    try:
        yield text
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def test_a_rig_that_is_well(tmp_path: Path) -> None:
    with fingers(tmp_path, SIDES) as text:
        report = check_rig(write_rig(tmp_path, text), seconds=0.5)
    found = verdicts(report)
    expected = [
        ("calibration", ""),
        ("device", "encoder"),
        ("magnet", "encoder"),
        ("rate", "width"),
        ("width_map", "width"),
        ("clock", ""),
    ]
    for name in SIDES:
        stream = f"tactile_{name}"
        expected += [("device", name), ("health", name), ("rate", stream)]
        expected += [("reference", stream), ("left_right", stream)]
    assert {key: found[key] for key in expected} == dict.fromkeys(expected, "pass")
    # A machine with other things to do may be late to read the encoder, and says so.
    failed = {key for key, verdict in found.items() if verdict == "fail"}
    assert failed <= {("drops", "encoder"), ("drops", "left"), ("drops", "right")}
    assert report.passed is (not failed)
    document = report.to_json()
    assert document["passed"] is report.passed
    assert document["gates"][0] == {
        "name": "calibration",
        "where": "",
        "verdict": "pass",
        "found": "3 items",
        "expected": "readable calibration files",
        "what_to_do": "",
    }


def test_everything_that_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    swapped = {"left": SIDES["right"], "right": SIDES["left"]}
    with (
        fingers(tmp_path, swapped) as cameras,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken,
    ):
        taken.bind(("127.0.0.1", 0))
        text = f"""{cameras}
[devices.headset]
driver = "quest"
host = "127.0.0.1"
port = {taken.getsockname()[1]}
streams = {{ pose = "pose" }}
[controls]
world_frame = "headset"
flag = "encoder"
[hooks]
start = ["no-such-program-anywhere"]
"""
        report = check_rig(write_rig(tmp_path, text, gap=6.0), seconds=0.5)
    found = verdicts(report)
    wrong = {key for key, verdict in found.items() if verdict == "fail"}
    assert wrong >= {
        ("device", "headset"),
        ("magnet", "encoder"),
        ("left_right", "tactile_left"),
        ("left_right", "tactile_right"),
        ("flag", "encoder"),
    }
    assert found["world_frame", "headset"] == "skipped"
    assert found["hook", "start"] == "warn"
    assert not report.passed
    assert all(gate.what_to_do for gate in report.gates if gate.verdict in {"warn", "fail"})
    # What is known of a device that is not open is judged all the same.
    assert found["latency", "pose"] == "warn"


def test_calibration_files_that_cannot_be_read(tmp_path: Path) -> None:
    report = check_rig(write_rig(tmp_path, calibrated=False), seconds=0.1)
    found = verdicts(report)
    assert found["calibration", ""] == found["width_map", "width"] == "fail"
    (tmp_path / "calibration.json").write_text("{}")
    assert verdicts(check_rig(load_rig(tmp_path / "rig.toml"), seconds=0.1))["calibration", ""] == (
        "fail"
    )


def small(**sections: Any) -> Rig:
    about = {"name": "x", "licence": "CC0-1.0"}
    encoder = {"driver": "as5600", "streams": {"width": "width"}}
    document = {"format": "exumi-rig", "version": "1.0", "rig": about, **sections}
    return parse_rig({**document, "devices": {"encoder": encoder}})


def disk(rig: Rig, folder: Path | None, free: float, monkeypatch: pytest.MonkeyPatch) -> Gate:
    monkeypatch.setattr(space, "free_bytes", lambda _: int(free))
    monkeypatch.setattr("exumi_recorders.rig.checking.free_bytes", lambda _: int(free))
    return disk_gate(rig, [camera_port()], folder)


def test_room_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = small(limits={"least_minutes": 1000.0})
    minute = 2 * 60 * space.bytes_per_second([camera_port()])
    kept = 128 << 20

    def verdict(minutes: float) -> str:
        return disk(rig, tmp_path / "a" / "b", kept + minutes * minute, monkeypatch).verdict

    assert (verdict(5001), verdict(4990), verdict(1001), verdict(999)) == (
        "pass",
        "warn",
        "warn",
        "fail",
    )
    assert disk(small(), tmp_path, (2 << 30) - 1, monkeypatch).verdict == "fail"
    assert disk(small(), None, 1e12, monkeypatch).verdict == "skipped"


def test_a_place_that_cannot_be_written_to(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    gate = disk_gate(small(), [], tmp_path / "file" / "dataset")
    assert (gate.verdict, gate.found) == ("fail", f"{tmp_path / 'file'} cannot be written to")


def test_hooks_are_there() -> None:
    program = shutil.which("true")
    assert program is not None
    gates = hook_gates(small(hooks={"start": [program], "stop": ["no-such-program-anywhere"]}))
    assert [(gate.where, gate.verdict) for gate in gates] == [("start", "pass"), ("stop", "warn")]
    assert hook_gates(small()) == []


def test_the_least_rate_is_the_rig_files(tmp_path: Path) -> None:
    assert small().limits.least_rate == 0.8
    rig = small(limits={"least_rate": 0.4})
    assert rig.limits.least_rate == np.float64(0.4)


def touched_gates(folder: Path, hand: dict[str, str]) -> dict[str, Gate]:
    """Fingers that look alike; `hand` says which camera sees the finger that is asked for."""
    touched: set[str] = set()

    def ask(prompt: str) -> str:
        name = prompt.split()[4].removeprefix("tactile_")
        touched.clear()
        touched.update({hand[name]} - {""})
        return ""

    with fingers(folder, {"left": 1, "right": 1}, touched) as text:
        rig = write_rig(folder, text, calibrated=False)
        streams = [
            stream
            for device in probing.probe(recorded_devices(rig), 0.4)
            for stream in device.streams.values()
        ]
        found = touch_gates(rig, streams, ask, seconds=0.4)
    return {gate.where: gate for gate in found}


def test_fingers_that_look_alike_are_told_apart_by_touch(tmp_path: Path) -> None:
    found = touched_gates(tmp_path, {"left": "left", "right": "right"})
    assert [gate.verdict for gate in found.values()] == ["pass", "pass"]


def test_plugs_that_are_exchanged_are_found_by_touch(tmp_path: Path) -> None:
    found = touched_gates(tmp_path, {"left": "right", "right": ""})
    gate = found["tactile_left"]
    assert gate.verdict == "fail"
    assert gate.found.startswith("tactile_right saw it")
    assert "exchange" in gate.what_to_do
    assert found["tactile_right"].verdict == "warn"  # nobody pressed


def test_one_finger_cannot_be_exchanged(tmp_path: Path) -> None:
    gates = touch_gates(write_rig(tmp_path), [], pytest.fail)
    assert [gate.verdict for gate in gates] == ["skipped"]
