"""Sessions: what commands do, what the operator is told, and what is left in the dataset."""

import errno
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from exumi_data.catalog import list_episodes
from exumi_data.episode import open_episode
from exumi_recorders.contract import DeviceLostError, Event, Sample
from exumi_recorders.journal import space
from exumi_recorders.journal.log import LogWriter
from exumi_recorders.journal.states import list_journals, read_state
from exumi_recorders.rig.model import Controls, Hooks
from exumi_recorders.rig.model import Limits as RigLimits
from exumi_recorders.session import problems
from exumi_recorders.session import session as session_module
from exumi_recorders.session.labels import TouchLabels
from exumi_recorders.session.plan import Plan
from exumi_validators import validate
from tests.exumi_recorders.numbered import Toy
from tests.exumi_recorders.session.sessions import Running

POSE = {"pose": 90.0}
SECOND = 1.5  # and what a busy machine takes besides
MUG = TouchLabels("mug", "handle", "press", "plain")


def errors_of(episode: Path) -> list[Any]:
    return [one for one in validate(episode).problems if one.severity == "error"]


def test_an_operator_at_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, "_UNDO_S", 1.0)
    with Running(tmp_path, [Toy(POSE)], Plan(task="toy", labels=MUG, regime="touch")) as run:
        run.do("undo", says="nothing")
        run.do("success", says="nothing")
        assert run.do("toggle", says="recording").text == "recording episode 1, trial 1"
        run.do("failure", says="judged")
        run.do("success", says="judged")
        assert run.do("toggle", says="stopped").level == "info"
        assert run.do("discard", "bumped", says="discarded").text.startswith("discarded (bumped)")
        (tombstone,) = list_journals(run.dataset)
        assert read_state(tombstone).state == "discarded"
        assert read_state(tombstone).reason == "bumped"
        run.do("discard", says="nothing")
        run.do("failure", says="nothing")
        assert run.do("reason", "2", says="reason").text == "because: tracking was lost"
        assert read_state(tombstone).reason == "tracking was lost"
        run.do("reason", "9", says="nothing")
        run.do("reason", "the door slammed", says="reason")
        assert read_state(tombstone).reason == "the door slammed"
        run.do("undo", says="undone")
        run.do("reason", "1", says="nothing")
        assert read_state(tombstone).reason is None
        run.do("undo", says="nothing")
        # Nobody takes it back again: it becomes an episode, and cannot be discarded any more.
        run.wait("kept")
        run.do("discard", says="nothing")
        run.do("undo", says="nothing")
        assert run.do("start", says="recording").text == "recording episode 2, trial 2"
        # While it is recorded.
        run.do("discard", "dropped it", says="discarded")
        # A discarded trial is none.
        assert run.do("start", says="recording").text == "recording episode 2, trial 2"
        run.do("stop", says="stopped")
        run.until(lambda: run.status is not None and run.status.next_trial == 3)
        run.do("failure", says="judged")
        run.do("start", says="recording")
        run.do("discard", says="discarded")
        run.do("start", says="recording")
        assert (run.dataset / ".recording" / ".reserve").exists()
        time.sleep(0.3)
        report = run.quit()
        assert "the session ended" in run.wait("stopped").text
        status = run.status
    assert report.problems == []
    assert report.left == []
    assert len(report.discarded) == 2
    assert [read_state(path).reason for path in report.discarded] == [
        "dropped it",
        "no reason given",
    ]
    assert status is not None
    assert (status.kept, status.discarded) == (3, 2)
    found = []
    for path in list_episodes(run.dataset):
        assert errors_of(run.dataset / path) == []
        with open_episode(run.dataset / path) as episode:
            said = episode.metadata.annotations
            assert said is not None
            found.append((said.trial or 0, episode.metadata.success))
    # Of the first, the last word counts; the second was judged after it had been stopped.
    assert sorted(found, key=lambda each: each[0]) == [(1, True), (2, False), (3, None)]
    assert not (run.dataset / ".recording" / ".reserve").exists()


def test_episodes_by_themselves(tmp_path: Path) -> None:
    mark = tmp_path / "hooks"
    hooks = {
        name: [sys.executable, "-c", f"open({str(mark)!r}, 'a').write({name!r} + ' ')"]
        for name in ("ready", "start", "stop", "discard")
    }
    plan = Plan(
        task="toy", duration_s=0.5, auto=True, pause_s=0.4, episodes=2, labels=TouchLabels("mug")
    )
    with Running(
        tmp_path, [Toy(POSE)], plan, hooks=Hooks(**hooks, problem=["/nowhere/beep"])
    ) as run:
        first = run.wait("recording")
        assert first.text == "recording episode 1, trial 1"
        run.wait("stopped")
        run.do("discard", says="discarded")
        assert run.wait("recording").text == "recording episode 1, trial 1"
        began = time.monotonic()
        run.wait("stopped")
        assert 0.4 < time.monotonic() - began < 3.0
        assert run.wait("recording").text == "recording episode 2, trial 2"
        report = run.ended()
    assert len(report.finished) == 2
    assert len(report.discarded) == 1
    trials = []
    for one in report.finished:
        assert one.episode is not None
        assert one.samples["pose"] > 0.4 * 90
        with open_episode(one.episode) as episode:
            assert episode.metadata.annotations is not None
            trials.append(episode.metadata.annotations.trial or 0)
    assert sorted(trials) == [1, 2]
    words = mark.read_text().split()
    assert sorted(words) == sorted(["ready", *["start", "stop"] * 3, "discard"])


