"""The taxels' driver, on a pseudo-terminal that another process speaks the real frames to."""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from exumi_data.errors import MissingExtraError
from exumi_recorders.contract import DeviceError, DeviceLostError, Sample
from exumi_recorders.drivers.tac02 import Tac02, Tac02Options
from exumi_recorders.drivers.tac02_frames import CELLS, VALID, FrameCutter, decode, encode
from exumi_recorders.simulated.play import SimulatedPlay
from exumi_recorders.simulated.tac02 import Fault, SimulatedTac02, taxel_values
from exumi_recorders.testing import check_driver


def grids(seed: int, count: int) -> np.ndarray:
    values = np.random.default_rng(seed).integers(0, 4096, (count, 11, 6)).astype(np.int16)
    values[:, ~VALID] = 3500
    return values


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedTac02]:
    """One for all tests."""
    link = tmp_path_factory.mktemp("tac02") / "tac"
    play = SimulatedPlay(seed=3, duration_s=40.0, epoch_ns=time.monotonic_ns())
    with SimulatedTac02(play, "left", link) as started:
        yield started


def opened(device: SimulatedTac02) -> Tac02:
    driver = Tac02(Tac02Options(side="left", port=device.port))
    driver.open()
    return driver


def read_for(driver: Tac02, seconds: float) -> list[Sample]:
    until = time.monotonic() + seconds
    items: list[Sample] = []
    while time.monotonic() < until:
        items += (item for item in driver.read(0.05) if isinstance(item, Sample))
    return items


def values_of(samples: list[Sample]) -> np.ndarray:
    return np.frombuffer(b"".join(item.payload for item in samples), "<i2").reshape(-1, 11, 6)


# -------------------------------------------------------------------------------------- frames


def test_each_word_is_one_cell_and_two_corners_are_none() -> None:
    assert sorted(CELLS[VALID]) == list(range(64))
    assert np.argwhere(~VALID).tolist() == [[0, 0], [0, 5]]


def test_words_are_twelve_bits_high_nibbles_first() -> None:
    frame = bytearray(102)
    frame[0:3] = b"\xab\xc1\x23"  # words 0 and 1
    frame[94:96] = b"\x07\xff"  # the lower nibble of 62's middle, and all of 63
    (values,) = decode(bytes(frame))
    assert values[CELLS == 0] == 0xABC
    assert values[CELLS == 1] == 0x123
    assert values[CELLS == 63] == 0x7FF
    assert (values[~VALID] == 3500).all()


def test_frames_read_back() -> None:
    values = grids(1, 5)
    assert len(encode(values)) == 5 * 102
    np.testing.assert_array_equal(decode(encode(values)), values)


def test_bursts_are_cut_and_stamped_with_their_last_byte() -> None:
    data = encode(grids(2, 3))
    cutter = FrameCutter()
    assert cutter.feed(data[:102], 5) == [(5, data[:102])]
    assert cutter.feed(data[:150], 6) == []
    within = cutter.is_within
    assert cutter.feed(data[150:306], 7) == [
        (6, data[:102]),
        (7, data[102:204]),
        (7, data[204:]),
    ]
    assert (within, cutter.is_within) == (True, False)
    assert cutter.refused == 0


@pytest.mark.parametrize(("count", "refused"), [(1, 1), (101, 1), (103, 2), (203, 2)])
def test_a_burst_that_is_no_frames_is_refused_as_a_whole(count: int, refused: int) -> None:
    data = encode(grids(3, 3))
    cutter = FrameCutter()
    assert cutter.feed(data[:count], 1) == []
    cutter.pause()
    assert cutter.refused == refused
    assert cutter.feed(data[:102], 2) == [(2, data[:102])]


def test_a_burst_without_an_end_takes_no_memory() -> None:
    cutter = FrameCutter()
    for _ in range(1000):
        cutter.feed(b"\0" * 101, 1)
    assert cutter.refused > 900
    assert len(cutter._held) <= 66 * 102


# -------------------------------------------------------------------------------------- device


def test_it_keeps_the_contract(device: SimulatedTac02) -> None:
    options = Tac02Options(side="left", port=device.port, rate_hz=1000)
    check_driver(lambda: Tac02(options), seconds=0.4)


def test_what_is_recorded_is_the_truth_at_up_to_a_thousand_a_second(
    device: SimulatedTac02,
) -> None:
    driver = opened(device)
    samples, peak = read_for(driver, 0.5), 0
    deadline = time.monotonic() + 15.0
    while peak < 200 and time.monotonic() < deadline:  # until something is touched
        samples += read_for(driver, 0.1)
        peak = max(peak, int(driver.health().readings["peak"]))
    driver.close()
    times_s = (np.array([item.time_host_ns for item in samples]) - device.play.epoch_ns) / 1e9
    values = values_of(samples)
    # A busy machine that stands still lets the port's few kilobytes run over.
    stood_still = np.diff(times_s).max() > 0.02
    assert driver.health().lost == {"framing": 0} or stood_still
    # In tenths of a second in which the machine did not stand still.
    tenths, _ = np.histogram(times_s, np.arange(times_s[0], times_s[-1], 0.1))
    assert np.quantile(tenths, 0.8) > 70
    # Each is the truth of a whole millisecond, a little before its host time.
    sent = taxel_values(
        device.play.session(), "left", np.arange(int(times_s[-1] * 1000) + 1) / 1000
    )
    last = np.floor(times_s * 1000).astype(int)
    early = np.array([(sent[last - n] == values).all(axis=(1, 2)) for n in range(500)])
    assert early.any(axis=0).all()
    assert np.median(early.argmax(axis=0)) <= 2
    assert 3500 - values.min() >= 200


