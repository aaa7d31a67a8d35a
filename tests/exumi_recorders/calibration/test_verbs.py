"""``exumi calibrate``, from a recording to a corrected dataset."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.cli.app import app
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.destination import only_run
from exumi_data.episode import open_episode
from exumi_data.model import DatasetMetadata, Frames, RawData
from exumi_data.simulation.sweep import SweepSettings
from exumi_data.simulation.sweep_recording import (
    CAMERA,
    write_sweep_clip,
    write_sweep_episode,
)
from exumi_data.standard import flags
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_recorders.calibration.files import read_calibration
from exumi_validators import validate
from tests.exumi_data.builders import edit_metadata, metadata
from tests.exumi_data.synchronisation.gripping import activity, as_ns, frame_times, width_m
from tests.exumi_recorders.calibration.test_controller import TIP, pivoting
from tests.exumi_recorders.calibration.test_tactile import frames as gel_frames
from tests.exumi_recorders.calibration.test_tactile import write_maps

SETTINGS = SweepSettings(
    rate_hz=1.2,
    delay_s=0.030,
    seconds=9.0,
    missing=0.0,
    exposure_s=0.004,
    readout_s=0.012,
    headset_lag_s=0.012,
    frames_per_s=30.0,
)


def calibrate(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["calibrate", *map(str, arguments)])


def found(done: Result) -> dict[str, Any]:
    assert done.exit_code == 0, done.output
    document: dict[str, Any] = json.loads(done.stdout)
    return document


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sweep_episode(tmp_path_factory.mktemp("sweep") / "s.zarr", SETTINGS, seed=2)


def test_from_a_sweep_to_a_corrected_dataset(sweep: Path, tmp_path: Path) -> None:
    rig, picture = tmp_path / "rig.json", tmp_path / "sweep.png"
    said = found(calibrate("latency", sweep, "--out", rig, "--plot", picture, "-f", "json"))
    item = said["items"]["latency/pose"]
    # What the poses are late by: the way, and the headset's lag.
    assert item["value"] == pytest.approx(42e6, abs=5e6)
    assert item["uncertainty"] > 8e6
    assert item["time"].endswith("Z")
    with open_episode(sweep) as recorded:
        assert item["digest"] == recorded.digest()
    assert said["sweeps"][0]["detected"] == said["sweeps"][0]["frames"] == 270
    image = cv2.imread(str(picture))
    assert image is not None
    known = ("--exposure-ms", 4, "--readout-ms", "12,12", "--headset-lag-ms", 12)
    said = found(calibrate("latency", sweep, "--out", rig, *known, "-f", "json"))
    assert said["items"]["latency/pose"]["value"] == pytest.approx(42e6, abs=0.4e6)

    root = tmp_path / "dataset"
    create_dataset(root, DatasetMetadata(name="sweeps", licence="CC0-1.0"))
    with open_episode(sweep) as episode:
        target = root / episode_path(episode.id)
    target.parent.mkdir(parents=True)
    shutil.copytree(sweep, target)
    write_catalog(root, build_catalog(root)[0])
    for changed, text in ((True, "1 of 1 episodes changed"), (False, "0 of 1 episodes changed")):
        done = calibrate("apply", root, "--calibration", rig)
        assert done.exit_code == 0, done.output
        assert text in done.stdout
        assert ("times of: pose" in done.stdout) is changed
    report = validate(root)
    assert {p.code for p in report.problems} <= {"SPLIT-001"}
    with open_dataset(root)[0] as episode:
        assert episode.metadata.revision == 2
        clock = episode["pose"].metadata.clock
        assert clock.latency_ns == said["items"]["latency/pose"]["value"]
    # What is left of the latency, measured again by the corrected stream's stamps, is the same.
    said_again = found(calibrate("latency", target, "--out", rig, *known, "-f", "json"))
    assert said_again["items"]["latency/pose"]["value"] == clock.latency_ns


def test_a_sweep_that_is_refused(sweep: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.json"
    done = calibrate("latency", sweep, "--out", rig, "--marker", 5, "-f", "json")
    assert done.exit_code == 1
    (refused,) = json.loads(done.stdout)["refused"]
    assert "found in 0 of 270 frames" in refused["reason"]
    assert "another marker id" in refused["fix"]
    done = calibrate("latency", sweep, "--out", rig, "--max-lag", 0.05, "--dictionary", "DICT_X")
    assert done.exit_code == 2
    regular = SweepSettings(rate_hz=2.0, seconds=8.0, regular=True, frames_per_s=20.0, missing=0.0)
    path = write_sweep_episode(tmp_path / "r.zarr", regular)
    picture = tmp_path / "refused.png"
    done = calibrate("latency", path, "--out", rig, "--plot", picture)
    assert done.exit_code == 1
    assert "the sweep repeats itself" in done.output
    assert picture.exists()
    assert not rig.exists()
    said = json.loads(calibrate("latency", path, "--out", rig, "-f", "json").stdout)
    assert (said["items"], len(said["sweeps"])) == ({}, 1)
    assert "the sweep repeats itself" in said["refused"][0]["reason"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--plot", "sweep.svg"), "writes a PNG"),
        (("--plot", "."), "writes a PNG"),
        (("--end", "SWEEP"), "the same sweep"),
        (("--video-start", 3), "goes with --video"),
        (("--video", "nothing.mp4"), "no such file"),
        (("--video", "SWEEP/zarr.json", "--camera", "No/Name"), "no name of a stream"),
    ],
)
def test_options_of_a_sweep_that_make_no_sense(
    sweep: Path, tmp_path: Path, arguments: tuple[object, ...], said: str
) -> None:
    given = [str(one).replace("SWEEP", str(sweep)) for one in arguments]
    done = calibrate("latency", sweep, "--out", tmp_path / "rig.json", *given)
    assert (done.exit_code, said in done.output) == (2, True), done.output
    assert not list(tmp_path.iterdir())


def test_the_calibration_file_is_looked_at_before_any_work(tmp_path: Path) -> None:
    """An operator who has set nine openings by hand would lose them."""
    other = tmp_path / "other.json"
    other.write_text("{}")
    openings = ("--rig", "simulated", "--openings-mm", "0,10,20,30,40")
    for out in (tmp_path / "rig.toml", other):
        done = CliRunner().invoke(
            app, ["calibrate", "gripper", *openings, "--out", str(out)], input="\n" * 9
        )
        assert done.exit_code == 2
        assert "set the gripper" not in done.output
    for verb in ("contact", "controller", "latency", "tactile"):
        done = calibrate(verb, tmp_path / "x.zarr", "--out", other)
        assert (done.exit_code, "exumi-calibration" in done.output) == (2, True), done.output
    done = calibrate("gripper", *openings[:3], "0,10,-20,30,40", "--out", tmp_path / "rig.json")
    assert (done.exit_code, "an opening of -20 mm" in done.output) == (1, True)


def test_start_and_end_of_a_session(tmp_path: Path) -> None:
    short = replace(SETTINGS, seconds=7.0, frames_per_s=20.0)
    first = write_sweep_episode(tmp_path / "first.zarr", short, seed=3)
    later = replace(short, delay_s=short.delay_s + 0.008)
    last = write_sweep_episode(tmp_path / "last.zarr", later, seed=4)
    known = ("--exposure-ms", 4, "--readout-ms", "12,12", "--headset-lag-ms", 12)
    rig = tmp_path / "rig.json"
    picture = tmp_path / "both.png"
    more = (*known, "--plot", picture, "-f", "json")
    done = calibrate("latency", first, "--end", last, "--out", rig, *more)
    said = found(done)
    item = said["items"]["latency/pose"]
    assert len(said["sweeps"]) == 2
    change_ms = said["sweeps"][1]["latency_ms"] - said["sweeps"][0]["latency_ms"]
    assert change_ms == pytest.approx(8.0, abs=0.5)
    # The mean of both, and uncertain by half of what they differ by.
    assert item["value"] == pytest.approx(46e6, abs=0.5e6)
    assert item["uncertainty"] == pytest.approx(4e6, abs=0.5e6)
    assert "from the first to the last" in item["procedure"]
    assert "the latency changed by" in done.stderr
    # Both sweeps are drawn with the value that is used, which is that of neither.
    both = cv2.imread(str(picture))
    assert both is not None
    upper, lower = both[: len(both) // 2], both[len(both) // 2 :]
    assert upper.shape == lower.shape
    assert not np.array_equal(upper, lower)
    done = calibrate("latency", first, "--end", last, "--video", "x.mp4", "--out", rig)
    assert (done.exit_code, "exclude each other" in done.output) == (2, True)


def test_a_clip_in_place_of_a_camera(tmp_path: Path) -> None:
    short = replace(SETTINGS, seconds=7.0, frames_per_s=20.0)
    sweep = write_sweep_episode(tmp_path / "s.zarr", short, seed=6)
    clip = write_sweep_clip(tmp_path / "GX010001.MP4", short, seed=6)
    rig, lens = tmp_path / "rig.json", tmp_path / "lens.json"
    known = ("--exposure-ms", 4, "--readout-ms", "12,12", "--headset-lag-ms", 12)
    arguments = ("latency", sweep, "--video", clip, "--out", rig, *known)
    done = calibrate(*arguments)
    assert (done.exit_code, "has no intrinsics/rgb" in done.output) == (2, True)
    lens.write_text(
        json.dumps({"K": [[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]]})
    )
    size = f"{CAMERA.width}x{CAMERA.height}"
    assert calibrate("camera", lens, "--size", size, "--stream", "rgb", "--out", rig).exit_code == 0
    for start_s in (0.0, 0.25):
        said = found(calibrate(*arguments, "--video-start", start_s, "-f", "json"))
        # By as much as the clip is said to begin later, the poses are late by less.
        value = said["items"]["latency/pose"]["value"]
        assert value == pytest.approx(42e6 - 1e9 * start_s, abs=0.5e6)


def write(path: Path, add: Callable[[EpisodeWriter], None]) -> Path:
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        add(writer)
    return path


def test_gripper(tmp_path: Path) -> None:
    readings = tmp_path / "readings.csv"
    lines = [f"{10 * i},{(4000 + 60 * i) % 4096}" for i in range(8)]
    readings.write_text("opening_mm,count\n" + "\n".join(lines) + "\n")
    rig = tmp_path / "rig.json"
    done = calibrate("gripper", readings, "--out", rig)
    assert done.exit_code == 0, done.output
    assert "width_map: standard deviation 0.5" in done.stdout
    held = np.repeat(np.arange(8), 300)

    def add(writer: EpisodeWriter) -> None:
        raw = RawData(unit="count", modulus=4096)
        width = writer.add_stream("width", kind="width", raw=raw)
        counts = ((4000 + 60 * held) % 4096).astype(np.uint16)
        width.append(np.arange(len(held)) * 5_000_000, np.zeros(len(held)), raw=counts)

    steps = write(tmp_path / "steps.zarr", add)
    openings = ",".join(str(10 * i) for i in range(8))
    done = calibrate("gripper", steps, "--openings-mm", openings, "--out", rig, "--name", "w")
    assert done.exit_code == 0, done.output
    items = read_calibration(rig).items
    assert items["w"].value["raw_to_data"] == items["width_map"].value["raw_to_data"]
    done = calibrate("gripper", steps, "--openings-mm", "0,10", "--out", rig)
    assert (done.exit_code, "there are 2 openings" in done.output) == (1, True)
    done = calibrate("gripper", steps, "--openings-mm", openings.removesuffix(",70"), "--out", rig)
    assert (done.exit_code, "rested 8 times" in done.output) == (1, True)
    done = calibrate("gripper", steps, "--out", rig)
    assert (done.exit_code, "Name them: --openings-mm" in done.output) == (2, True)
    done = calibrate("gripper", readings, "--out", rig, "--name", "../w")
    assert (done.exit_code, "no name of a stream" in done.output) == (2, True)
    assert calibrate("gripper", readings, "--out", rig, "--gauge-mm", "inf").exit_code == 2


def test_controller(tmp_path: Path) -> None:
    def add(writer: EpisodeWriter) -> None:
        frames = Frames(parent="world", child="controller")
        pose = writer.add_stream("pose", kind="pose", frames=frames)
        poses = pivoting()
        pose.append(np.arange(len(poses)) * 11_000_000, poses)

    rig, path = tmp_path / "rig.json", write(tmp_path / "pivot.zarr", add)
    said = found(calibrate("controller", path, "--out", rig, "-f", "json"))
    matrix = np.array(said["items"]["T_controller_tcp"]["value"])
    assert matrix[:3, 3] == pytest.approx(TIP, abs=5e-4)
    chain = tmp_path / "chain.json"
    steps = [{"translation_m": [0, 0, 1]}]
    chain.write_text(json.dumps({"name": "T_a_b", "method": "published", "steps": steps}))
    assert calibrate("controller", "--chain", chain, "--out", rig).exit_code == 0
    assert set(read_calibration(rig).items) == {"T_controller_tcp", "T_a_b"}
    assert calibrate("controller", "--out", rig).exit_code == 2
    for wrong, text in (
        (("--jig", path, "--tool", "0,0,0,0"), "of length 1"),
        (("--tool", "0,0,0,1"), "goes with --jig"),
        (("--jig", path, "--hand-eye"), "goes with a tip"),
        (("--jig", path), "in its jig"),
    ):
        done = calibrate("controller", path, "--out", rig, *wrong)
        assert (done.exit_code in {1, 2}, text in done.output) == (True, True), done.output
    chain.write_text("{}")
    assert calibrate("controller", "--chain", chain, "--out", rig).exit_code == 2


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (("--tool", "0,0,0,1"), "goes with --jig or --in-jig"),
        (("--in-jig", "--tool", "0,0,0,2"), "of length 1"),
        (("--jig", "jig.zarr"), "neither --hand-eye nor --jig"),
    ],
)
def test_what_does_not_go_with_a_rig(wrong: tuple[str, ...], text: str, tmp_path: Path) -> None:
    options = ("--rig", "simulated", "--out", tmp_path / "rig.json")
    done = calibrate("controller", *options, *wrong)
    assert (done.exit_code, text in done.output) == (2, True), done.output


def test_hand_and_eye_in_a_sweep_turns_too_little(sweep: Path, tmp_path: Path) -> None:
    done = calibrate("controller", sweep, "--hand-eye", "--out", tmp_path / "rig.json")
    assert done.exit_code == 1
    assert "second axis" in done.output or "different views" in done.output


def test_contact(tmp_path: Path) -> None:
    def add(writer: EpisodeWriter) -> None:
        frames, samples = frame_times(20.0), np.arange(0, 20, 0.005)
        images = {"encoding": "array", "height": 2, "width": 2, "channels": 1}
        touch = writer.add_stream("tactile", kind="tactile", images=images)
        touch.append(as_ns(frames + 0.05), np.zeros((len(frames), 2, 2, 1), np.uint8))
        width = writer.add_stream("width", kind="width")
        width.append(as_ns(samples), width_m(samples))
        writer.add_derived(
            "tactile",
            "activity",
            activity(frames).astype(np.float32),
            algorithm="exumi-activity/1",
        )

    rig, path = tmp_path / "rig.json", write(tmp_path / "grasps.zarr", add)
    said = found(calibrate("contact", path, "--out", rig, "-f", "json"))
    item = said["items"]["latency/tactile"]
    assert abs(item["value"] - 50e6) < 3 * item["uncertainty"] < 25e6
    done = calibrate("contact", path, "--stream", "tactile", "--width", "width", "--out", rig)
    assert done.exit_code == 0
    done = calibrate("contact", path, "--stream", "width", "--out", rig)
    assert (done.exit_code, "of kind width" in done.output) == (2, True)


def test_contact_of_a_recording_as_it_comes(tmp_path: Path) -> None:
    """Coloured frames with a reference, no stored activity, a second width, bad readings."""

    def add(writer: EpisodeWriter) -> None:
        frames, samples = frame_times(20.0), np.arange(0, 20, 0.005)
        images = {"encoding": "array", "height": 48, "width": 64, "channels": 3}
        touch = writer.add_stream("tactile", kind="tactile", images=images)
        rest = np.full((48, 64, 3), 120, np.uint8)
        share = activity(frames)
        pressed = np.repeat(rest[None], len(frames), axis=0)
        for frame, part in zip(pressed, share, strict=True):
            frame.reshape(-1, 3)[: round(part * 48 * 64)] = 60
        touch.append(as_ns(frames + 0.05), pressed)
        touch.set_reference(rest, method="captured")
        width = writer.add_stream("width", kind="width")
        values, marks = width_m(samples), np.zeros(len(samples), np.uint32)
        values[::97], marks[::97] = 0.5, flags()["invalid"].mask
        width.append(as_ns(samples), values, flags=marks)
        other = writer.add_stream("width_right", kind="width")
        other.append(as_ns(samples), np.zeros(len(samples)))

    path = write(tmp_path / "grasps.zarr", add)
    said = found(calibrate("contact", path, "--out", tmp_path / "rig.json", "-f", "json"))
    item = said["items"]["latency/tactile"]
    assert abs(item["value"] - 50e6) < 3 * item["uncertainty"] < 25e6


def test_tactile(tmp_path: Path) -> None:
    rig, images = tmp_path / "rig.json", tmp_path / "rest"
    images.mkdir()
    for i, frame in enumerate(gel_frames(8)):
        cv2.imwrite(str(images / f"{i:02}.png"), frame)
    write_maps(tmp_path / "sensor/camera_calibration")
    (tmp_path / "sensor/depth_calibration").mkdir()
    np.save(tmp_path / "sensor/depth_calibration/Pixel_to_Depth.npy", np.array([0.0, 0.1]))
    done = calibrate(
        "tactile",
        images,
        *("--stream", "tactile_left", "--ninedtact", tmp_path / "sensor"),
        *("--mm-per-px", "0.05,0.06", "--out", rig),
    )
    assert done.exit_code == 0, done.output
    calibration = read_calibration(rig)
    assert sorted(calibration.items) == [
        "depth_table/tactile_left",
        "mm_per_px/tactile_left",
        "rectification/tactile_left",
        "tactile_reference/tactile_left",
    ]
    assert calibration.arrays["tactile_reference/tactile_left"].shape == (120, 160, 3)
    assert calibrate("tactile", "--stream", "t", "--out", rig).exit_code == 2
    assert calibrate("tactile", "--stream", "t", "--ninedtact", images, "--out", rig).exit_code == 2


def test_camera(tmp_path: Path) -> None:
    path = tmp_path / "k.json"
    path.write_text(json.dumps({"K": [[9, 0, 4], [0, 9, 3], [0, 0, 1]]}))
    rig = tmp_path / "rig.json"
    arguments = ("camera", path, "--stream", "rgb", "--out", rig)
    assert calibrate(*arguments).exit_code == 2
    assert calibrate(*arguments, "--size", "8by6").exit_code == 2
    said = found(calibrate(*arguments, "--size", "8x6", "-f", "json"))
    assert said["items"]["intrinsics/rgb"]["value"]["fx"] == 9.0
    for wrong, text in (("", "no name of a stream"), ("A/b", "no name of a stream")):
        done = calibrate("camera", path, "--stream", wrong, "--out", rig, "--size", "8x6")
        assert (done.exit_code, text in done.output) == (2, True)


def a_dataset(root: Path, sweep: Path) -> Path:
    """A dataset of one episode with its catalog; returns the episode's folder."""
    create_dataset(root, DatasetMetadata(name="sweeps", licence="CC0-1.0"))
    with open_episode(sweep) as episode:
        target = root / episode_path(episode.id)
    shutil.copytree(sweep, target)
    write_catalog(root, build_catalog(root)[0])
    return target


