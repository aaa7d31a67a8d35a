"""The demonstration, from the simulated session to the picture: recorded, and written directly."""

import signal
import subprocess
import sys
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import exumi_data
from exumi_data.cli.app import app
from exumi_data.dataset import Dataset
from exumi_data.demo import DemoSettings, deviation_of, make_session, write_play_dataset
from exumi_data.demo.canvas import Canvas
from exumi_data.demo.story import Span, span_of
from exumi_data.simulation import PlaySession
from exumi_data.time import apply_clock
from exumi_validators import validate

SECONDS = 4.0
RECORDED_S = 6.0
WITHOUT_TORCH = """
import sys

class NotInstalled:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")

sys.meta_path.insert(0, NotInstalled())
from exumi_data.cli.app import app
app(sys.argv[1:])
"""


def demonstrate(out: Path, *options: str, first: str) -> Path:
    done = CliRunner().invoke(app, ["demo", "--out", str(out), "--workers", "1", *options])
    assert done.exit_code == 0, done.output
    steps = (first, "2 Validate  valid", "3 Measure", "4 Prepare", "5 Load windows", "6 Draw")
    for number, step in enumerate(steps, start=1):
        assert step in done.stdout, number
    assert "s are in episodes, the rest lies before" in done.stdout
    assert str(out / "contact-sheet.png") in done.stdout
    return out


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished demonstration, written directly."""
    out = tmp_path_factory.mktemp("demo") / "out"
    return demonstrate(out, "--direct", "--seconds", str(SECONDS), first="1 Simulate")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished demonstration, recorded."""
    out = tmp_path_factory.mktemp("recorded") / "out"
    return demonstrate(out, "--seconds", str(RECORDED_S), first="1 Record  1 grasp")


@pytest.fixture(scope="module")
def recording(recorded: Path) -> Dataset:
    return cast("Dataset", exumi_data.open(recorded / "dataset"))


def in_session(dataset: Dataset) -> Span:
    """Which part of the session an episode holds that was recorded when nobody said its start.

    It is found where the truth lies on the widths: the check of times is then that of the poses
    and the images, which come from other devices on other ways.
    """
    truth = make_session(DemoSettings().seed, RECORDED_S).truth
    width = dataset[0]["width"]
    time_s, there = width.time[::20] * 1e-9, width.data[::20]
    starts_s = np.arange(0.0, 2.0, 1e-3)
    apart = [np.abs(truth.width_m(start + time_s) - there).mean() for start in starts_s]
    start_s = float(starts_s[int(np.argmin(apart))])
    return Span(start_s, start_s + float(time_s[-1]))


@pytest.fixture(scope="module")
def dataset(played: Path) -> Dataset:
    return cast("Dataset", exumi_data.open(played / "dataset"))


def test_without_out_it_writes_into_the_folder_it_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The way there is what is tested: a file is in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "exumi-demo").write_text("mine")
    done = CliRunner().invoke(app, ["demo", "--direct", "--seconds", "3"])
    assert done.exit_code == 2
    assert "exumi-demo/dataset" in done.output
    assert "bug" not in done.output


def test_it_is_a_dataset_of_one_episode_a_grasp(dataset: Dataset) -> None:
    grasps = make_session(DemoSettings().seed, SECONDS).grasps
    assert len(dataset) == len(grasps) == 1
    episode = dataset[0]
    assert episode.metadata.regime == "play"
    assert episode.metadata.source.type == "simulated"
    assert set(episode.streams) == {"tactile_left", "tactile_right", "rgb", "pose", "width"}
    assert episode.metadata.source.lossy is not None
    assert len(episode.metadata.source.lossy) == 3


def test_times_can_be_computed_again(dataset: Dataset) -> None:
    for stream in dataset[0].streams.values():
        clock = stream.metadata.clock
        raw = stream.time_host
        assert raw is not None
        assert clock.latency_ns > 0
        again = apply_clock(
            raw,
            t_ref=clock.t_ref_ns,
            drift_ppm=clock.drift_ppm,
            offset_ns=clock.offset_ns,
            latency_ns=clock.latency_ns,
        )
        np.testing.assert_array_equal(again, stream.time)


def test_what_is_stored_is_the_truth(dataset: Dataset) -> None:
    session = make_session(DemoSettings().seed, SECONDS)
    grasp = session.grasps[0]
    episode = dataset[0]
    true_s = grasp.t_start_s + episode["pose"].time * 1e-9
    error = episode["pose"].data[:, :3] - session.truth.pose(true_s)[:, :3]
    assert np.abs(error).max() < 1e-3  # the tracker's noise has a sigma of 0.15 mm
    width_s = grasp.t_start_s + episode["width"].time * 1e-9
    raw = episode["width"].raw
    assert raw is not None
    np.testing.assert_array_equal(episode["width"].data, session.encoder.width_m(raw))
    assert np.abs(episode["width"].data - session.truth.width_m(width_s)).max() < 5e-4


