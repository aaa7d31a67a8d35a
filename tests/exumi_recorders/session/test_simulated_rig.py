"""A session with the simulated rig: real datagrams, real sockets, and what goes wrong with them."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from exumi_data.episode import open_episode
from exumi_recorders.rig.simulated import SimulatedRig, SimulatedSettings, simulated_rig
from exumi_recorders.session.labels import TrialCounter
from exumi_recorders.session.messages import Message, SessionReport
from exumi_recorders.session.plan import Plan
from exumi_recorders.session.running import make_recorder
from exumi_recorders.session.session import Session
from exumi_recorders.simulated.headset_options import HeadsetFaults
from exumi_validators import validate
from tests.exumi_recorders.finalise.journals import make_dataset

PRESSED_S = (3.0, 6.6)
FROZEN_S = 4.0
AWAY_S = (4.0, 4.5)
END_S = 8.2
SOON_S = 2.0  # within a second, and what a busy machine takes besides
GONE = "the device was gone"
SETTINGS = SimulatedSettings(
    seed=3,
    seconds=9.0,
    frame_width=64,
    toggles_s=PRESSED_S,
    absent_s={"rgb": AWAY_S},
    headset_faults=HeadsetFaults(freeze_at_s=FROZEN_S, freeze_s=1.0),
)


class Told:
    """What one session said, in seconds since the devices' first motion."""

    def __init__(self, started: SimulatedRig, dataset: Path) -> None:
        self.said: list[tuple[float, Message]] = []
        self.report = SessionReport()

        def hear(message: Message) -> None:
            self.said.append((time.monotonic() - started.epoch_ns / 1e9, message))

        recorder = make_recorder(started.rig)
        session = Session(
            started.rig,
            recorder,
            dataset,
            Plan(task="toy", regime="play", is_simulated=True),
            started.calibrated,
            TrialCounter(),
            hear,
            lambda _: None,
        )
        recorder.told = session.hear
        left_s = started.epoch_ns / 1e9 + END_S - time.monotonic()
        threading.Timer(left_s, session.command, ("quit",)).start()
        with recorder:
            self.report = session.run()

    def at(self, code: str, where: str = "") -> float:
        return next(
            time for time, one in self.said if one.code == code and one.text.startswith(where)
        )


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Told, SimulatedRig]]:
    dataset = make_dataset(tmp_path_factory.mktemp("simulated") / "set")
    with simulated_rig(SETTINGS) as started:
        yield Told(started, dataset), started


def test_the_controllers_button_begins_and_ends_the_episode(
    told: tuple[Told, SimulatedRig],
) -> None:
    said, started = told
    assert 0 <= said.at("recording") - PRESSED_S[0] < SOON_S
    assert 0 <= said.at("stopped") - PRESSED_S[1] < SOON_S
    (one,) = said.report.finished
    assert one.episode is not None
    assert [each for each in validate(one.episode).problems if each.severity == "error"] == []
    with open_episode(one.episode) as episode:
        assert sorted(episode.streams) == sorted(started.rig.stream_names)
        pose = episode["pose"]
        assert pose.time_host is not None
        # The recorder began soon after the button, and nothing was lost.
        since = (pose.time_host[0] - started.epoch_ns) / 1e9 - PRESSED_S[0]
        assert 0 <= since < SOON_S
        assert pose.sequence is not None
        assert (np.diff(pose.sequence.astype(np.int64)) == 1).all()
        assert pose.metadata.lost is None


def test_what_went_wrong_is_marked_and_did_no_harm_to_others(
    told: tuple[Told, SimulatedRig],
) -> None:
    (one,) = told[0].report.finished
    assert one.episode is not None
    with open_episode(one.episode) as episode:
        notes = {(note.code, note.stream) for note in episode.metadata.quality}
        assert notes == {("device-lost", None), ("pose-frozen", "pose")}
        gone = {
            name: [gap for gap in stream.metadata.gaps or [] if GONE in (gap.reason or "")]
            for name, stream in episode.streams.items()
        }
        # On a busy machine devices may leave out numbers besides, which is no harm done by others.
        (gap,) = gone.pop("rgb")
        rgb = episode["rgb"].time_host
        assert rgb is not None
        last, next_ = ((rgb[gap.after + n] - told[1].epoch_ns) / 1e9 for n in (0, 1))
        assert last < AWAY_S[0] + 0.1
        assert AWAY_S[1] < next_ < AWAY_S[1] + 2.5
        assert gone == {name: [] for name in gone}
        for name in gone:
            assert not set(episode[name].metadata.lost or {}) - {"late", "sequence"}


def test_an_unplugged_camera_is_told_within_a_second(told: tuple[Told, SimulatedRig]) -> None:
    assert 0 <= told[0].at("device_lost", "rgb") - AWAY_S[0] < SOON_S


def test_a_frozen_headset_is_told_within_a_second(told: tuple[Told, SimulatedRig]) -> None:
    # That takes half a second of the same pose.
    assert 0 <= told[0].at("frozen", "pose") - FROZEN_S < SOON_S
