"""Datagrams with the kernel's stamps."""

import socket
import time
from collections.abc import Iterator

import pytest

from exumi_recorders.contract import DeviceError, DeviceLostError
from exumi_recorders.drivers.stamped_udp import (
    ClockPair,
    StampedSocket,
    take_clock_pair,
    to_monotonic,
)

S = 1_000_000_000


@pytest.fixture
def hub() -> Iterator[StampedSocket]:
    opened = StampedSocket("127.0.0.1", 0, buffer_bytes=1 << 20, max_bytes=100)
    yield opened
    opened.close()


@pytest.fixture
def app() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        yield opened


def wait_for_stamps(hub: StampedSocket, app: socket.socket) -> None:
    for _ in range(500):
        app.sendto(b"?", hub.address)
        time.sleep(0.002)
        now = time.monotonic_ns()
        if any(datagram.time_ns < now for datagram in hub.receive(0.1)):
            return
    raise AssertionError("the kernel does not stamp")


def test_the_stamp_is_of_arrival_not_of_reading(hub: StampedSocket, app: socket.socket) -> None:
    wait_for_stamps(hub, app)
    sent = []
    for number in range(5):
        before = time.monotonic_ns()
        app.sendto(b"%d" % number, hub.address)
        sent.append((before, time.monotonic_ns()))
        time.sleep(0.01)
    found = hub.receive(0.1)
    assert [datagram.data for datagram in found] == [b"0", b"1", b"2", b"3", b"4"]
    for (before, after), datagram in zip(sent, found, strict=True):
        # A loaded machine may delay the queueing, but not by the time until it is read.
        assert before - 100_000 <= datagram.time_ns <= after + 5_000_000
    assert {datagram.sender for datagram in found} == {("127.0.0.1", app.getsockname()[1])}
    assert 0 <= hub.stamp_sigma_ns < 1_000_000


def test_it_waits_no_longer_than_it_may(hub: StampedSocket) -> None:
    start = time.monotonic()
    assert hub.receive(0.05) == []
    assert 0.045 <= time.monotonic() - start < 1


def test_the_kernel_counts_what_it_drops(app: socket.socket) -> None:
    hub = StampedSocket("127.0.0.1", 0, buffer_bytes=1, max_bytes=100)
    try:
        for _ in range(200):
            app.sendto(b"x" * 100, hub.address)
        kept = len(hub.receive(0))
        assert kept < 200
        assert hub.dropped == 0, "the kernel tells with the next one"
        app.sendto(b"after", hub.address)
        assert [datagram.data for datagram in hub.receive(0.1)] == [b"after"]
        assert hub.dropped == 200 - kept
    finally:
        hub.close()


def test_what_is_too_long_is_seen_to_be(hub: StampedSocket, app: socket.socket) -> None:
    app.sendto(b"x" * 5000, hub.address)
    assert [len(datagram.data) for datagram in hub.receive(0.1)] == [101]


def test_an_address_in_use(hub: StampedSocket) -> None:
    with pytest.raises(DeviceError, match="cannot listen") as raised:
        StampedSocket("127.0.0.1", hub.address[1], buffer_bytes=1, max_bytes=1)
    assert raised.value.fix is not None
    assert "Another program" in raised.value.fix
    with pytest.raises(DeviceError, match="cannot listen") as raised:
        StampedSocket("192.0.2.1", 0, buffer_bytes=1, max_bytes=1)
    assert raised.value.fix is not None
    assert "an address of this machine" in raised.value.fix


def test_a_closed_socket_is_lost(hub: StampedSocket) -> None:
    hub.close()
    hub.close()
    with pytest.raises(DeviceLostError):
        hub.receive(0)


def test_a_reply_that_cannot_be_sent_is_dropped(hub: StampedSocket, app: socket.socket) -> None:
    app.bind(("127.0.0.1", 0))
    with pytest.raises(PermissionError):  # nobody may send to all without asking for it
        app.sendto(b"x", ("255.255.255.255", 9))
    hub.send(b"x", ("255.255.255.255", 9))
    app.sendto(b"after", hub.address)
    assert [datagram.data for datagram in hub.receive(1.0)] == [b"after"]
    hub.send(b"reply", app.getsockname())
    app.settimeout(1.0)
    assert app.recv(100) == b"reply"


def pair(monotonic_s: float, realtime_s: float) -> ClockPair:
    return ClockPair(round(monotonic_s * S), round(realtime_s * S), 100)


@pytest.mark.parametrize(
    ("stamp_s", "before", "after", "found_s"),
    [
        (1000.5, (10, 1000), (11, 1001), 10.5),
        # the clock was set forward or back by an hour, before or after the stamp
        (1000.5, (10, 1000), (11, 4601), 10.5),
        (4600.5, (10, 1000), (11, 4601), 10.5),
        (4600.5, (10, 4600), (11, 1001), 10.5),
        (1000.5, (10, 4600), (11, 1001), 10.5),
        # set twice between the pairs: unknown, but not later than now
        (9000, (10, 1000), (11, 1001), 11),
        (9000, (10, 1000), (11, 4601), 11),
        # from before the first pair, by the jitter of reading it
        (999.9999, (10, 1000), (11, 1001), 9.9999),
        # never in the future
        (1001.0001, (10, 1000), (11, 1001), 11),
    ],
)
def test_stamps_survive_a_clock_that_is_set(
    stamp_s: float, before: tuple[float, float], after: tuple[float, float], found_s: float
) -> None:
    found = to_monotonic(round(stamp_s * S), pair(*before), pair(*after))
    assert found == pytest.approx(found_s * S, abs=200)


def test_clock_pairs_are_of_now() -> None:
    start = time.monotonic_ns()
    found = take_clock_pair()
    assert start <= found.monotonic_ns <= time.monotonic_ns()
    assert abs(found.realtime_ns - time.time_ns()) < S
    assert found.offset_ns == found.monotonic_ns - found.realtime_ns