def test_an_episode_ends_at_the_longest_that_the_rig_allows(tmp_path: Path) -> None:
    with Running(
        tmp_path, [Toy(POSE)], limits=RigLimits(least_minutes=0, longest_minutes=0.005)
    ) as run:
        run.do("start", says="recording")
        assert "as long as the rig file allows" in run.wait("stopped").text
        run.do("discard", says="discarded")


def test_a_disk_with_too_little_room_refuses_to_begin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(space, "free_bytes", lambda _: 1000)
    few = RigLimits(least_minutes=2.0)
    hooks = Hooks(problem=["/nowhere/beep"])
    with Running(tmp_path, [Toy(POSE)], limits=few, hooks=hooks) as run:
        assert "there is room for" in run.do("start", says="not_started").text
        # An operator who cannot hear it is told at least.
        assert "/nowhere/beep" in run.wait("hook").text
        # Who waits for orders may try again.
        run.do("start", says="not_started")
        assert run.quit().problems == []
    plan = Plan(task="toy", duration_s=0.5, auto=True, episodes=3)
    with Running(tmp_path / "auto", [Toy(POSE)], plan, limits=few) as run:
        # Nobody may be there to do that.
        (problem,) = run.ended().problems
    assert "there is room for" in problem
    assert list_journals(run.dataset) == []


def test_the_last_episode_does_not_wait_for_a_long_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_module, "_UNDO_S", 0.2)
    plan = Plan(task="toy", duration_s=0.5, auto=True, pause_s=1e300, episodes=1)
    with Running(tmp_path, [Toy(POSE)], plan) as run:
        assert len(run.ended().finished) == 1


def test_a_full_disk_ends_the_episode_and_the_operator_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = LogWriter.append
    full_at: list[float] = []

    def append(self: LogWriter, pieces: Any) -> None:
        if full_at and self.folder.name == "pose":
            raise OSError(errno.ENOSPC, "No space left on device")
        real(self, pieces)

    monkeypatch.setattr(LogWriter, "append", append)
    with Running(tmp_path, [Toy(POSE)]) as run:
        run.do("start", says="recording")
        time.sleep(0.3)
        full_at.append(time.monotonic())
        stopped = run.wait("stopped")
        assert run.at("stopped") - full_at[0] < SECOND
        assert (stopped.level, "disk_full" in stopped.text) == ("warning", True)
        run.wait("disk_full")
        full_at.clear()
        # The next one has room again.
        run.do("start", says="recording")
        run.do("discard", says="discarded")
        report = run.quit()
    (one,) = report.finished
    assert one.truncated == "disk_full"
    assert one.episode is not None
    with open_episode(one.episode) as episode:
        assert "truncated" in {note.code for note in episode.metadata.quality}
    assert errors_of(one.episode) == []


class Pluggable(Toy):
    """Can be pulled out, and put in again."""

    away = False

    def open(self) -> None:
        if self.away:
            raise DeviceLostError("it is not there")
        super().open()

    def read(self, timeout_s: float) -> list[Sample | Event]:
        if self.away:
            raise DeviceLostError("the plug was pulled")
        return super().read(timeout_s)


@pytest.fixture
def slow_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """Holds seconds that each write takes, or nothing."""
    real = LogWriter.append
    seconds: list[float] = []

    def append(self: LogWriter, pieces: Any) -> None:
        if seconds:
            time.sleep(seconds[0])
        real(self, pieces)

    monkeypatch.setattr(LogWriter, "append", append)
    yield seconds
    seconds.clear()


def test_the_operator_is_told_of_trouble_within_a_second(
    tmp_path: Path, slow_disk: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(problems, "_CALM_S", 0.3)
    pluggable, frozen = Pluggable({"counter": 500.0}), Toy(POSE, freeze_at_s=1.0)
    with Running(tmp_path, [pluggable, frozen]) as run:
        run.do("start", says="recording")
        pulled = time.monotonic()
        pluggable.away = True
        assert "the plug was pulled" in run.wait("device_lost").text
        assert run.at("device_lost") - pulled < SECOND
        pluggable.away = False
        run.wait("device_lost_over")
        slow_disk.append(0.8)
        slowed = time.monotonic()
        run.wait("disk_slow")
        assert run.at("disk_slow") - slowed < SECOND
        slow_disk.clear()
        run.wait("disk_slow_over")
        # It froze meanwhile: 0.5 s of the same pose make it frozen.
        began = frozen._start / 1e9
        assert run.at("frozen") - (began + 1.0) < SECOND
        run.do("discard", says="discarded")


def test_the_headset_begins_and_ends_episodes(tmp_path: Path) -> None:
    headset, other = Toy(POSE), Toy({"counter": 90.0})
    controls = Controls(flag="toy0", world_frame="toy0")

    def press(toy: Toy, *, on: bool) -> None:
        toy.events.append(Event("record_flag", time.monotonic_ns(), {"on": on}))

    with Running(tmp_path, [headset, other], controls=controls) as run:
        press(headset, on=True)
        assert "mark the world first" in run.wait("not_started").text
        pose = {"pose": [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]}
        headset.events.append(Event("world_frame", time.monotonic_ns(), pose))
        press(headset, on=False)
        press(headset, on=True)
        run.wait("recording")
        press(other, on=False)
        time.sleep(0.3)
        assert "stopped" not in run.codes
        press(headset, on=False)
        run.wait("stopped")
        run.do("discard", says="discarded")