def test_frames_are_active_when_the_gel_is_touched(dataset: Dataset) -> None:
    session = make_session(DemoSettings().seed, SECONDS)
    assert_active_when_touched(session, dataset, session.grasps[0].t_start_s)


def assert_active_when_touched(session: PlaySession, dataset: Dataset, start_s: float) -> None:
    for finger in ("left", "right"):
        stream = dataset[0][f"tactile_{finger}"]
        activity = stream.activity
        assert activity is not None
        depth = session.truth.contact_depth_m(finger, start_s + stream.time * 1e-9)
        assert (activity[depth > 2e-4] > 1e-3).all()
        assert (activity[depth == 0] < 1e-3).all()


def test_a_validation_of_it_finds_nothing(dataset: Dataset) -> None:
    assert validate(dataset.path).problems == ()


def test_the_picture_is_one_and_has_colours(played: Path) -> None:
    picture = cv2.imread(str(played / "contact-sheet.png"))
    assert picture is not None
    assert picture.shape[1] == 2000
    assert picture.shape[0] > 1500
    saturation = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)[..., 1]
    assert (saturation > 60).mean() > 0.2


def test_the_same_settings_give_the_same_dataset(dataset: Dataset, tmp_path: Path) -> None:
    settings = DemoSettings(seconds=SECONDS)
    again = write_play_dataset(tmp_path / "again", settings, workers=1)
    assert again.fingerprint == dataset.fingerprint
    other = write_play_dataset(tmp_path / "again", DemoSettings(seed=8, seconds=SECONDS))
    assert len(other) == 1  # the earlier demonstration was replaced
    assert other.ids != again.ids


def test_without_torch_it_says_what_to_install(played: Path) -> None:
    arguments = ["demo", "--direct", "--out", str(played), "--seconds", str(SECONDS)]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH, *arguments],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert 'pip install "exumi-data[train]"\n' in done.stdout
    assert "6 Draw" in done.stdout


def test_recorded_is_one_episode_a_grasp_and_nothing_else(recording: Dataset) -> None:
    assert len(recording) == len(make_session(DemoSettings().seed, RECORDED_S).grasps)
    metadata = recording[0].metadata
    assert (metadata.regime, metadata.source.type) == ("play", "simulated")
    assert {path.name for path in Path(recording.path).iterdir()} == {
        "catalog.parquet",
        "dataset.json",
        "episodes",
    }


def test_recorded_frames_are_there_or_counted_as_lost(recording: Dataset) -> None:
    for name in ("tactile_left", "tactile_right", "rgb"):
        stream = recording[0][name]
        sequence = stream.sequence
        assert sequence is not None
        gaps = sum(gap.lost or 0 for gap in stream.metadata.gaps or [])
        assert len(sequence) > 60
        assert int(sequence[-1] - sequence[0]) + 1 == len(sequence) + gaps


def test_recorded_lies_on_the_truth(recorded: Path, recording: Dataset) -> None:
    session = make_session(DemoSettings().seed, RECORDED_S)
    span = in_session(recording)
    apart = deviation_of(session, recording[0], span)
    assert apart.width_m < 2e-4
    pose = recording[0]["pose"]
    true = session.truth.pose(span.start_s + pose.time * 1e-9)
    place_m = np.linalg.norm(pose.data[:, :3] - true[:, :3], axis=1)
    # A busy machine sends some datagrams late, by as much as it stood still, and stamps them late.
    assert np.median(place_m) < 1e-3
    assert apart.place_m < 0.1
    training = cast("Dataset", exumi_data.open(recorded / "training"))
    assert_active_when_touched(session, training, span.start_s)


def test_direct_episodes_say_where_they_lie_in_the_session(dataset: Dataset) -> None:
    grasp = make_session(DemoSettings().seed, SECONDS).grasps[0]
    assert span_of(dataset[0], 0).start_s == pytest.approx(grasp.t_start_s)


def test_the_picture_of_a_recording_is_one(recorded: Path) -> None:
    picture = cv2.imread(str(recorded / "contact-sheet.png"))
    assert picture is not None
    assert picture.shape[1] == 2000


def test_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "exumi_data.cli", "demo", "--out", str(tmp_path / "out")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        assert any("recording episode 1" in line for line in running.stderr)
        running.send_signal(signal.SIGINT)
        assert "interrupted" in running.stderr.read()
        assert running.wait(30) == 130
    assert not list(tmp_path.iterdir())


def test_other_data_is_not_replaced(tmp_path: Path) -> None:
    mine = tmp_path / "training" / "mine"
    mine.parent.mkdir()
    mine.write_text("mine")
    done = CliRunner().invoke(app, ["demo", "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert "Name another folder with --out" in done.output
    assert mine.read_text() == "mine"


def test_stroke_letters_where_there_is_no_typeface(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "FontFace", raising=False)
    canvas = Canvas(400, 60, (0, 0, 0))
    width = canvas.text((10, 40), "step −4 · 30 Hz", size=28, color=(255, 255, 255))
    assert 100 < width < 390
    assert canvas.pixels.any()
    assert not canvas.pixels[:, round(10 + width) + 4 :].any()
