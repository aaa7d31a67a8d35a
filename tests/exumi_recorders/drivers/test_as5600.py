"""The encoder's driver on a simulated bus."""

import errno
import importlib
import math
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from exumi_data.errors import MissingExtraError
from exumi_data.simulation import simulate_play
from exumi_recorders.contract import DeviceError, DeviceLostError, Event, Sample
from exumi_recorders.drivers.as5600 import As5600, As5600Options, SimulatedEncoder
from exumi_recorders.drivers.registry import find_driver
from exumi_recorders.simulated.as5600_chip import As5600Chip
from exumi_recorders.simulated.bus import SimulatedBus, gripper_counts
from exumi_recorders.testing import check_driver


def still(counts: float = 0.0, gap_mm: float = 2.0) -> SimulatedBus:
    return SimulatedBus(As5600Chip(lambda _: counts, gap_mm))


def way_to(bus: SimulatedBus) -> Callable[[], Any]:
    """How the driver gets at a bus: as an object, or by smbus2 (see scripts/device_shim)."""
    if "EXUMI_I2C_SHIM" not in os.environ:
        return lambda: bus
    opener: Callable[[], Any] = importlib.import_module("served").served_bus(bus)
    return opener


def opened(bus: SimulatedBus, **options: Any) -> As5600:
    driver = As5600(As5600Options(**options), way_to(bus))
    driver.open()
    return driver


def read_for(driver: As5600, seconds: float) -> list[Sample]:
    until = time.monotonic() + seconds
    items: list[Sample | Event] = []
    while time.monotonic() < until:
        items += driver.read(0.05)
    return [item for item in items if isinstance(item, Sample)]


def counts_of(samples: list[Sample]) -> np.ndarray:
    return np.frombuffer(b"".join(sample.payload for sample in samples), "<u2")


def test_it_keeps_the_contract() -> None:
    buses: list[SimulatedBus] = []

    def open_bus() -> Any:
        buses.append(still(1234))
        return way_to(buses[-1])()

    check_driver(lambda: As5600(As5600Options(), open_bus), seconds=0.5)
    deadline = time.monotonic() + 5.0
    while any(bus.is_open for bus in buses) and time.monotonic() < deadline:
        time.sleep(0.01)  # a device's file tells the other side a little later
    assert not any(bus.is_open for bus in buses)
    assert not any(bus.chip.writes for bus in buses)


def test_it_records_the_truth_at_its_stamps() -> None:
    session = simulate_play(seed=4, duration_s=3.0)
    epoch_ns = time.monotonic_ns() - 600_000_000
    bus = SimulatedBus(As5600Chip(gripper_counts(session, epoch_ns)), transfer_s=0.0002)
    driver = opened(bus, rate_hz=200)
    samples = read_for(driver, 0.6)
    times_s = np.array([sample.time_host_ns - epoch_ns for sample in samples]) / 1e9
    true = session.encoder.zero_count + session.encoder.counts_per_m * session.truth.width_m(
        times_s
    )
    off = (counts_of(samples).astype(float) - true + 2048) % 4096 - 2048
    assert len(samples) > 60
    # Half a count by rounding, and what it turns in a bracket that this machine made longer.
    assert np.median(np.abs(off)) <= 0.5
    assert np.mean(np.abs(off) < 1.0) > 0.9