def test_an_apply_that_was_killed_is_taken_up(sweep: Path, tmp_path: Path) -> None:
    root, rig = tmp_path / "dataset", tmp_path / "rig.json"
    target = a_dataset(root, sweep)
    old = (root / "catalog.parquet").read_bytes()
    item = {"value": 42_000_000, "unit": "ns", "uncertainty": 1e6, "method": "by hand"}
    document = {"format": "exumi-calibration", "version": "1.0", "items": {"latency/pose": item}}
    rig.write_text(json.dumps(document))
    assert calibrate("apply", root, "-c", rig).exit_code == 0
    new = (root / "catalog.parquet").read_bytes()
    # Killed between the last episode and the catalog, with the old episode still aside.
    (root / "catalog.parquet").write_bytes(old)
    shutil.copytree(target, target.with_name(f".replaced-{target.name}"))
    done = calibrate("apply", root, "-c", rig)
    assert "0 of 1 episodes changed" in done.stdout
    assert (root / "catalog.parquet").read_bytes() == new != old
    assert [path.name for path in target.parent.iterdir()] == [target.name]
    # Killed between two renames.
    for where in (root, target):
        target.rename(target.with_name(f".replaced-{target.name}"))
        done = calibrate("apply", where, "-c", rig, "-f", "json")
        assert done.exit_code == 0, done.output
        assert "brought back" in json.loads(done.stdout)["notices"][0]
        assert target.is_dir()
    (target.parent / f".partial-{target.stem}" / "streams").mkdir(parents=True)
    # A dry run touches nothing.
    assert calibrate("apply", root, "-c", rig, "--dry-run").exit_code == 0
    assert len(list(target.parent.iterdir())) == 2
    with only_run(root):
        done = calibrate("apply", root, "-c", rig)
        assert (done.exit_code, "another command is writing" in done.output) == (2, True)
    assert calibrate("apply", root, "-c", rig).exit_code == 0
    assert [path.name for path in target.parent.iterdir()] == [target.name]