class Transfers:
    """USB transfers one by one; an empty one stands for a while without any."""

    def __init__(self, chunks: list[bytes]) -> None:
        self._chunks = chunks

    def receive(self, timeout_s: float) -> bytes:
        if self._chunks:
            return self._chunks.pop(0)
        time.sleep(max(timeout_s, 0.0))
        return b""

    def close(self) -> None:
        pass


def test_a_usb_frame_is_one_transfer_or_two_packets(monkeypatch: pytest.MonkeyPatch) -> None:
    values = grids(4, 5)
    a, b, c, d, e = (encode(values[k : k + 1]) for k in range(5))
    source = Transfers([a, b[:64], b[64:], c[:64], b"", d, e[:64], e[:64], e])
    monkeypatch.setattr(Tac02, "_find", lambda _: source)
    driver = Tac02(Tac02Options(side="left"))
    driver.open()
    found = values_of(read_for(driver, 0.05))
    np.testing.assert_array_equal(found, values[[0, 1, 3, 4]])
    assert driver.health().lost["framing"] == 3  # the rest of c, and e twice


def test_garbage_and_cut_frames_are_counted_and_all_else_is_right(device: SimulatedTac02) -> None:
    driver = opened(device)
    samples = []
    for _ in range(3):
        device.fail("garbage", 41)
        samples += read_for(driver, 0.03)
        device.fail("partial", 77)
        samples += read_for(driver, 0.03)
    until_s = time.monotonic() + 5.0
    while len(samples) <= 40 and time.monotonic() < until_s:
        samples += read_for(driver, 0.03)
    driver.close()
    # How many depends on how much was waiting: a burst with a cut frame in it is refused whole.
    assert driver.health().lost["framing"] >= 6
    assert "came broken" in driver.health().problems[0]
    assert len(samples) > 40
    times_s = np.arange(40_000) / 1000
    known = {row.tobytes() for row in taxel_values(device.play.session(), "left", times_s)}
    assert all(item.payload in known for item in samples)


def test_an_unplugged_device_is_lost_at_once_and_comes_back(device: SimulatedTac02) -> None:
    driver = opened(device)
    assert read_for(driver, 0.05)
    device.fail("unplug", 0.3)
    began = time.monotonic()
    with pytest.raises(DeviceLostError, match="the serial device is gone"):
        read_for(driver, 5.0)
    assert time.monotonic() - began < 1.0
    driver.close()
    with pytest.raises(DeviceError):
        driver.open()
    deadline = time.monotonic() + 5.0
    while not Path(device.port).exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    driver.open()
    assert read_for(driver, 0.1)
    driver.close()


def test_a_silent_device_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exumi_recorders.drivers.tac02._SILENT_S", 0.05)
    ours, theirs = os.openpty()
    driver = Tac02(Tac02Options(side="right", port=os.ttyname(theirs)))
    driver.open()
    assert driver.health().problems == ()
    assert read_for(driver, 0.1) == []
    assert "right taxels have sent nothing" in driver.health().problems[0]
    driver.close()
    assert driver.health().problems == ()
    os.close(ours)
    os.close(theirs)


def test_the_dead_cells_and_the_unit_are_in_the_port() -> None:
    (port,) = Tac02(Tac02Options(side="left", rate_hz=1000)).ports
    assert port.valid is not None
    np.testing.assert_array_equal(port.valid, VALID)
    assert port.metadata == {"grid": [11, 6], "unit": "adc", "sign": -1, "offset": 3500.0}
    assert port.sensor is not None
    assert (port.sensor.model, port.sensor.side) == ("tac-02", "left")
    assert not port.droppable


def test_a_port_that_is_not_there() -> None:
    driver = Tac02(Tac02Options(side="left", port="/dev/exumi-no-such-port"))
    with pytest.raises(DeviceError, match=r"No such file or directory.*Is it plugged in"):
        driver.open()


def test_a_port_that_is_in_use(device: SimulatedTac02) -> None:
    first, second = (Tac02(Tac02Options(side="left", port=device.port)) for _ in range(2))
    first.open()
    with pytest.raises(DeviceError, match="cannot be opened"):
        second.open()
    first.close()


def test_without_pyserial_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(MissingExtraError, match=r'pip install "exumi-data\[record\]"'):
        Tac02(Tac02Options(side="left", port="/dev/null")).open()


def test_a_simulated_device_ends_with_whoever_started_it(tmp_path: Path) -> None:
    device = SimulatedTac02(SimulatedPlay(epoch_ns=0), "left", tmp_path / "tac")
    process = device._process
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(timeout=10) == 0
    assert not (tmp_path / "tac").exists()
    device.close()


def test_a_fault_reads_back() -> None:
    fault = Fault(1.5, "garbage", 37.0)
    assert Fault.from_text(str(fault)) == fault
    with pytest.raises(ValueError, match="smoke"):
        Fault.from_text("1:smoke:2")
