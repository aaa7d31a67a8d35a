"""Gates of devices: what is open, well, fast enough, complete; both sides of every threshold."""

from pathlib import Path

import pytest

from exumi_data.errors import MissingExtraError
from exumi_recorders.contract import DeviceError
from exumi_recorders.rig.device_gates import device_gates, flag_gate, rate_gate, world_frame_gates
from exumi_recorders.rig.gate import Gate
from exumi_recorders.rig.loading import parse_rig
from exumi_recorders.rig.model import Rig
from exumi_recorders.rig.probing import ProbedDevice
from tests.exumi_recorders.rig.probes import device, port, stream


def gates_of(probed: ProbedDevice) -> dict[str, Gate]:
    return {gate.name: gate for gate in device_gates(probed, seconds=2.0, least_rate=0.8)}


def rig(**controls: str) -> Rig:
    return parse_rig(
        {
            "format": "exumi-rig",
            "version": "1.0",
            "rig": {"name": "x", "licence": "CC0-1.0"},
            "controls": controls,
            "devices": {
                "headset": {"driver": "quest", "streams": {"pose": "pose"}},
                "encoder": {"driver": "as5600", "streams": {"width": "width"}},
            },
        },
        path=Path("rig.toml"),
    )


def test_a_device_that_fails_is_all_that_is_said_of_it() -> None:
    failure = DeviceError("there is no such bus", where="/dev/i2c-1", fix="Switch it on.")
    (gate,) = device_gates(device(failure=failure), seconds=1.0, least_rate=0.8)
    assert (gate.verdict, gate.found) == ("fail", "/dev/i2c-1: there is no such bus")
    assert gate.what_to_do == "Switch it on."
    for other in (ValueError(), MissingExtraError("it needs smbus2")):
        (gate,) = device_gates(device(failure=other), seconds=1.0, least_rate=0.8)
        assert gate.verdict == "fail"
        assert gate.found
        assert gate.what_to_do


def test_all_is_well() -> None:
    gates = gates_of(device(stream("force", port(nominal_rate="100"), 200)))
    assert {name: gate.verdict for name, gate in gates.items()} == {
        "device": "pass",
        "health": "pass",
        "rate": "pass",
        "drops": "pass",
    }
    assert all(not gate.what_to_do for gate in gates.values())


def test_what_a_device_complains_of_is_passed_on() -> None:
    gate = gates_of(device(problems=["The pose has been the same.", "Far away."]))["health"]
    assert (gate.verdict, gate.found) == ("warn", "2 problems")
    assert gate.what_to_do == "The pose has been the same. Far away."


@pytest.mark.parametrize(
    ("seen", "problems", "verdict"),
    [(True, [], "pass"), (True, ["Its gain is 120, 64 is best."], "warn"), (False, ["?"], "fail")],
)
def test_the_magnet(seen: bool, problems: list[str], verdict: str) -> None:
    gates = gates_of(device(problems=problems, magnet=seen, agc=64, magnitude=2000))
    assert gates["magnet"].verdict == verdict
    assert "health" not in gates


@pytest.mark.parametrize(
    ("count", "nominal", "verdict"),
    [
        (160, "100", "pass"),
        (159, "100", "pass"),  # one by chance
        (158, "100", "fail"),
        (1, "1", "pass"),
        (1, None, "pass"),
        (0, None, "fail"),
    ],
)
def test_rates(count: int, nominal: str | None, verdict: str) -> None:
    gate = rate_gate(
        stream("force", port(nominal_rate=nominal), count), [], seconds=2.0, least_rate=0.8
    )
    assert gate.verdict == verdict
    assert bool(gate.what_to_do) == (verdict == "fail")


def test_no_sample_is_explained_by_the_device() -> None:
    silent = stream("pose", port("pose"))
    gate = rate_gate(silent, ["Is the app running?"], seconds=1.0, least_rate=0.8)
    assert (gate.found, gate.what_to_do) == ("no sample", "Is the app running?")


@pytest.mark.parametrize(
    ("lost", "verdict"),
    [({}, "pass"), ({"sequence": 1}, "warn"), ({"sequence": 5}, "warn"), ({"sequence": 6}, "fail")],
)
def test_drops(lost: dict[str, int], verdict: str) -> None:
    came = 100 - sum(lost.values())
    assert gates_of(device(stream("rgb", port("rgb"), came), lost=lost))["drops"].verdict == verdict


def test_causes_of_drops_lead_to_what_helps() -> None:
    lost = {"rejected_decimal_comma": 90, "pose/kernel": 2}
    gate = gates_of(device(stream("pose", port("pose")), lost=lost))["drops"]
    assert gate.found == "2 pose/kernel, 90 rejected_decimal_comma; 0 samples came"
    assert "English" in gate.what_to_do
    assert "end other programs" in gate.what_to_do
    other = gates_of(device(lost={"sunspots": 1}))["drops"]
    assert "troubleshooting" in other.what_to_do


def headset(**more: bool) -> ProbedDevice:
    pose = stream("pose", port("pose", transform="world_frame"), 90)
    return device(pose, name="headset", events=["world_frame"] if more.pop("event", 0) else [])


def test_the_world_frame() -> None:
    (gate,) = world_frame_gates(rig(world_frame="headset"), [headset(event=True)])
    assert gate.verdict == "pass"
    (gate,) = world_frame_gates(rig(world_frame="headset"), [headset()])
    assert (gate.verdict, gate.where) == ("fail", "headset")
    assert "Mark the world" in gate.what_to_do
    (gate,) = world_frame_gates(rig(), [headset()])
    assert gate.verdict == "warn"  # it is not insisted on
    told = device(name="headset", world_frame=True)
    (gate,) = world_frame_gates(rig(world_frame="headset"), [told])
    assert gate.verdict == "pass"
    lost = device(name="headset", failure=DeviceError("gone"))
    (gate,) = world_frame_gates(rig(world_frame="headset"), [lost])
    assert gate.verdict == "skipped"
    assert world_frame_gates(rig(), [device(stream("force", port()))]) == []


def test_the_flag() -> None:
    def verdict(*probed: ProbedDevice, **controls: str) -> str:
        return flag_gate(rig(**controls), probed).verdict

    off, on = device(name="headset", record_flag=False), device(name="headset", record_flag=True)
    encoder = device(name="encoder", magnet=True)
    assert verdict(off, encoder, flag="headset") == "pass"
    assert verdict(on, encoder, flag="headset") == "warn"
    assert verdict(off, encoder, flag="encoder") == "fail"
    assert verdict(off, encoder) == "skipped"
    lost = device(name="headset", failure=DeviceError("gone"))
    assert verdict(lost, encoder, flag="headset") == "skipped"