def test_an_episode_that_cannot_be_written_does_not_stop_the_others(
    sweep: Path, tmp_path: Path
) -> None:
    root, rig = tmp_path / "dataset", tmp_path / "rig.json"
    target = a_dataset(root, sweep)
    # Its name is one that sorts first, and its folder one that cannot be written into.
    readings = {"value": 1, "unit": "ns", "method": "by hand"}
    document = {
        "format": "exumi-calibration",
        "version": "1.0",
        "items": {"latency/pose": readings},
    }
    rig.write_text(json.dumps(document))
    shutil.rmtree(target / "streams/rgb/data")
    other = "00000000-0000-4000-8000-0000000000ff"
    second = root / episode_path(other)
    shutil.copytree(sweep, second)
    edit_metadata(second, lambda exumi: exumi.update(id=other))
    done = calibrate("apply", root, "-c", rig, "-f", "json")
    assert done.exit_code == 1
    said = json.loads(done.stdout)
    assert [Path(one["path"]).name for one in said["episodes"] if one["is_changed"]] == [
        second.name
    ]
    assert list(said["failed"]) == [str(target)]
    assert calibrate("apply", tmp_path / "nothing", "-c", rig).exit_code == 2
    assert calibrate("apply", tmp_path, "-c", rig).exit_code == 2
