"""Devices are watched together; one that fails stops none of the others."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import pytest

from exumi_recorders.contract import DeviceError, DeviceLostError, Event, Files, Health, Port, Rows
from exumi_recorders.contract import Sample as OneSample
from exumi_recorders.recording.device import RecordedDevice
from exumi_recorders.rig import probing
from exumi_recorders.rig.probing import ProbedDevice, probe

STEP_S = 0.005


class Ticker:
    """A device that sends every 5 ms, and does what else it is told."""

    def __init__(self, *, late_s: float = 0.0, **faults: Any) -> None:
        self.late_s = late_s
        self.faults = faults
        self.calls = ["made"]
        self.sent = 0
        payload = Files(48, 64, 3) if faults.get("images") else Rows({"data": ("<u2", ())})
        self.ports = (Port(name="out", kind="vendor:x", payload=payload, stamp_point="user_rx"),)

    def open(self) -> None:
        if "open" in self.faults:
            raise self.faults["open"]
        self.calls.append("open")

    def read(self, timeout_s: float) -> list[OneSample | Event]:
        time.sleep(min(timeout_s, STEP_S))
        self.sent += 1
        if self.sent >= self.faults.get("lost_after", 1e9):
            raise DeviceLostError("it was unplugged")
        stamp = time.monotonic_ns() - int(self.late_s * 1e9)
        payload = b"%02d" % (self.sent % 100)
        return [OneSample("out", stamp, payload), Event("tick", stamp, {"n": self.sent})]

    def health(self) -> Health:
        if "health" in self.faults:
            raise self.faults["health"]
        return Health(lost={"late": 3 + self.sent, "kernel": 7}, readings={"sent": self.sent})

    def close(self) -> None:
        self.calls.append("close")


@contextmanager
def short(monkeypatch: pytest.MonkeyPatch, **seconds: float) -> Iterator[None]:
    with monkeypatch.context() as patch:
        for name, value in {"_SETTLE_S": 0.05, "_GRACE_S": 0.1, **seconds}.items():
            patch.setattr(probing, name, value)
        yield


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with short(monkeypatch):
        yield


def found(
    drivers: Mapping[str, Ticker], *, ports: Mapping[str, str] | None = None
) -> dict[str, ProbedDevice]:
    devices = [
        RecordedDevice(name, driver, ports or {"out": f"{name}_out"})
        for name, driver in drivers.items()
    ]
    return {one.name: one for one in probe(devices, 0.3)}


def test_what_came_is_counted() -> None:
    ticker = Ticker()
    one = found({"a": ticker})["a"]
    assert one.failure is None
    stream = one.streams["a_out"]
    assert 10 < stream.count < ticker.sent
    assert stream.latest is not None
    assert not stream.frames
    assert one.events["tick"].detail["n"] > stream.count
    assert set(one.lost) == {"late"}  # the kernel lost nothing meanwhile
    assert 0 < one.lost["late"] < ticker.sent
    assert one.health.readings["sent"]
    assert ticker.calls == ["made", "open", "close"]


def test_failures_stop_nobody_else() -> None:
    refusal = DeviceError("no such bus")
    drivers = {
        "well": Ticker(),
        "shut": Ticker(open=refusal),
        "unplugged": Ticker(lost_after=20),
        "mistaken": Ticker(health=KeyError("agc")),
    }
    all_found = found(drivers)
    assert all_found["well"].failure is None
    assert all_found["well"].streams["well_out"].count > 10
    assert all_found["shut"].failure is refusal
    assert not all_found["shut"].streams
    assert isinstance(all_found["unplugged"].failure, DeviceLostError)
    assert isinstance(all_found["mistaken"].failure, KeyError)
    assert all(driver.calls[-1] == "close" for driver in drivers.values())


def test_a_port_that_is_not_there_is_named() -> None:
    one = found({"a": Ticker()}, ports={"in": "x"})["a"]
    assert isinstance(one.failure, DeviceError)
    assert "'in'" in str(one.failure)
    assert "its ports are out" in str(one.failure)


def test_a_device_that_never_opens_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    class Slow(Ticker):
        def open(self) -> None:
            time.sleep(0.5)

    with short(monkeypatch, _OPEN_S=0.1):
        one = found({"slow": Slow(), "well": Ticker()})
    assert isinstance(one["slow"].failure, TimeoutError)
    assert one["well"].streams["well_out"].count > 10


def test_only_what_was_stamped_meanwhile_counts() -> None:
    # Stamped long before it came, so nothing of it is of the time that was watched.
    assert found({"a": Ticker(late_s=5.0)})["a"].streams["a_out"].count == 0


def test_a_few_frames_are_kept_from_all_of_the_time() -> None:
    stream = found({"a": Ticker(images=True)})["a"].streams["a_out"]
    assert 2 <= len(stream.frames) <= 9
    assert stream.count > 2 * len(stream.frames)


def test_an_interrupt_closes_all(monkeypatch: pytest.MonkeyPatch) -> None:
    ticker = Ticker()

    def interrupt(seconds: float) -> None:
        if seconds == 0.05:
            raise KeyboardInterrupt
        original(seconds)

    original = time.sleep
    monkeypatch.setattr(time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        found({"a": ticker})
    assert ticker.calls == ["made", "open", "close"]
