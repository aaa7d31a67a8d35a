"""Recording from devices that work, and from such that do not."""

import errno
import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.catalog import episode_path
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import UsageError
from exumi_data.model import CalibrationItem
from exumi_recorders.contract import Blocks, DeviceError, Event, Health, Rows, Sample
from exumi_recorders.finalise.episode import finalise
from exumi_recorders.finalise.losses import FLAG
from exumi_recorders.journal.journal import JournalWriter
from exumi_recorders.journal.log import LogWriter
from exumi_recorders.journal.space import NoRoomError, SpaceLimits
from exumi_recorders.journal.states import read_state
from exumi_recorders.recording.lanes import Limits
from exumi_recorders.recording.recorder import Recorded, Recorder
from exumi_validators import validate
from tests.exumi_recorders.finalise.journals import make_dataset
from tests.exumi_recorders.numbered import POSE, Toy, device, episode, number_of, port

ROOM = SpaceLimits(soft_bytes=0, hard_bytes=0, reserve_bytes=1 << 12)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "set")


def finished(dataset: Path, recorded: Recorded) -> Episode:
    assert finalise(recorded.journal).outcome == "finalised"
    path = dataset / episode_path(episode().id)
    errors = [one for one in validate(path).problems if one.severity == "error"]
    assert errors == []
    return open_episode(path)


