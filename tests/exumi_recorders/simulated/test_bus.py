"""The simulated AS5600 behaves as its data sheet says."""

import errno
import time

import numpy as np
import pytest

from exumi_data.simulation import simulate_play
from exumi_recorders.simulated.as5600_chip import As5600Chip
from exumi_recorders.simulated.bus import SimulatedBus, gripper_counts

STATUS, RAW, ANGLE, AGC, MAGNITUDE = 0x0B, 0x0C, 0x0E, 0x1A, 0x1B


def bus_at(counts: float, gap_mm: float = 2.0) -> SimulatedBus:
    return SimulatedBus(As5600Chip(lambda _: counts, gap_mm))


def pair(bus: SimulatedBus, register: int) -> int:
    high, low = bus.read_i2c_block_data(0x36, register, 2)
    return high << 8 | low


@pytest.mark.parametrize(("counts", "raw"), [(0, 0), (4095, 4095), (4096.4, 0), (-1, 4095)])
def test_raw_angle_wraps(counts: float, raw: int) -> None:
    bus = bus_at(counts)
    assert pair(bus, RAW) == raw
    assert bus.read_word_data(0x36, RAW) == (raw & 0xFF) << 8 | raw >> 8


@pytest.mark.parametrize("register", [RAW, ANGLE, MAGNITUDE])
def test_the_pointer_stays_on_the_three_pairs(register: int) -> None:
    bus = bus_at(0x0ABC)
    high, low = bus.read_i2c_block_data(0x36, register, 2)
    assert bus.read_i2c_block_data(0x36, register, 5) == [high, low, high, low, high]
    assert bus.read_byte(0x36) == high


def test_the_pointer_goes_on_elsewhere() -> None:
    bus = bus_at(0x0ABC)
    assert bus.read_i2c_block_data(0x36, 0x0D, 2) == [0xBC, 0x0A]  # then to ANGLE's high byte
    bus.write_byte(0x36, AGC)
    assert bus.read_byte(0x36) == bus.read_byte_data(0x36, AGC)
    bus.write_byte(0x36, AGC)
    bus.read_byte(0x36)
    assert bus.read_byte(0x36) == bus.read_byte_data(0x36, MAGNITUDE)


def test_angle_is_calm_at_the_wrap_and_raw_angle_is_not() -> None:
    seen = []
    turn = iter([4000, 4095, 4096, 4105, 4106, 4097, 4095, 4087, 4086, 4085, 4200])
    now = [0.0]
    bus = SimulatedBus(As5600Chip(lambda _: now[0]))
    for now[0] in turn:
        seen.append((pair(bus, RAW), pair(bus, ANGLE)))
    assert seen == [
        (4000, 4000),
        (4095, 4095),
        (0, 4095),
        (9, 4095),
        (10, 10),
        (1, 1),
        (4095, 0),
        (4087, 0),
        (4086, 0),
        (4085, 4085),
        (104, 104),
    ]


def test_angle_counts_from_the_zero_position_and_over_the_range() -> None:
    bus = bus_at(1500)
    bus.write_i2c_block_data(0x36, 0x01, [1000 >> 8, 1000 & 0xFF])
    assert (pair(bus, RAW), pair(bus, ANGLE)) == (1500, 500)
    bus.write_i2c_block_data(0x36, 0x03, [2000 >> 8, 2000 & 0xFF])
    assert (pair(bus, RAW), pair(bus, ANGLE)) == (1500, 2048)


@pytest.mark.parametrize(
    ("gap_mm", "bits", "agc"),
    [
        (2.0, 0b100000, range(55, 74)),
        (0.5, 0b101000, range(1)),
        (3.5, 0b110000, range(128, 129)),
        (6.0, 0b010000, range(128, 129)),
        (float("inf"), 0b010000, range(128, 129)),
    ],
)
def test_the_magnets_distance_shows(gap_mm: float, bits: int, agc: range) -> None:
    bus = bus_at(7, gap_mm)
    assert bus.read_byte_data(0x36, STATUS) == bits
    assert bus.read_byte_data(0x36, AGC) in agc
    assert pair(bus, MAGNITUDE) <= 4095
    assert (pair(bus, MAGNITUDE) < 2000) == (gap_mm > 2.6)


def test_what_is_written_is_kept_in_mind() -> None:
    bus = bus_at(7)
    bus.write_byte_data(0x36, 0xFF, 0x80)
    bus.write_byte_data(0x36, STATUS, 0)
    assert bus.chip.burns == [0x80]
    assert bus.chip.writes == [(0xFF, b"\x80"), (STATUS, b"\0")]
    assert bus.read_byte_data(0x36, STATUS) == 0b100000


def test_faults() -> None:
    bus = bus_at(7)
    bus.fail(errno.ETIMEDOUT, 2)
    for _ in range(2):
        with pytest.raises(TimeoutError):
            bus.read_byte_data(0x36, STATUS)
    assert pair(bus, RAW) == 7
    with pytest.raises(OSError, match="Remote I/O"):
        bus.read_byte_data(0x40, STATUS)
    bus.is_plugged = False
    with pytest.raises(OSError, match="Remote I/O"):
        bus.read_byte_data(0x36, STATUS)
    bus.is_plugged = True
    bus.away_ns = ((0, time.monotonic_ns() + 10**12),)
    with pytest.raises(OSError, match="Remote I/O"):
        bus.read_byte_data(0x36, STATUS)


def test_it_turns_with_the_gripper() -> None:
    session = simulate_play(seed=4, duration_s=12.0)
    counts = gripper_counts(session, epoch_ns=10**12)
    times_s = np.random.default_rng(1).uniform(0.0, 12.0, 3000)
    given = np.array([counts(10**12 + int(time_s * 1e9)) for time_s in times_s])
    encoder = session.encoder
    true = encoder.zero_count + encoder.counts_per_m * session.truth.width_m(times_s)
    assert np.ptp(true) > 200
    assert np.abs(given - true).max() < 0.1
    assert counts(0) == pytest.approx(counts(10**12))
    assert counts(2 * 10**12) == pytest.approx(counts(10**12 + 12 * 10**9), abs=0.1)


def test_a_transfer_keeps_the_bus_and_takes_its_value_midway() -> None:
    began = time.monotonic_ns()
    bus = SimulatedBus(As5600Chip(lambda now_ns: (now_ns - began) / 1e6), transfer_s=0.02)
    before = time.monotonic_ns()
    taken_ms = pair(bus, RAW)
    after = time.monotonic_ns()
    assert after - before >= 20_000_000
    assert (before - began) / 1e6 + 9 <= taken_ms <= (after - began) / 1e6 - 9
