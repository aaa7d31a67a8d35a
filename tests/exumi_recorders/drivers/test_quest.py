"""The Quest driver, by real datagrams of a simulated headset."""

import json
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from exumi_data.model.streams import PoseStream
from exumi_data.standard.registry import flags, stamp_points, units
from exumi_recorders.contract import DeviceError, Sample
from exumi_recorders.drivers.quest import Quest
from exumi_recorders.drivers.quest_options import QuestOptions
from exumi_recorders.drivers.registry import find_driver
from exumi_recorders.simulated.headset_options import HeadsetOptions
from exumi_recorders.simulated.headset_plan import plan
from exumi_recorders.simulated.headset_poses import session_truth
from exumi_recorders.world_frame import from_headset_world
from tests.exumi_recorders.drivers.listening import SESSION, Heard, Listening

LATE = flags()["out_of_order"].mask
QUIET: dict[str, Any] = {"noise_m": 0.0, "noise_rad": 0.0}
PORTS = {"a": {"pose", "headset"}, "b": {"pose"}, "c": {"pose"}, "d": {"pose", "headset"}}


@pytest.fixture(scope="module")
def listen() -> Listening:
    return Listening(session_truth(SESSION))


def pose_times_s(heard: Heard) -> np.ndarray:
    return np.array([each.pose_ns for each in heard.planned if each.pose_ns is not None]) * 1e-9


@pytest.mark.parametrize(("dialect", "rate"), [("a", 60), ("b", 72), ("c", 90), ("d", 90)])
def test_every_dialect_gives_the_truth_back(dialect: str, rate: int, listen: Listening) -> None:
    heard = listen(dialect=dialect, rate_hz=rate, lag_s=0.015, **QUIET)
    frame = heard.event("world_frame").detail["pose"]
    found = from_headset_world(heard.poses(), frame)
    expected = listen.truth.pose(pose_times_s(heard))
    # float32 numbers of seven digits
    assert_allclose(found[:, :3], expected[:, :3], atol=2e-6)
    assert_allclose(np.abs(np.einsum("ij,ij->i", found[:, 3:], expected[:, 3:])), 1, atol=1e-6)
    assert {sample.port for sample in heard.samples} == PORTS[dialect]
    assert heard.health.lost == {}
    assert heard.health.problems == ()
    assert heard.health.readings["dialect"] == dialect
    assert 0.4 * rate < float(heard.health.readings["rate_hz"]) < 1.2 * rate
    assert heard.health.readings["sender"] == "127.0.0.1"
    # Stamps are of arrival: after the time of sending, by little unless the machine stood still.
    due = [heard.sent.epoch_ns + each.send_ns for each in heard.planned if each.pose_ns is not None]
    late = np.array([sample.time_host_ns for sample in heard.of("pose")]) - due
    assert late.min() > -1_000_000
    assert np.quantile(late, 0.2) < 20_000_000


@pytest.mark.parametrize("dialect", ["a", "d"])
def test_two_hands_and_a_head(dialect: str, listen: Listening) -> None:
    heard = listen({"hand": "both"}, dialect=dialect, hand="both", **QUIET)
    frame = heard.event("world_frame").detail["pose"]
    left, right = (
        from_headset_world(heard.poses(f"pose_{side}"), frame) for side in ("left", "right")
    )
    assert len(left) == len(right) == len(heard.of("headset")) == heard.sent.poses
    assert_allclose(right[:, :3], listen.truth.pose(pose_times_s(heard))[:, :3], atol=2e-6)
    assert_allclose(left[:, :3] - right[:, :3], np.tile((0.3, 0, 0), (len(left), 1)), atol=4e-6)
    head = from_headset_world(heard.poses("headset"), frame)
    assert_allclose(head[:, :3], np.tile((0.05, -0.4, 0.45), (len(head), 1)), atol=0.02)


def test_what_dialect_d_adds(listen: Listening) -> None:
    heard = listen(dialect="d", device_drift_ppm=30.0)
    options = HeadsetOptions(device_drift_ppm=30.0)
    expected = [
        options.device_time_ns(each.pose_ns) for each in heard.planned if each.pose_ns is not None
    ]
    assert [sample.time_device_ns for sample in heard.of("pose")] == expected
    assert [sample.sequence for sample in heard.of("headset")] == list(range(len(expected)))
    assert heard.sent.trips > 0
    readings = heard.health.readings
    true_ns = heard.sent.epoch_ns - options.device_offset_ns
    error_ns = int(readings["clock_offset_ns"]) - true_ns
    assert abs(error_ns) <= float(readings["round_trip_ms"]) * 5e5 + 30e-6 * 1e9


