"""The telemetry reader: what it reads is what was written, and damage never harms."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.clips.gpmf import GyroTrack, Payload, read_gyro
from exumi_data.simulation.gopro import gpmf_payload

RATE_HZ = 200.0
PAYLOAD_S = 1.001


def made(seconds: float = 6.0) -> tuple[np.ndarray, np.ndarray, list[Payload]]:
    time_s = (np.arange(int(seconds * RATE_HZ)) + 0.5) / RATE_HZ
    values = np.stack([np.sin(time_s), np.cos(2 * time_s), 0.1 * time_s], axis=1)
    payloads = []
    for number in range(int(seconds / PAYLOAD_S) + 1):
        edges = [number * PAYLOAD_S, (number + 1) * PAYLOAD_S]
        first, last = np.searchsorted(time_s, edges).tolist()
        data = gpmf_payload(values[first:last], total=last, device="HERO12 Black")
        payloads.append(Payload(number * PAYLOAD_S, PAYLOAD_S, data))
    return time_s, values, payloads


def read(payloads: list[Payload]) -> GyroTrack:
    found = read_gyro(payloads)
    assert found is not None
    return found


def test_what_was_written_is_read() -> None:
    time_s, values, payloads = made()
    gyro = read(payloads)
    assert np.abs(gyro.rad_per_s - values).max() < 1 / 939
    assert np.abs(gyro.time_s - time_s).max() < 0.6 / RATE_HZ
    assert gyro.device == "HERO12 Black"
    assert gyro.problem is None
    assert 0 < gyro.sigma_s < 2e-3


def test_a_payload_that_is_missing_leaves_a_hole_and_moves_nothing() -> None:
    time_s, values, payloads = made()
    kept = [*payloads[:2], *payloads[3:]]
    gyro = read(kept)
    hole = (time_s > 2 * PAYLOAD_S) & (time_s < 3 * PAYLOAD_S)
    assert len(gyro.time_s) == np.count_nonzero(~hole)
    assert np.abs(gyro.time_s - time_s[~hole]).max() < 0.6 / RATE_HZ
    assert np.abs(gyro.rad_per_s - values[~hole]).max() < 1 / 939


def test_a_payload_without_gyroscope_is_told() -> None:
    payloads = made()[2]
    payloads[1] = Payload(payloads[1].start_s, PAYLOAD_S, b"DEVC\0\1\0\0")
    assert read(payloads).problem == "1 of 6 parts have no gyroscope"


def test_one_payload_is_spread_over_its_duration() -> None:
    time_s, _, payloads = made(0.9)
    gyro = read([Payload(0.0, 0.9, payloads[0].data)])
    assert np.abs(gyro.time_s - time_s).max() < 1e-6


@pytest.mark.parametrize(
    "payloads",
    [
        [],
        [Payload(0.0, 1.0, b"")],
        [Payload(0.0, 1.0, gpmf_payload(np.zeros((0, 3)), total=0))],
        [Payload(0.0, 0.0, gpmf_payload(np.zeros((200, 3)), total=200))],  # in no time at all
        [Payload(0.0, 1e6, gpmf_payload(np.zeros((200, 3)), total=200))],
        [Payload(5.0, 1.0, gpmf_payload(np.zeros((200, 3)), total=200))] * 2,
        [
            Payload(
                0.0, 1.0, gpmf_payload(np.full((9, 3), 30.0), total=9).replace(b"\x03\xab", b"\0\1")
            )
        ],
        [Payload(0.0, 1.0, gpmf_payload(np.zeros((9, 3)), total=9).replace(b"\x03\xab", b"\0\0"))],
    ],
)
def test_nonsense_is_no_gyroscope(payloads: list[Payload]) -> None:
    assert read_gyro(payloads) is None


def test_a_count_that_cannot_be_right_stays_within_the_clip() -> None:
    _, values, payloads = made()
    far = gpmf_payload(values[:200], total=4_000_000_000)
    payloads[-1] = Payload(payloads[-1].start_s, PAYLOAD_S, far)
    found = read_gyro(payloads)
    assert found is None or found.between(-1.0, 7.0) is None or len(found.time_s) < 2000
    gyro = read(made()[2])
    assert gyro.between(100.0, 200.0) is None
    part = gyro.between(1.0, 2.0)
    assert part is not None
    assert len(part.time_s) == len(part.rad_per_s) == 200


def test_scales_for_each_axis() -> None:
    plain = gpmf_payload(np.full((180, 3), 1.0), total=180)
    one = struct.pack(">4scBHh", b"SCAL", b"s", 2, 1, 939) + bytes(2)
    three = struct.pack(">4scBHhhh", b"SCAL", b"s", 2, 3, 939, 313, 939) + bytes(2)
    assert plain.count(one) == 1
    # Lengths of the two levels around it grow by four bytes.
    changed = bytearray(plain.replace(one, three))
    for key in (b"DEVC", b"STRM"):
        at = changed.index(key) + 6
        size = int.from_bytes(changed[at : at + 2], "big") + 4
        changed[at : at + 2] = size.to_bytes(2, "big")
    gyro = read([Payload(0.0, 0.9, bytes(changed))])
    assert np.allclose(gyro.rad_per_s, [1.0, 3.0, 1.0], atol=1e-3)


@given(st.integers(0, 1400))
def test_a_cut_payload_gives_nothing_or_what_was_there(length: int) -> None:
    payload = made(1.0)[2][0].data
    found = read_gyro([Payload(0.0, PAYLOAD_S, payload[: min(length, len(payload) - 1)])])
    assert found is None


@given(st.lists(st.tuples(st.integers(0, 1300), st.integers(0, 255)), min_size=1, max_size=12))
def test_damage_never_harms(changes: list[tuple[int, int]]) -> None:
    _, _, payloads = made(3.0)
    damaged = bytearray(payloads[1].data)
    for at, value in changes:
        damaged[at % len(damaged)] = value
    payloads[1] = Payload(payloads[1].start_s, PAYLOAD_S, bytes(damaged))
    found = read_gyro(payloads)
    if found is not None:
        assert np.isfinite(found.time_s).all()
        assert (np.diff(found.time_s) > 0).all()
        assert found.rad_per_s.shape == (len(found.time_s), 3)
        assert np.isfinite(found.rad_per_s).all()