def test_turns_are_counted_from_home() -> None:
    falls_ns = math.inf

    def counts(now_ns: int) -> float:
        """Closed at first, then two and a half turns in a second, falling."""
        return 500.0 - 10_240 * min(max((now_ns - falls_ns) / 1e9, 0.0), 1.0)

    driver = opened(SimulatedBus(As5600Chip(counts)), home=510)
    assert driver.ports[0].metadata == {"raw": {"unit": "count"}}
    first = read_for(driver, 0.3)
    assert all(sample.flags & 8 for sample in first)
    assert any("turn is not known" in text for text in driver.health().problems)
    assert driver.health().readings["count"] == 500
    until = time.monotonic() + 20
    while driver.health().problems and time.monotonic() < until:
        read_for(driver, 0.1)  # it is held still until its turn is known
    falls_ns = time.monotonic_ns()
    samples = read_for(driver, 1.2)
    driver.close()
    known = [sample for sample in samples if not sample.flags & 8]
    found = np.frombuffer(b"".join(sample.payload for sample in known), "<i4")
    true = np.array([counts(sample.time_host_ns) for sample in known])
    off = np.abs(found - true)
    assert np.quantile(off, 0.9) < 10  # a millisecond of the fastest
    assert off.max() < 2048  # whatever else the machine does: never a turn
    stood_still_ns = np.diff([sample.time_host_ns for sample in samples]).max()
    if stood_still_ns < 50_000_000:
        assert driver.health().problems == ()
        assert len(found) > 200
        assert found[-1] == 500 - 10_240
    else:  # long enough to miss half a turn: that is told, and nothing more is said to be known
        assert any("turn is not known" in text for text in driver.health().problems)
        assert samples[-1].flags & 8


def test_the_schedule_has_no_drift() -> None:
    driver = opened(still(), rate_hz=250)
    samples = read_for(driver, 0.8)
    times_ns = np.array([sample.time_host_ns for sample in samples])
    late = driver.health().lost["late"]
    # Each on its own place of the grid, however late the one before it was.
    place = np.round((times_ns - times_ns[0]) / 4_000_000)
    assert len(samples) + late >= 190
    assert place[-1] == pytest.approx(len(samples) - 1 + late, abs=2)
    assert np.median(np.abs(times_ns - times_ns[0] - place * 4_000_000)) < 1_000_000


def test_a_reading_of_zero_is_a_reading() -> None:
    samples = read_for(opened(still(0.0)), 0.05)
    assert samples
    assert {sample.payload for sample in samples} == {b"\0\0"}
    assert {sample.flags for sample in samples} == {0}


def test_without_a_magnet_samples_are_invalid_and_the_operator_is_told() -> None:
    bus = still(7)
    driver = opened(bus, status_hz=20.0)
    assert {sample.flags for sample in read_for(driver, 0.04)} == {0}
    bus.chip.magnet_gap_mm = float("inf")
    read_for(driver, 0.1)
    assert {sample.flags for sample in read_for(driver, 0.04)} == {1 << 3}
    health = driver.health()
    assert health.readings["magnet"] is False
    assert "no magnet" in health.problems[0]
    bus.chip.magnet_gap_mm = 2.0
    read_for(driver, 0.1)
    assert {sample.flags for sample in read_for(driver, 0.04)} == {0}


@pytest.mark.parametrize(
    ("gap_mm", "said"),
    [
        (2.0, None),
        (0.5, "too strong"),
        (3.0, "too weak"),
        (1.1, "rather close to the chip"),
        (2.5, "rather far from the chip"),
    ],
)
def test_the_magnet_is_judged(gap_mm: float, said: str | None) -> None:
    health = opened(still(7, gap_mm)).health()
    assert health.readings["magnet"] is True
    assert health.readings["magnitude"]
    assert len(health.problems) == (said is not None)
    assert said is None or said in health.problems[0]


def test_at_5_volts_the_gain_has_twice_the_range() -> None:
    assert opened(still(7), supply="3.3V").health().problems == ()
    chip = still(7, 1.3)
    assert "close to" in opened(chip, supply="5V").health().problems[0]


def test_the_filters_are_recorded_and_the_bracket_is_the_uncertainty() -> None:
    bus = still(7)
    bus.write_i2c_block_data(0x36, 0x07, [0x1F, 0x00])
    driver = As5600(As5600Options(), way_to(bus))
    driver.open()
    items = driver.read(0.05)
    assert isinstance(items[0], Event)
    assert (items[0].name, dict(items[0].detail)) == ("controls", {"conf": 0x1F00, "zmco": 0})
    driver.read(0.05)
    sigma_ns = driver.health().stamp_sigma_ns
    assert sigma_ns is not None
    assert 100 < sigma_ns < 50_000_000


