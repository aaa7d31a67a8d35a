"""Queues: what is dropped, in which order, and that it is counted."""

import pytest

from exumi_recorders.contract import Sample
from exumi_recorders.journal.record import NONE, unpack_header
from exumi_recorders.recording.lanes import Lane, Limits, Pressure

S = 1_000_000_000


def make(
    pressure: Pressure, *, droppable: bool = False, fixed: int | None = None, start_ns: int = 0
) -> Lane:
    lane = Lane("s", 1, pressure, droppable=droppable, start_ns=start_ns, payload_bytes=fixed)
    pressure.lanes = (*pressure.lanes, lane)
    return lane


def numbers(pieces: list[bytes]) -> list[int]:
    headers = [unpack_header(piece) for piece in pieces[::2]]
    return [header.seq for header in headers if header is not None]


def test_the_newest_of_droppable_streams_are_dropped_and_numbered() -> None:
    pressure = Pressure(Limits(bytes=1000, age_s=100))
    camera, pose = make(pressure, droppable=True), make(pressure)
    for k in range(20):
        camera.put(Sample("camera", k, bytes(150)), 0, k)
        pose.put(Sample("pose", k, bytes(10)), 0, k)
    assert pose.dropped == 0
    assert len(pose.take()) == 2 * 20
    taken = camera.take()
    assert len(taken) + 2 * camera.dropped == 2 * 20
    assert camera.dropped > 10
    camera.done(taken)
    pose.done(pose.take())
    assert pressure.share(20) == 0
    camera.put(Sample("camera", 20, b"x"), 0, 20)
    assert numbers(camera.take()) == [20]  # the hole is what was dropped
    assert camera.written == len(taken) // 2


def test_age_counts_as_well() -> None:
    pressure = Pressure(Limits(age_s=2.0))
    lane = make(pressure, droppable=True)
    lane.put(Sample("s", 1, b"old"), 0, S)
    assert pressure.share(2 * S) == pytest.approx(0.5)
    lane.put(Sample("s", 2, b"new"), 0, 3 * S)
    assert lane.dropped == 1
    assert lane.age_ns(3 * S) == 2 * S


def test_only_what_was_stamped_within_the_episode_is_taken() -> None:
    lane = make(Pressure(Limits()), start_ns=100)
    for time_ns in (99, 100, 101):
        lane.put(Sample("s", time_ns, b""), 0, 200)
    lane.end_at(150)
    for time_ns in (150, 151):
        lane.put(Sample("s", time_ns, b""), 0, 200)
    assert len(lane.take()) == 2 * 3
    lane.close()
    lane.put(Sample("s", 120, b""), 0, 200)
    assert (len(lane.take()), lane.dropped) == (2 * 3, 1)


def test_what_the_port_did_not_promise_is_malformed() -> None:
    lane = make(Pressure(Limits()), fixed=4)
    lane.put(Sample("s", 1, b"abc"), 0, 2)
    lane.put(Sample("s", 1, b"abcd", time_device_ns=1 << 63), 0, 2)
    lane.put(Sample("s", 1, b"abcd", sequence=-(1 << 70)), 0, 2)
    lane.put(Sample("s", 5 * S, b"abcd"), 0, 2)  # a stamp of the future
    assert (lane.malformed, lane.take()) == (4, [])
    lane.put(Sample("s", 1, b"abcd", sequence=7), 3, 2)
    header = unpack_header(lane.take()[0])
    assert header is not None
    assert header[2:] == (0, 1, NONE, 7, 3)


def test_what_cannot_be_written_is_dropped() -> None:
    lane = make(Pressure(Limits()))
    for k in range(5):
        lane.put(Sample("s", k, b"abc"), 0, k)
    lane.close(give_up=True)
    assert (lane.dropped, lane.take(), lane.waiting_bytes) == (5, [], 0)