def test_lost_late_and_twice_are_told_apart(listen: Listening) -> None:
    faults = {"lost": 0.15, "late": 0.1, "twice": 0.15}
    heard = listen(dialect="d", rate_hz=90, duration_s=0.8, faults=faults)
    came = [each.index for each in heard.planned if each.pose_ns is not None]
    unique = list(dict.fromkeys(came))
    assert len(came) > len(unique), "some come twice"
    assert unique != sorted(unique), "some come late"
    assert heard.health.lost["sequence"] == max(unique) - unique[0] + 1 - sum(
        index >= unique[0] for index in unique
    )
    assert heard.health.lost["rejected_twice"] == len(came) - len(unique)
    assert [sample.sequence for sample in heard.of("pose")] == unique
    behind = [index < max(unique[: i + 1]) for i, index in enumerate(unique)]
    assert [sample.flags == LATE for sample in heard.of("pose")] == behind
    assert heard.health.problems == ()


@pytest.mark.parametrize("dialect", ["a", "b"])
def test_without_sequence_numbers_all_that_comes_is_kept(dialect: str, listen: Listening) -> None:
    heard = listen(dialect=dialect, faults={"lost": 0.2, "late": 0.1, "twice": 0.1})
    assert len(heard.of("pose")) == heard.sent.poses
    assert {sample.flags for sample in heard.samples} == {0}
    assert heard.health.lost == {}


def test_bursts_are_stamped_one_by_one(listen: Listening) -> None:
    heard = listen(dialect="b", rate_hz=90, faults={"burst_s": 0.1})
    times = np.array([sample.time_host_ns for sample in heard.of("pose")])
    assert len(times) == heard.sent.poses
    assert (np.diff(times) > 0).all()
    assert np.median(np.diff(times)) < 2_000_000
    assert (np.diff(times) > 50_000_000).sum() >= 3


@pytest.mark.parametrize("dialect", ["a", "b", "c", "d"])
def test_a_decimal_comma_is_refused_and_explained(dialect: str, listen: Listening) -> None:
    heard = listen(dialect=dialect, duration_s=0.2, faults={"decimal_comma": True})
    assert heard.samples == []
    refused = [each for each in heard.planned if b"," in each.data]
    assert heard.health.lost == {"rejected_decimal_comma": len(refused)}
    assert any("decimal comma" in problem for problem in heard.health.problems)


def test_a_world_frame_that_comes_late_or_never(listen: Listening) -> None:
    heard = listen(dialect="b", world_frame_at_s=0.2)
    assert 0.19 < heard.since_epoch_s(heard.event("world_frame").time_host_ns) < 0.8
    assert heard.of("pose")[0].time_host_ns < heard.event("world_frame").time_host_ns
    heard = listen(dialect="b", duration_s=0.2, world_frame_at_s=None)
    assert len(heard.of("pose")) == heard.sent.poses
    assert any("world frame has not come" in problem for problem in heard.health.problems)
    assert heard.health.readings["world_frame"] is False


def test_the_flag_changes_once_in_a_bad_network(listen: Listening) -> None:
    heard = listen(
        dialect="b",
        rate_hz=90,
        duration_s=0.8,
        toggles_s=(0.2, 0.6),
        faults={"late": 0.1, "lost": 0.1, "twice": 0.1},
    )
    found = [event for event in heard.events if event.name == "record_flag"]
    assert [event.detail["on"] for event in found] == [True, False]
    times = [heard.since_epoch_s(event.time_host_ns) for event in found]
    # The first message with it may be lost, and a busy machine may send or read the next late.
    assert 0.19 < times[0] < 0.59 < times[1] < 1.2


def test_a_recentred_headset_is_noticed(listen: Listening) -> None:
    heard = listen(dialect="d", faults={"recentre_at_s": 0.2})
    jumps = [event for event in heard.events if event.name == "pose_jump"]
    assert {event.detail["port"] for event in jumps} == {"pose", "headset"}
    assert 0.19 < heard.since_epoch_s(jumps[0].time_host_ns) < 0.8
    assert any("recentred" in problem for problem in heard.health.problems)


