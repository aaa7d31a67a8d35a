"""The reference of the day: taken before the first episode, and what an episode says of it."""

import itertools
import time
from pathlib import Path

import numpy as np

from exumi_data.episode import Episode, open_episode
from exumi_data.model import CalibrationItem, Reference, TactileStream
from exumi_data.store import jpeg
from exumi_recorders.contract import Files, Sample
from exumi_recorders.session.plan import Calibrated
from exumi_validators import validate
from tests.exumi_recorders.numbered import CAMERA, Toy, port
from tests.exumi_recorders.session.sessions import Running

SIZE = (48, 64, 3)
GEL = port(CAMERA, name="gel", kind="tactile", payload=Files(*SIZE))


def a_frame(level: int, noise: int) -> np.ndarray:
    rng = np.random.default_rng(noise)
    base = np.linspace(level, level + 60, SIZE[1])[None, :, None]
    return np.clip(base + rng.normal(0, 1, SIZE), 0, 255).astype(np.uint8)


AT_REST = [jpeg.encode(a_frame(90, seed), 95) for seed in range(8)]
TOUCHED = [jpeg.encode(a_frame(90 + 40 * (seed % 2), seed), 95) for seed in range(8)]


class Finger(Toy):
    """Sends frames without contact, or of a touch that moves."""

    def __init__(self, *, touched: bool = False) -> None:
        super().__init__({"gel": 30.0}, ports=(GEL,))
        self.touched = touched
        self._count = itertools.count()

    def _sample(self, name: str, own: int, rate: float) -> Sample:
        files = TOUCHED if self.touched else AT_REST
        at = self._start + round(own / rate * 1e9)
        return Sample(name, at, files[next(self._count) % len(files)], sequence=own)


def reference_of(episode: Episode) -> Reference:
    gel = episode["gel"].metadata
    assert isinstance(gel, TactileStream)
    assert gel.reference is not None
    return gel.reference


def only_episode(run: Running) -> Episode:
    report = run.quit()
    (one,) = report.finished
    assert one.episode is not None
    assert [each for each in validate(one.episode).problems if each.severity == "error"] == []
    return open_episode(one.episode)


def record(run: Running) -> None:
    run.do("start", says="recording")
    time.sleep(0.3)
    run.do("stop", says="stopped")


def test_one_is_taken_and_reaches_the_episode(tmp_path: Path) -> None:
    with Running(tmp_path, [Finger()]) as run:
        assert "must not touch" in run.wait("reference").text
        run.wait("reference_taken")
        run.do("start", says="recording")
        assert "between episodes" in run.do("reference", says="nothing").text
        time.sleep(0.3)
        with only_episode(run) as episode:
            gel = episode["gel"]
            found = reference_of(episode)
            # Nobody said that nothing was touched.
            assert (found.method, found.contact_free) == ("captured", None)
            assert found.frames is None
            assert gel.reference is not None
            assert np.abs(gel.reference.astype(float) - a_frame(90, 0)).mean() < 2
            # It is not the rig's: nobody may tell fingers apart by it.
            assert list(episode.metadata.calibration) == ["session_reference/gel"]
            item = episode.metadata.calibration["session_reference/gel"]
            assert item.array is None
            assert item.value == {"nothing_touched": False}
            assert item.time is not None


def test_one_that_the_operator_asks_for_is_without_contact(tmp_path: Path) -> None:
    with Running(tmp_path, [finger := Finger(touched=True)]) as run:
        assert "changes" in run.wait("no_reference").text
        finger.touched = False
        time.sleep(0.1)
        run.do("reference", says="reference")
        run.wait("reference_taken")
        record(run)
        with only_episode(run) as episode:
            found = reference_of(episode)
            assert (found.method, found.contact_free) == ("captured", True)


def test_the_rigs_own_is_kept(tmp_path: Path) -> None:
    name = "tactile_reference/gel"
    image = a_frame(90, 3)
    item = CalibrationItem(value=None, array=f"calibration/{name}", method="by hand")
    calibrated = Calibrated({name: item}, {name: image})
    with Running(tmp_path, [Finger()], calibrated=calibrated) as run:
        record(run)
        run.do("discard", says="discarded")
        assert "reference" not in run.codes
        # Until the operator wants another one.
        run.do("reference", says="reference_taken")


def test_without_a_tactile_camera_there_is_none(tmp_path: Path) -> None:
    with Running(tmp_path, [Toy({"pose": 90.0})]) as run:
        assert "no tactile camera" in run.do("reference", says="nothing").text
        assert "reference" not in run.codes