def test_single_failures_are_counted_and_samples_go_on() -> None:
    bus = still(7)
    driver = opened(bus, status_hz=1.0)
    bus.fail(errno.EREMOTEIO, 3)
    assert read_for(driver, 0.05)
    assert driver.health().lost["bus"] == 3
    assert driver.health().problems == ()


def test_a_bus_that_nobody_drives_gives_no_samples() -> None:
    class Floating(SimulatedBus):
        def transfer(self, address: int, data: bytes, count: int) -> bytes:
            given = super().transfer(address, data, count)
            return b"\xff\xff" if data == b"\x0c" else given

    driver = opened(Floating(As5600Chip(lambda _: 7.0)))
    assert read_for(driver, 0.05) == []
    assert driver.health().lost["rejected"] > 3


def test_an_unplugged_encoder_is_lost_within_a_second_and_comes_back() -> None:
    bus = still(7)
    driver = opened(bus)
    read_for(driver, 0.02)
    bus.is_plugged = False
    began = time.monotonic()
    with pytest.raises(DeviceLostError, match="not answered"):
        read_for(driver, 2.0)
    assert time.monotonic() - began < 1.0
    assert driver.health().problems[-1].startswith("The encoder's bus fails")
    driver.close()
    with pytest.raises(DeviceError, match="no AS5600 answers at address 0x36"):
        driver.open()
    bus.is_plugged = True
    driver.open()
    assert read_for(driver, 0.02)


def test_a_bus_that_fails_slowly_is_lost_within_a_second() -> None:
    class Stuck(SimulatedBus):
        stuck = False

        def transfer(self, address: int, data: bytes, count: int) -> bytes:
            if self.stuck:
                time.sleep(0.3)
                raise TimeoutError(errno.ETIMEDOUT, "timed out")
            return super().transfer(address, data, count)

    bus = Stuck(As5600Chip(lambda _: 7.0))
    driver = opened(bus)
    bus.stuck = True
    began = time.monotonic()
    with pytest.raises(DeviceLostError):
        read_for(driver, 3.0)
    assert time.monotonic() - began < 1.0


def raising(error: Exception) -> Callable[[], Any]:
    def open_bus() -> Any:
        raise error

    return open_bus


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (FileNotFoundError(2, "no"), "/dev/i2c-3: there is no such bus"),
        (PermissionError(13, "no"), "usermod -aG i2c"),
        (OSError(16, "busy"), "cannot be opened"),
    ],
)
def test_what_keeps_a_bus_from_opening_is_told(error: Exception, said: str) -> None:
    driver = As5600(As5600Options(bus=3), raising(error))
    with pytest.raises(DeviceError, match=said):
        driver.open()


def test_without_smbus2_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "smbus2", None)
    driver = As5600(As5600Options())
    with pytest.raises(MissingExtraError, match=r'pip install "exumi-data\[record\]"'):
        driver.open()


def test_a_rig_may_ask_for_a_simulated_one() -> None:
    kind = find_driver("as5600")
    simulated = {"seed": 1, "duration_s": 3.0, "epoch_ns": time.monotonic_ns()}
    options = kind.options.model_validate({"rate_hz": 500, "simulated": simulated})
    check_driver(lambda: kind.make(options), seconds=0.2)


def test_a_simulated_one_is_away_when_it_is_told_to_be() -> None:
    simulated = SimulatedEncoder(
        seed=1, duration_s=3.0, epoch_ns=time.monotonic_ns(), away_s=[(-1.0, 1000.0)]
    )
    with pytest.raises(DeviceError, match="simulated bus: no AS5600 answers"):
        As5600(As5600Options(simulated=simulated)).open()


@pytest.mark.parametrize(
    "wrong", [{"bus": -1}, {"rate_hz": 0}, {"rate_hz": 2000}, {"adress": 0x36}, {"supply": "12V"}]
)
def test_wrong_options_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        As5600Options.model_validate(wrong)