def test_a_frozen_controller_is_noticed(listen: Listening) -> None:
    heard = listen(dialect="a", duration_s=0.9, faults={"freeze_at_s": 0.1, "freeze_s": 2})
    (problem,) = heard.health.problems
    assert problem.startswith("pose has been the same for 0.")


def test_a_controller_far_from_the_headset(listen: Listening) -> None:
    heard = listen(dialect="a", duration_s=0.1, head=(0, -3.5, 0.5))
    (problem,) = heard.health.problems
    assert "from the headset: stay within 3 m" in problem
    assert float(heard.health.readings["from_headset_m"]) > 3


def test_only_one_headset_is_recorded(listen: Listening) -> None:
    heard = listen({"sender": "127.0.0.1"}, duration_s=0.1, source="127.0.0.2")
    assert heard.samples == []
    assert heard.health.lost == {"rejected_sender": len(heard.planned)}


def test_a_headset_of_another_process(listen: Listening) -> None:
    driver = Quest(QuestOptions(host="127.0.0.1", port=0))
    driver.open()
    options = HeadsetOptions(
        port=driver.address[1], dialect="d", rate_hz=90, duration_s=0.5, session=SESSION
    )
    command = [sys.executable, "-m", "exumi_recorders.simulated.headset", options.model_dump_json()]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        found: list[Sample] = []
        ages_ns: list[int] = []
        while process.poll() is None:
            samples = [each for each in driver.read(0.1) if isinstance(each, Sample)]
            now_ns = time.monotonic_ns()
            ages_ns += [now_ns - sample.time_host_ns for sample in samples]
            found += samples
        found += [each for each in driver.read(0) if isinstance(each, Sample)]
        assert process.stdout is not None
        sent = json.loads(process.stdout.read())
    driver.close()
    poses = [sample for sample in found if sample.port == "pose"]
    assert len(poses) == sent["poses"] == 45
    assert min(ages_ns) >= 0
    assert np.quantile(ages_ns, 0.2) < 20_000_000  # where neither stood still
    planned = plan(options, listen.truth)
    assert sent["datagrams"] == len(planned), "its session is the one that is known here"


def test_ports_are_described_in_the_standards_words() -> None:
    driver = Quest(QuestOptions(hand="both", headset=True))
    assert [port.name for port in driver.ports] == ["pose_left", "pose_right", "headset"]
    for port in driver.ports:
        assert port.stamp_point in stamp_points()
        assert port.time_device_unit in units()
        assert port.metadata["raw"]["unit"] in units()
        clock = {"source": "hub_monotonic", "stamp_point": port.stamp_point}
        stream = {"kind": port.kind, "clock": clock, "arrays": ["data", "raw"], **port.metadata}
        assert PoseStream.model_validate(stream).raw is not None
    assert [port.name for port in Quest(QuestOptions(dialect="b")).ports] == ["pose"]
    assert [port.name for port in Quest(QuestOptions()).ports] == ["pose", "headset"]


def test_the_driver_is_found_by_name() -> None:
    kind = find_driver("quest")
    assert isinstance(kind.make(kind.options.model_validate({"dialect": "c"})), Quest)
    with pytest.raises(ValueError, match="bufer_bytes"):
        kind.options.model_validate({"bufer_bytes": 5000})


def test_a_port_that_is_taken(listen: Listening) -> None:
    first = Quest(QuestOptions(host="127.0.0.1", port=0))
    first.open()
    second = Quest(QuestOptions(host="127.0.0.1", port=first.address[1]))
    with pytest.raises(DeviceError, match="cannot listen"):
        second.open()
    first.close()
    second.open()
    second.close()


def test_closed_is_closed() -> None:
    driver = Quest(QuestOptions(host="127.0.0.1", port=0))
    with pytest.raises(DeviceError, match="not open"):
        driver.read(0)
    assert driver.health().problems == ("The headset's port is not open.",)
    driver.open()
    assert driver.read(0) == []
    assert driver.health().problems == ()
    driver.close()
    driver.close()
    with pytest.raises(DeviceError, match="not open"):
        driver.read(0)