def until(condition: Callable[[], bool], seconds: float = 5.0) -> float:
    """Wait for something; return how long it took."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < seconds
        time.sleep(0.01)
    return time.monotonic() - start


def codes(recorder: Recorder) -> set[str]:
    return {problem.code for problem in recorder.status().problems}


def test_every_sample_between_start_and_stop_is_recorded(dataset: Path) -> None:
    toy = Toy(rates={"pose": 90.0, "camera": 30.0, "counter": 500.0})
    latency = CalibrationItem(value=2_000_000, unit="ns", uncertainty=1e5, method="sweep")
    metadata = episode(calibration={"latency/camera": latency})
    with Recorder([device(toy)], space=ROOM) as recorder:
        time.sleep(0.15)
        before = dict(toy.sent)
        assert before["pose"] > 5
        recorder.start(dataset, metadata)
        until(lambda: recorder.status().streams[0].samples >= 30)
        status = recorder.status()
        recorded = recorder.stop()
    assert status.recording
    assert status.problems == ()
    assert [stream.name for stream in status.streams] == ["pose", "camera", "counter"]
    assert status.streams[0].rate_hz == pytest.approx(90, rel=0.01)
    assert status.streams[0].jitter_s == pytest.approx(0, abs=1e-6)
    assert status.bytes > 0
    assert recorder.latest_frame("camera") is not None
    assert recorder.latest_frame("pose") is None
    with finished(dataset, recorded) as found:
        for name in ("pose", "camera", "counter"):
            sequence = found[name].sequence
            assert sequence is not None
            assert sequence.tolist() == list(range(sequence[0], sequence[0] + len(sequence)))
            assert found[name].time[0] + found[name].metadata.clock.latency_ns >= 0
            assert found[name].metadata.gaps is None
            assert recorded.samples[name] == len(found[name])
        assert found["pose"].data[:, 0].tolist() == found["pose"].sequence.tolist()  # type: ignore[union-attr]
        files = [number_of(found["camera"].encoded(k)) for k in range(len(found["camera"]))]
        assert files == found["camera"].sequence.tolist()  # type: ignore[union-attr]
        assert found["camera"].metadata.clock.latency_ns == 2_000_000
        assert found["camera"].metadata.clock.latency_sigma_ns == 1e5


def test_several_episodes_of_one_run(dataset: Path) -> None:
    with Recorder([device(Toy())], space=ROOM) as recorder:
        for number in (1, 2):
            recorder.start(dataset, episode(number))
            with pytest.raises(UsageError, match="is being recorded"):
                recorder.start(dataset, episode(3))
            until(lambda: recorder.status().streams[0].samples > 3)
            assert finalise(recorder.stop().journal).outcome == "finalised"
        with pytest.raises(UsageError, match="no episode"):
            recorder.stop()


def test_a_device_that_cannot_be_opened_closes_all(dataset: Path) -> None:
    class Broken(Toy):
        def open(self) -> None:
            msg = "the cable is not plugged in"
            raise DeviceError(msg)

    class Watched(Toy):
        closed = False

        def close(self) -> None:
            self.closed = True

    good = Watched()
    recorder = Recorder([device(good), replace(device(Broken(), "b"), streams={"pose": "p2"})])
    with pytest.raises(DeviceError, match="not plugged in"):
        recorder.open()
    assert good.closed
    with pytest.raises(UsageError, match="one name"):
        Recorder([device(Toy(), "a"), device(Toy(), "b")])
    taken = Recorder([replace(device(Toy()), streams={"pose": "events"})])
    with pytest.raises(UsageError, match="no stream can be called 'events'"):
        taken.open()
    wrong = Recorder([replace(device(Toy()), streams={"gyro": "gyro"})])
    with pytest.raises(DeviceError, match="no port 'gyro'"):
        wrong.open()


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"metadata": {}}, "frames"),
        ({"metadata": {"frames": {"parent": "a", "child": "b"}, "colour": 1}}, "unknown key"),
        ({"payload": Rows({"data": ("<f8", (6,))})}, "shape"),
        ({"kind": "gyroscope"}, "unknown stream kind"),
        ({"kind": "taxels", "metadata": {"grid": [1, 7], "unit": "1"}}, "expected"),
        ({"nominal_rate": "1.5"}, "invalid rate"),
        ({"payload": Blocks(1, "8000")}, "blocks of sound"),
    ],
)
def test_what_cannot_be_stored_is_refused_before_it_is_recorded(
    wrong: dict[str, Any], what: str
) -> None:
    toy = Toy(rates={"pose": 90.0}, ports=(port(POSE, **wrong),))
    recorder = Recorder([device(toy)])
    with pytest.raises((UsageError, DeviceError), match=what):
        recorder.open()


def test_a_device_that_is_lost_comes_back_and_others_go_on(dataset: Path) -> None:
    lost = Toy(rates={"pose": 90.0}, lose_at_s=0.5, back_after=2)
    good = Toy(rates={"counter": 500.0})
    told: list[tuple[str, str]] = []
    recorder = Recorder(
        [device(lost, "lost"), device(good, "good")],
        space=ROOM,
        on_event=lambda name, event: told.append((name, event.name)),
    )
    with recorder:
        recorder.start(dataset, episode())
        until(lambda: "device_lost" in codes(recorder))
        gone_at = time.monotonic()
        assert not recorder.status().devices[0].connected
        assert recorder.status().devices[1].connected
        until(lambda: "device_lost" not in codes(recorder))
        assert time.monotonic() - gone_at < 4  # it is there at the second attempt
        time.sleep(0.1)
        recorded = recorder.stop()
    assert told == [("lost", "device_lost"), ("lost", "device_back")]
    with finished(dataset, recorded) as found:
        gaps = found["pose"].metadata.gaps
        assert gaps is not None
        assert [gap.lost for gap in gaps] == [None]
        sequence = found["pose"].sequence
        assert sequence is not None
        assert sequence.tolist() == list(range(sequence[0], sequence[0] + len(sequence)))
        assert found["counter"].metadata.gaps is None
        assert "device-lost" in {note.code for note in found.metadata.quality}


def test_what_a_device_lost_before_it_was_unplugged_still_counts(dataset: Path) -> None:
    class Counting(Toy):
        """It has lost a sample each time that it was opened, and two more as it goes."""

        def health(self) -> Health:
            more = 2 if sum(self._next.values()) > 20 else 0
            return Health(lost={"late": 1 + more})

    toy = Counting(rates={"pose": 90.0}, lose_at_s=0.5, back_after=2)
    with Recorder([device(toy)], space=ROOM) as recorder:
        recorder.start(dataset, episode())
        until(lambda: "device_lost" in codes(recorder))
        assert recorder.status().streams[0].lost == {"late": 2}
        until(lambda: "device_lost" not in codes(recorder))
        until(lambda: recorder.status().streams[0].lost == {"late": 5})
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        assert found["pose"].metadata.lost == {"late": 5}


def test_a_frozen_headset_is_told_within_a_second(dataset: Path) -> None:
    toy = Toy(rates={"pose": 90.0}, freeze_at_s=0.2)
    with Recorder([device(toy)], space=ROOM) as recorder:
        start = time.monotonic()
        recorder.start(dataset, episode())
        until(lambda: "frozen" in codes(recorder))
        assert time.monotonic() - start < 0.2 + 2.0  # a busy machine takes some besides
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        settings = found.metadata.source.settings
        assert settings is not None
        assert [event["name"] for event in settings["events"]] == ["frozen"]
        assert [(n.code, n.stream) for n in found.metadata.quality] == [("pose-frozen", "pose")]


def test_an_episode_that_begins_with_a_frozen_pose_says_so(dataset: Path) -> None:
    toy = Toy(rates={"pose": 90.0}, freeze_at_s=0.01)
    with Recorder([device(toy)], space=ROOM) as recorder:
        until(lambda: "frozen" in codes(recorder))
        recorder.start(dataset, episode())
        until(lambda: recorder.status().streams[0].samples > 3)
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        assert [(n.code, n.stream) for n in found.metadata.quality] == [("pose-frozen", "pose")]


class Silent(Toy):
    """It says nothing while `quiet`."""

    quiet = True

    def read(self, timeout_s: float) -> list[Sample | Event]:
        if not self.quiet:
            return super().read(timeout_s)
        time.sleep(timeout_s)
        self._start = time.monotonic_ns()
        return []


def test_a_device_that_is_silent_at_the_start_or_at_the_end_is_told_of(dataset: Path) -> None:
    toys = {name: Silent(rates={"pose": 90.0}) for name in ("early", "late", "good")}
    devices = [replace(device(toy, name), streams={"pose": name}) for name, toy in toys.items()]
    toys["early"].quiet = toys["good"].quiet = False
    with Recorder(devices, space=ROOM) as recorder:
        recorder.start(dataset, episode())
        until(lambda: recorder.status().streams[0].samples > 3)
        toys["early"].quiet = True
        time.sleep(1.1)
        toys["late"].quiet = False
        time.sleep(0.2)
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        gaps = {name: found[name].metadata.gaps for name in found.streams}
        assert [gap.after for gap in gaps["late"] or []] == [-1]
        assert [gap.after for gap in gaps["early"] or []] == [len(found["early"]) - 1]
        assert gaps["good"] is None
        notes = {note.stream: note.message for note in found.metadata.quality}
        assert "in the first 1." in notes["late"]
        assert "in the last 1." in notes["early"]
        assert len(notes) == 2


def test_a_silent_device_is_told_within_a_second() -> None:
    with Recorder([device(Silent())]) as recorder:
        assert until(lambda: "no_samples" in codes(recorder)) < 1.0


def test_what_the_driver_knows_is_shown_and_counted(dataset: Path) -> None:
    toy = Toy(rates={"pose": 90.0, "camera": 30.0}, says=Health(lost={"kernel": 5}))
    with Recorder([device(toy)], space=ROOM) as recorder:
        recorder.start(dataset, episode())
        toy.says = Health(
            lost={"kernel": 7, "camera/crc": 1, "late": 2},
            problems=("the magnet is too weak",),
            readings={"agc": 40},
            stamp_sigma_ns=12.5,
        )
        until(lambda: recorder.status().devices[0].readings == {"agc": 40})
        assert "device" in codes(recorder)
        assert recorder.status().streams[0].lost == {"kernel": 2, "late": 2}
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        assert found["pose"].metadata.lost == {"kernel": 2, "late": 2}
        assert found["camera"].metadata.lost == {"crc": 1}
        assert found["pose"].metadata.clock.offset_sigma_ns == 12.5


def test_what_was_lost_before_a_device_was_opened_anew_still_counts(dataset: Path) -> None:
    class Counting(Toy):
        def open(self) -> None:
            super().open()
            self.says = Health(lost={"kernel": 40 if self.opened == 1 else 3})

    toy = Counting(rates={"pose": 90.0}, lose_at_s=0.4)
    with Recorder([device(toy)], space=ROOM) as recorder:
        recorder.start(dataset, episode())
        toy.says = Health(lost={"kernel": 47})
        until(lambda: toy.opened == 2 and recorder.status().devices[0].connected)
        until(lambda: recorder.status().streams[0].lost.get("kernel", 0) == 10)
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        # 40 before the episode began, seven in it, and three since the device is back.
        assert found["pose"].metadata.lost == {"kernel": 10}


def test_what_was_missed_before_an_episode_and_comes_late_is_no_loss_of_it(dataset: Path) -> None:
    toy = Toy(rates={"pose": 90.0}, says=Health(lost={"sequence": 12}))
    with Recorder([device(toy)], space=ROOM) as recorder:
        recorder.start(dataset, episode())
        toy.says = Health(lost={"sequence": 11})
        until(lambda: recorder.status().streams[0].samples > 10)
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        assert found["pose"].metadata.lost is None


def test_a_device_that_numbers_anew_is_no_late_one(dataset: Path) -> None:
    class Restarting(Toy):
        def read(self, timeout_s: float) -> list[Sample | Event]:
            found: list[Sample | Event] = []
            for item in super().read(timeout_s):
                if isinstance(item, Sample):
                    number = item.sequence or 0
                    if number == 30:
                        found.append(Event("restart", item.time_host_ns))
                    found.append(replace(item, sequence=number if number < 30 else number - 30))
            return found

    wrapping = port(POSE, modulus=1 << 32)
    toy = Restarting(rates={"pose": 90.0}, ports=(wrapping,))
    with Recorder([device(toy)], space=ROOM) as recorder:
        recorder.start(dataset, episode())
        until(lambda: toy.sent["pose"] > 60)
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        sequence, flags = found["pose"].sequence, found["pose"].flags
        assert sequence is not None
        assert flags is not None
        assert (np.diff(sequence.astype(np.int64)) == 1).all()
        assert np.count_nonzero(flags & FLAG["out_of_order"]) == 0
        assert np.count_nonzero(flags & FLAG["gap_before"]) == 1


def test_a_device_that_is_gone_before_an_episode_is_told_in_it(dataset: Path) -> None:
    gone = Toy(rates={"pose": 90.0}, lose_at_s=0.05, back_after=1 << 30)
    devices = [device(gone, "gone"), device(Toy(rates={"counter": 500.0}), "good")]
    with Recorder(devices, space=ROOM) as recorder:
        until(lambda: "device_lost" in codes(recorder))
        recorder.start(dataset, episode())
        until(lambda: recorder.status().streams[1].samples > 10)
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        notes = {note.code: note.message for note in found.metadata.quality}
        assert notes["device-lost"] == "gone was gone 1 times"
        assert "pose" in notes["stream-empty"]


def test_what_happens_while_an_episode_begins_is_in_it(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy = Toy()
    real = JournalWriter.append_clock

    def slow(self: JournalWriter) -> None:
        if not toy.sent.get("told"):
            toy.sent["told"] = 1
            toy.events.append(Event("early", time.monotonic_ns()))
            time.sleep(0.2)
        real(self)

    monkeypatch.setattr(JournalWriter, "append_clock", slow)
    with Recorder([device(toy)], space=ROOM) as recorder:
        recorder.start(dataset, episode())
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        settings = found.metadata.source.settings
        assert settings is not None
        assert [event["name"] for event in settings["events"]] == ["early"]


def test_samples_that_cannot_be_stored_are_told_and_counted(dataset: Path) -> None:
    class Wrong(Toy):
        def _sample(self, name: str, own: int, rate: float) -> Sample:
            sample = super()._sample(name, own, rate)
            return replace(sample, payload=b"short") if own % 3 == 2 else sample

    with Recorder([device(Wrong(rates={"pose": 90.0}))], space=ROOM) as recorder:
        recorder.start(dataset, episode())
        assert until(lambda: "malformed" in codes(recorder)) < 1.0
        # The first sample may be a malformed one: then there is no stream yet.
        until(lambda: all(stream.samples > 0 for stream in recorder.status().streams))
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        assert (found["pose"].metadata.lost or {})["malformed"] > 0


def test_what_holds_until_the_next_event_reaches_later_episodes(dataset: Path) -> None:
    pose = [0.0, 1, 0, 0, 0, 0, 1]
    toy = Toy(
        events=[
            Event("controls", 1, {"exposure": 5}),
            Event("world_frame", 2, {"pose": pose}),
            Event("clock", 3, {"clock_offset_ns": 7}),
            Event("key", 4, {"name": "a"}),
        ]
    )
    with Recorder([device(toy)], space=ROOM) as recorder:
        until(lambda: recorder.status().streams[0].rate_hz is not None)
        recorder.start(dataset, episode())
        recorder.add_event("operator", text="go")
        until(lambda: recorder.status().streams[0].samples > 3)
        recorded = recorder.stop()
    with finished(dataset, recorded) as found:
        settings = found.metadata.source.settings
        assert settings is not None
        kept = {event["name"]: event["detail"] for event in settings["events"]}
        assert kept == {
            "controls": {"exposure": 5},
            "world_frame": {"pose": pose},
            "clock": {"clock_offset_ns": 7},
            "operator": {"text": "go"},
        }
        assert settings["boot_id"] == Path("/proc/sys/kernel/random/boot_id").read_text().strip()


# ------------------------------------------------------------------------------------------ disk


def test_a_slow_disk_costs_images_and_never_poses(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = LogWriter.append
    slow = True

    def append(self: LogWriter, pieces: Any) -> None:
        if slow and self.folder.name == "camera":
            time.sleep(0.5)
        real(self, pieces)

    monkeypatch.setattr(LogWriter, "append", append)
    toy = Toy(rates={"pose": 90.0, "camera": 120.0})
    limits = Limits(bytes=1 << 30, age_s=0.2)
    with Recorder([device(toy)], space=ROOM, limits=limits) as recorder:
        recorder.start(dataset, episode())
        until(lambda: {"disk_slow", "dropping"} <= codes(recorder))
        shown = recorder.latest_frame("camera")
        until(lambda: recorder.status().streams[1].dropped > 20)
        slow = False
        until(lambda: recorder.status().pressure < 0.2)
        time.sleep(0.1)
        assert recorder.latest_frame("camera") is not shown
        recorded = recorder.stop()
    assert recorded.dropped["camera"] > 20
    assert recorded.dropped["pose"] == 0
    with finished(dataset, recorded) as found:
        camera, pose = found["camera"].metadata, found["pose"].metadata
        assert pose.gaps is None
        assert camera.lost == {"queue": recorded.dropped["camera"]}
        assert sum(gap.lost or 0 for gap in camera.gaps or []) == recorded.dropped["camera"]


def fail_after(records: int, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    real = LogWriter.append
    left = records

    def append(self: LogWriter, pieces: Any) -> None:
        nonlocal left
        left -= 1
        if left < 0 and self.folder.name == "camera":
            raise OSError(code, "of the disk")
        real(self, pieces)

    monkeypatch.setattr(LogWriter, "append", append)


@pytest.mark.parametrize(
    ("code", "truncated"), [(errno.ENOSPC, "disk_full"), (errno.EIO, "disk_error (of the disk)")]
)
def test_a_full_disk_ends_the_episode_cleanly(
    dataset: Path, monkeypatch: pytest.MonkeyPatch, code: int, truncated: str
) -> None:
    fail_after(60, code, monkeypatch)
    with Recorder([device(Toy())], space=ROOM) as recorder:
        journal = recorder.start(dataset, episode())
        assert (dataset / ".recording" / ".reserve").stat().st_size == ROOM.reserve_bytes
        until(lambda: recorder.status().truncated is not None)
        told = recorder.status()
        assert {"disk_full", "disk_error"} & codes(recorder)
        assert not told.recording
        recorded = recorder.stop()
        assert recorded.truncated == truncated
        assert recorder.status().truncated == truncated
        assert not (dataset / ".recording" / ".reserve").exists()
        state = read_state(journal)
        assert (state.state, state.truncated) == ("stopped", truncated)
        monkeypatch.undo()
        assert recorder.status().devices[0].connected  # devices go on
    with finished(dataset, recorded) as found:
        notes = {note.code: note.message for note in found.metadata.quality}
        assert notes["truncated"].startswith(truncated)
        assert len(found["pose"]) == recorded.samples["pose"]


def test_what_was_written_before_the_disk_was_full_is_not_lost(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = os.writev, 0

    # The kernel says how much it has written, and only the next call that there is no more room.
    def partly(descriptor: int, pieces: Any) -> int:
        nonlocal calls
        calls += len(pieces) > 4  # a batch of several records
        # One whole record, and the header of another.
        return real(descriptor, pieces if calls < 3 else pieces[:3])

    def full(descriptor: int, data: Any) -> int:
        raise OSError(errno.ENOSPC, "full")

    toy = Toy(rates={"counter": 1000.0})
    with Recorder([device(toy)], space=ROOM) as recorder:
        with monkeypatch.context() as patch:
            patch.setattr("exumi_recorders.journal.log.os.writev", partly)
            patch.setattr("exumi_recorders.journal.log.os.write", full)
            recorder.start(dataset, episode())
            until(lambda: recorder.status().truncated is not None)
        recorded = recorder.stop()
    assert recorded.truncated == "disk_full"
    with finished(dataset, recorded) as found:
        counter = found["counter"]
        assert len(counter) == recorded.samples["counter"]
        assert counter.metadata.lost is not None
        # None of them counts as written and as lost.
        assert counter.metadata.lost["queue"] <= recorded.dropped["counter"]
        gaps = counter.metadata.gaps
        assert gaps is not None
        (gap,) = gaps
        assert gap.lost == counter.metadata.lost["queue"]


@pytest.mark.parametrize(
    ("code", "truncated"), [(errno.ENOSPC, "disk_full"), (errno.EIO, "disk_error (of the disk)")]
)
def test_a_disk_that_takes_everything_and_keeps_nothing_ends_the_episode(
    dataset: Path, monkeypatch: pytest.MonkeyPatch, code: int, truncated: str
) -> None:
    def fdatasync(_: int) -> None:
        raise OSError(code, "of the disk")

    with Recorder([device(Toy())], space=ROOM) as recorder:
        journal = recorder.start(dataset, episode())
        until(lambda: recorder.status().streams[0].samples > 10)
        monkeypatch.setattr(os, "fdatasync", fdatasync)
        assert until(lambda: recorder.status().truncated == truncated) < 1.0
        recorded = recorder.stop()
    assert not (dataset / ".recording" / ".reserve").exists()
    state = read_state(journal)
    assert (state.state, state.truncated) == ("stopped", truncated)
    with finished(dataset, recorded) as found:
        assert {note.code for note in found.metadata.quality} == {"truncated"}
        assert len(found["pose"]) == recorded.samples["pose"]


def test_a_disk_that_fails_at_the_very_end_is_told(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fdatasync(_: int) -> None:
        raise OSError(errno.EIO, "of the disk")

    with Recorder([device(Toy())], space=ROOM) as recorder:
        journal = recorder.start(dataset, episode())
        monkeypatch.setattr(os, "fdatasync", fdatasync)
        recorded = recorder.stop()
        assert "disk_error" in codes(recorder)
    assert recorded.truncated == read_state(journal).truncated == "disk_error (of the disk)"


def test_the_hard_limit_ends_an_episode_before_the_disk_is_full(dataset: Path) -> None:
    limits = SpaceLimits(soft_bytes=0, hard_bytes=1 << 60, reserve_bytes=0)
    with Recorder([device(Toy())], space=limits) as recorder:
        recorder.start(dataset, episode())
        until(lambda: recorder.status().truncated == "disk_full")
        recorded = recorder.stop()
    assert recorded.truncated == "disk_full"
    assert recorded.samples["pose"] > 10
    finished(dataset, recorded).close()


def test_the_soft_limit_refuses_to_begin(dataset: Path) -> None:
    limits = SpaceLimits(soft_bytes=1 << 60)
    with Recorder([device(Toy())], space=limits) as recorder:
        with pytest.raises(NoRoomError):
            recorder.start(dataset, episode())
        assert not recorder.status().recording


def test_a_journal_that_cannot_be_made_leaves_the_recorder_ready(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Recorder([device(Toy())], space=ROOM) as recorder:
        with monkeypatch.context() as patch:
            patch.setattr(JournalWriter, "append_clock", lambda _: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                recorder.start(dataset, episode())
        assert not recorder.status().recording
        time.sleep(0.05)
        assert recorder.status().pressure == 0
        recorder.start(dataset, episode())
        until(lambda: recorder.status().streams[0].samples > 3)
        assert finalise(recorder.stop().journal).outcome == "finalised"


def test_the_header_is_on_the_disk_before_recording_is_said(dataset: Path) -> None:
    with Recorder([device(Toy())], space=ROOM) as recorder:
        journal = recorder.start(dataset, episode())
        document = json.loads((journal / "header.json").read_text())
        assert set(document["streams"]) == {"pose", "camera"}
        assert document["t0_monotonic_ns"] <= time.monotonic_ns()
        assert read_state(journal).state == "recording"
        recorder.close()  # also ends the episode
    assert read_state(journal).state == "stopped"
    assert finalise(journal).outcome == "finalised"
