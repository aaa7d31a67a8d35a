"""What a replay buffer holds is in the episodes; what is the matter with it is said."""

import json
import os
import shutil
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import zarr
from imagecodecs.numcodecs import Jpeg
from scipy.spatial.transform import Rotation
from zarr.storage import ZipStore

from exumi_converters import ConversionReport, ConvertOptions, convert, plan_conversion
from exumi_converters.detection import detect_format
from exumi_converters.registry import converters
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_converters.umi.layout import find_layout
from exumi_converters.zarr2_files.buffer import open_buffer
from exumi_data.dataset import Dataset, open_dataset
from exumi_data.episode import Episode as OpenEpisode
from exumi_data.errors import SourceError, UnsupportedError, UsageError
from exumi_data.standard import flags
from exumi_data.time import nominal_times, parse_rate
from tests.exumi_converters.umi.buffers import Episode, gel, make_episode, write_buffer

RATE = parse_rate("60000/1001")
Run = Callable[..., tuple[ConversionReport, list[OpenEpisode]]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Convert a buffer in this process; return its episodes in the buffer's order."""

    def convert_it(source: Path, **options: Any) -> tuple[ConversionReport, list[OpenEpisode]]:
        settings = options.pop("settings", {})
        told = ConvertOptions(settings=settings, workers=1, durable=False, **options)
        report = convert(source, tmp_path / "out", from_format="umi", options=told)
        return report, in_order(open_dataset(tmp_path / "out"))

    return convert_it


def in_order(dataset: Dataset) -> list[OpenEpisode]:
    return sorted(dataset, key=lambda episode: str(episode.metadata.source.key))


def notes(episode: OpenEpisode) -> dict[str, str]:
    found: dict[str, str] = {}
    for note in episode.metadata.quality:
        found[note.code] = f"{found.get(note.code, '')}{note.stream}: {note.message}\n"
    return found


def stored(path: Path, name: str) -> np.ndarray:
    """Read an array of a packed buffer with zarr itself."""
    with closing(ZipStore(path, mode="r")) as store:
        root = zarr.open_group(store, mode="r", zarr_format=2)
        return np.asarray(root[f"data/{name}"][:])  # type: ignore[index]  # an array


# ----------------------------------------------------------------------------------------- contents


def test_poses_widths_and_times(converted: Path) -> None:
    for seed, (count, episode) in enumerate(
        zip((24, 30), in_order(open_dataset(converted)), strict=True)
    ):
        truth = make_episode(count, seed).arrays
        pose = episode["pose"]
        np.testing.assert_array_equal(pose.data[:, :3], truth["robot0_eef_pos"])
        turned = Rotation.from_quat(pose.data[:, 3:])
        wanted = Rotation.from_rotvec(truth["robot0_eef_rot_axis_angle"])
        assert (turned.inv() * wanted).magnitude().max() < 1e-6
        # The rotation vector changes sides in the middle; the quaternion does not.
        steps = np.abs(np.diff(truth["robot0_eef_rot_axis_angle"], axis=0)).max()
        assert steps > 3
        assert (np.einsum("ij,ij->i", pose.data[1:, 3:], pose.data[:-1, 3:]) > 0.9).all()
        np.testing.assert_array_equal(episode["width"].data, truth["robot0_gripper_width"][:, 0])
        for stream in episode.streams.values():
            np.testing.assert_array_equal(stream.time, nominal_times(count, RATE))
            assert stream.metadata.clock.stamp_point == "nominal_rate"
            assert stream.metadata.nominal_rate == "60000/1001"
        assert "assumed-rate" in notes(episode)


def test_start_and_end_pose_are_kept(converted: Path) -> None:
    episode = in_order(open_dataset(converted))[0]
    truth = make_episode(24, 0).arrays
    said = episode["pose"].metadata.model_extra or {}
    for end in ("start", "end"):
        assert said[f"umi:demo_{end}_pose"] == truth[f"robot0_demo_{end}_pose"][0].tolist()


def test_frames_are_those_of_the_buffer(buffer: Path, converted: Path) -> None:
    episode = in_order(open_dataset(converted))[1]
    rgb, tactile = (stored(buffer, name)[24:] for name in ("camera0_rgb", "tactile_combined"))
    np.testing.assert_array_equal(episode["rgb"].frames[:], rgb)
    np.testing.assert_array_equal(episode["tactile_combined"].frames[:][..., 0], tactile[..., 2])
    kept = episode["tactile_combined_differences"]
    assert kept.kind == "exumi:differences"
    np.testing.assert_array_equal(kept.data, tactile[..., :2])


def test_cameras_are_jpeg_unless_told(buffer: Path, run: Run) -> None:
    _, episodes = run(buffer, settings={"quality": "97"})
    rgb = episodes[0]["rgb"]
    assert rgb.metadata.images.encoding == "encoded"  # type: ignore[attr-defined]  # an image stream
    frames = stored(buffer, "camera0_rgb")[:24]
    assert np.abs(rgb.frames[:].astype(int) - frames).mean() < 1.5
    # Chroma is not halved: at this size every pixel has a colour of its own.
    assert b"\x11\x00\x02\x11\x01\x03\x11\x01" in rgb.encoded(0)[:800]
    steps = {step.step: step for step in episodes[0].metadata.source.lossy or ()}
    assert steps["jpeg-encode"].parameters == {"quality": 97, "chroma": "4:4:4"}
    assert steps["image-encode"].parameters is not None


def test_two_grippers_two_cameras_and_no_touch(tmp_path: Path, run: Run) -> None:
    episode = make_episode(8, robots=2, cameras=2, tactile=False, size=20)
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode]))
    assert set(only) == {
        *("pose_robot0", "pose_robot1", "width_robot0", "width_robot1"),
        *("rgb_camera0", "rgb_camera1"),
    }
    np.testing.assert_array_equal(only["pose_robot1"].data[:, :3], episode.arrays["robot1_eef_pos"])


def test_folder_and_zip_give_the_same_episodes(
    tmp_path: Path, buffer: Path, converted: Path, run: Run
) -> None:
    folder = tmp_path / "unpacked.zarr"
    with zipfile.ZipFile(buffer) as archive:
        archive.extractall(folder)
    run(folder, settings={"images": "lossless"})
    assert open_dataset(tmp_path / "out").fingerprint == open_dataset(converted).fingerprint


def test_a_zip_with_a_folder_around_it_is_read(tmp_path: Path, run: Run, buffer: Path) -> None:
    wrapped = tmp_path / "w.zip"
    with zipfile.ZipFile(buffer) as old, zipfile.ZipFile(wrapped, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(f"dataset.zarr/{name}", old.read(name))
    report, _ = run(wrapped)
    assert report.converted == 2


def test_more_episodes_at_the_end_leave_the_others_as_they_are(tmp_path: Path) -> None:
    episodes = [make_episode(6, i, size=16) for i in range(3)]
    ids = []
    for count in (2, 3):
        source = write_buffer(tmp_path / f"{count}.zarr", episodes[:count])
        options = ConvertOptions(workers=1, durable=False)
        convert(source, tmp_path / f"out{count}", options=options)
        ids.append([e.id for e in in_order(open_dataset(tmp_path / f"out{count}"))])
    assert ids[1][:2] == ids[0]


@pytest.mark.parametrize("codec", [None, Jpeg(level=95)], ids=["plain", "jpeg"])
def test_other_codecs(tmp_path: Path, run: Run, codec: Any) -> None:
    episode = make_episode(5, tactile=False)
    source = write_buffer(tmp_path / "b.zarr.zip", [episode], codec=codec)
    _, (only,) = run(source, settings={} if codec else {"images": "lossless"})
    if codec is None:
        np.testing.assert_array_equal(only["rgb"].frames[:], episode.arrays["camera0_rgb"])
        return
    # A JPEG is kept as it is.
    with zipfile.ZipFile(source) as archive:
        assert only["rgb"].encoded(3) == archive.read("data/camera0_rgb/3.0.0.0")
    assert "jpeg-encode" not in {s.step for s in only.metadata.source.lossy or ()}


def test_chunks_of_any_shape(tmp_path: Path, run: Run) -> None:
    episode = make_episode(11, tactile=False, size=20)
    folder = tmp_path / "b.zarr"
    write_buffer(folder, [episode, episode])
    data = zarr.open_group(folder, zarr_format=2).require_group("data")
    frames = np.concatenate([episode.arrays["camera0_rgb"]] * 2)
    del data["camera0_rgb"]
    array = data.create_array(
        "camera0_rgb",
        shape=frames.shape,
        chunks=(4, 9, 20, 2),
        dtype=frames.dtype,
        order="F",
        chunk_key_encoding={"name": "v2", "separator": "/"},
    )
    array[...] = frames
    _, both = run(folder, settings={"images": "lossless"})
    for only in both:
        np.testing.assert_array_equal(only["rgb"].frames[:], episode.arrays["camera0_rgb"])


def test_sound_and_a_second_kind_of_image(tmp_path: Path, run: Run) -> None:
    episode = make_episode(6, tactile=False)
    sound = np.sin(np.arange(6 * 800) / 9).reshape(6, 800).astype(np.float32) * 0.5
    episode.arrays["mic_0"] = sound
    episode.arrays["realsense_colored"] = episode.arrays["camera0_rgb"]
    episode.arrays["realsense_depth"] = np.zeros((6, 4, 4), np.uint16)
    report, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode]))
    assert np.abs(only["mic_0"].samples(0, 4800)[:, 0] / 32768 - sound.ravel()).max() < 2e-5
    assert only["mic_0"].metadata.rate == "48000000/1001"  # type: ignore[attr-defined]  # sound
    assert only["rgb_realsense_colored"].kind == "rgb"
    assert any("realsense_depth is left out" in notice for notice in report.notices)
    (left_out,) = [s for s in only.metadata.source.lossy or () if s.step == "left-out"]
    assert set(left_out.parameters or {}) == {"realsense_depth"}


def test_sound_that_is_too_loud_or_none(tmp_path: Path, run: Run) -> None:
    episode = make_episode(6, tactile=False)
    sound = np.zeros((6, 100))
    sound[0, :4] = np.nan, np.inf, 1e308, -2.5
    sound[1, :2] = 0.5, -1.0
    episode.arrays["mic_0"] = sound
    folder = write_buffer(tmp_path / "b.zarr", [episode], low_dim_rows=1)
    (folder / "data/mic_0/3.0").unlink()
    _, (only,) = run(folder)
    blocks = np.stack([np.asarray(block) for block in only["mic_0"].data]).reshape(6, 100)
    assert blocks[0, :5].tolist() == [0, 0, 32767, -32768, 0]
    assert blocks[1, :2].tolist() == [16384, -32768]
    (step,) = [s for s in only.metadata.source.lossy or () if s.step == "int16"]
    assert step.parameters == {"dtype": "float64", "clipped": 2, "not_finite": 2}
    assert "mic_0 lacks chunks" in notes(only)["fill-value"]


def test_the_rate_can_be_told(tmp_path: Path, run: Run) -> None:
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [make_episode(4)]), rate="30/1")
    np.testing.assert_array_equal(only["rgb"].time, nominal_times(4, parse_rate("30")))
    assert "assumed-rate" not in notes(only)


def test_what_was_told_of_frames_task_and_regime(tmp_path: Path, run: Run) -> None:
    source = write_buffer(tmp_path / "b.zarr", [make_episode(4)])
    settings = {"parent": "base", "child": "flange", "regime": "play"}
    _, (only,) = run(source, settings=settings, task="cups", licence="MIT")
    frames = only["pose"].metadata.frames  # type: ignore[attr-defined]  # a pose
    assert (frames.parent, frames.child) == ("base", "flange")
    assert (only.metadata.task.name, only.metadata.regime) == ("cups", "play")
    assert only.metadata.licence == "MIT"


# --------------------------------------------------------------------------------- exUMI's channels


def test_damage_of_the_released_pipeline_is_named(converted: Path) -> None:
    episode = in_order(open_dataset(converted))[0]
    assert {"wrapped-differences", "reversed-channels"} <= set(notes(episode))
    by = "exUMI's released pipeline"
    steps = [step for step in episode.metadata.source.lossy or () if step.by == by]
    assert {"difference", "video-encode", "blend", "combine"} <= {step.step for step in steps}
    assert any("59 instead of 59.94" in step.detail for step in steps)
    assert any("first frame" in step.detail for step in steps)


def test_activity_is_measured_on_the_grey_image(converted: Path) -> None:
    episode = in_order(open_dataset(converted))[0]
    activity = episode.derived_array("tactile_combined/activity")
    assert activity is not None
    assert activity[:8].max() < 5e-4 < activity[-8:].min()
    assert episode.derived is not None
    item = episode.derived.items["tactile_combined/activity"]
    assert item.parameters["active_above"] == 5e-4


def test_sound_differences_are_not_called_wrapped(tmp_path: Path, run: Run) -> None:
    episode = make_episode(24)
    grey = gel(24, 48, depth=30)
    base = grey[0].astype(int)
    channels = [np.clip(7 * (base - grey), 0, 255), np.clip(7 * (grey - base), 0, 255), grey]
    episode.arrays["tactile_combined"] = np.stack(channels, axis=-1).astype(np.uint8)
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode]))
    assert "wrapped-differences" not in notes(only)


def test_the_straight_order_is_known(tmp_path: Path, run: Run) -> None:
    episode = make_episode(24)
    stored = episode.arrays["tactile_combined"]
    episode.arrays["tactile_combined"] = np.ascontiguousarray(stored[..., ::-1])
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode], codec=None))
    np.testing.assert_array_equal(only["tactile_combined"].frames[:][..., 0], stored[..., 2])
    np.testing.assert_array_equal(only["tactile_combined_differences"].data, stored[..., :2])
    assert "reversed-channels" not in notes(only)


@pytest.mark.parametrize("channels", [1, 3])
def test_pictures_of_a_gel_are_pictures(tmp_path: Path, run: Run, channels: int) -> None:
    episode = make_episode(24)
    grey = gel(24, 48)
    pictures = np.stack([grey, grey - 20, grey - 40][:channels], axis=-1)
    episode.arrays["tactile_combined"] = pictures
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode], codec=None))
    assert "tactile_combined_differences" not in only
    np.testing.assert_array_equal(only["tactile_combined"].frames[:], pictures)


def test_long_episodes_are_decoded_twice_and_not_kept(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, converted: Path
) -> None:
    defaults = TactileAnalysis.__init__.__kwdefaults__
    assert defaults is not None
    monkeypatch.setitem(defaults, "kept_bytes", 1)
    monkeypatch.setattr("exumi_converters.zarr2_files.pictures._BATCH_BYTES", 1)
    source = write_buffer(tmp_path / "b.zarr", [make_episode(24, 0)])
    _, (only,) = run(source, settings={"images": "lossless"})
    one = in_order(open_dataset(converted))[0]
    for key in ("activity", "salient"):
        np.testing.assert_array_equal(
            only.derived_array(f"tactile_combined/{key}"),
            one.derived_array(f"tactile_combined/{key}"),
        )


# ---------------------------------------------------------------------------------------- bad input


def test_a_missing_and_a_damaged_frame_are_gaps(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(20)])
    (folder / "data/camera0_rgb/3.0.0.0").unlink()
    (folder / "data/camera0_rgb/7.0.0.0").write_bytes(b"garbage")
    (folder / "data/tactile_combined/11.0.0.1").unlink()
    report, (only,) = run(folder)
    assert report.failed == ()
    assert len(only["rgb"]) == 18
    assert [(gap.after, gap.lost) for gap in only["rgb"].metadata.gaps or ()] == [(2, 1), (5, 1)]
    assert "2 of 20" in notes(only)["damaged-frames"]
    assert len(only["tactile_combined"]) == len(only["tactile_combined_differences"]) == 19
    assert only["rgb"].time[3] == nominal_times(20, RATE)[4]


def test_frames_that_were_never_written_are_named(tmp_path: Path, run: Run) -> None:
    episode = make_episode(12)
    episode.arrays["camera0_rgb"][4:6] = 0
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode]))
    assert "2 of 12" in notes(only)["blank-frames"]


def test_numbers_that_are_none_are_flagged(tmp_path: Path, run: Run) -> None:
    episode = make_episode(12)
    episode.arrays["robot0_eef_pos"][3, 1] = np.nan
    episode.arrays["robot0_eef_rot_axis_angle"][5] = np.inf
    episode.arrays["robot0_gripper_width"][2] = np.nan
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode]))
    mask = flags()["invalid"].mask
    assert np.flatnonzero(only["pose"].array("flags") & mask).tolist() == [3, 5]
    assert np.flatnonzero(only["width"].array("flags") & mask).tolist() == [2]
    assert "not-finite" in notes(only)
    assert not np.isinf(only["pose"].data).any()


def test_numbers_beyond_float32_and_turns_without_end_are_none(tmp_path: Path, run: Run) -> None:
    episode = make_episode(12, tactile=False)
    for name in ("robot0_eef_pos", "robot0_eef_rot_axis_angle", "robot0_gripper_width"):
        episode.arrays[name] = episode.arrays[name].astype(np.float64)
    episode.arrays["robot0_eef_pos"][3] = 1e300
    episode.arrays["robot0_eef_rot_axis_angle"][5] = 1e200
    episode.arrays["robot0_gripper_width"][2] = -1e300
    _, (only,) = run(write_buffer(tmp_path / "b.zarr", [episode]))
    mask = flags()["invalid"].mask
    assert np.flatnonzero(only["pose"].array("flags") & mask).tolist() == [3, 5]
    assert np.flatnonzero(only["width"].array("flags") & mask).tolist() == [2]


def test_numbers_that_zarr_does_not_store_are_its_fill_value(tmp_path: Path, run: Run) -> None:
    episode = make_episode(12, tactile=False)
    episode.arrays["robot0_gripper_width"][:6] = 0  # such chunks zarr 3 leaves out
    folder = write_buffer(tmp_path / "b.zarr", [episode], low_dim_rows=6)
    (folder / "data/robot0_gripper_width/0.0").unlink()
    _, (only,) = run(folder)
    expected = episode.arrays["robot0_gripper_width"][:, 0]
    np.testing.assert_array_equal(only["width"].data, expected)
    assert "width: data/robot0_gripper_width lacks chunks" in notes(only)["fill-value"]


def test_one_bad_episode_does_not_end_the_run(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(
        tmp_path / "b.zarr", [make_episode(6, i) for i in range(3)], low_dim_rows=6
    )
    for path in (folder / "data/camera0_rgb").glob("[6-9].*"):
        path.write_bytes(b"no")
    for row in (10, 11):
        (folder / f"data/camera0_rgb/{row}.0.0.0").unlink()
    (folder / "data/robot0_eef_pos/2.0").write_bytes(b"short")
    report, episodes = run(folder)
    assert report.converted == len(episodes) == 1
    reasons = {failure.name: failure.reason for failure in report.failed}
    assert "no frame can be decoded" in reasons["000001"]
    assert "rows from 0 cannot be read" in reasons["000002"]


def set_ends(folder: Path, ends: list[int]) -> None:
    path = folder / "meta/episode_ends/0"
    values = np.frombuffer(path.read_bytes(), np.int64).copy()
    values[: len(ends)] = ends
    path.write_bytes(values.tobytes())


@pytest.mark.parametrize(
    ("ends", "converted", "failed"),
    [
        ([6, 4, 18], ["000000"], ["000001", "000002"]),
        ([6, 6, 18], ["000000", "000002"], ["000001"]),
        ([6, 12, 99], ["000000", "000001"], ["000002"]),
        ([-3, 12, 18], ["000002"], ["000000", "000001"]),
    ],
)
def test_ends_that_make_no_sense(
    tmp_path: Path, run: Run, ends: list[int], converted: list[str], failed: list[str]
) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6, i) for i in range(3)])
    set_ends(folder, ends)
    report, episodes = run(folder)
    done = {str(episode.metadata.source.key) for episode in episodes}
    assert set(converted) <= done
    assert set(failed) <= {failure.name for failure in report.failed}


def test_an_array_that_is_too_short_or_too_long(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6, i) for i in range(2)])
    document = folder / "data/camera0_rgb/.zarray"
    told = json.loads(document.read_text())
    told["shape"][0] = 10
    document.write_text(json.dumps(told))
    report, episodes = run(folder)
    assert len(episodes) == 1
    assert "data/camera0_rgb has 10 rows" in report.failed[0].reason
    set_ends(folder, [6, 9])
    assert any("belong to no episode" in n for n in plan_conversion(folder).notices)


def test_foreign_files_and_arrays_do_not_matter(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6)])
    (folder / "README.txt").write_text("hello")
    (folder / "data/.DS_Store").write_bytes(b"x")
    (folder / "data/camera0_rgb/999.0.0.0").write_bytes(b"x")
    (folder / "data/strange").mkdir()
    (folder / "data/strange/.zarray").write_text("{")
    report, _ = run(folder)
    assert report.converted == 1
    assert any("data/strange is left out" in notice for notice in report.notices)


def test_no_array_takes_the_stream_of_another(tmp_path: Path, run: Run) -> None:
    episode = make_episode(6, cameras=2)
    images = episode.arrays["camera0_rgb"]
    long = "tactile_" + "x" * 60
    names = ["camera0", "Cam-1", "cam_1", "tactile.combined", "tactile_combined_differences"]
    for number, name in enumerate([*names, f"{long}1", f"{long}2"]):
        episode.arrays[name] = np.roll(images, number, axis=3) + np.uint8(number)
    folder = write_buffer(tmp_path / "b.zarr", [episode])
    layout = find_layout(open_buffer(folder).arrays, {})
    assert sorted(layout.arrays) == sorted(episode.arrays)
    report, (only,) = run(folder)
    assert report.failed == ()
    assert len([s for s in only.streams.values() if s.kind == "rgb"]) == 5


def test_names_that_cannot_be_written_down_are_left_out(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6, tactile=False)])
    for name in (b"a\nb", b" x", b"\xff", b"y" * 250, "caméra".encode()):
        shutil.copytree(
            folder / "data/camera0_rgb", os.fsdecode(bytes(folder / "data") + b"/" + name)
        )
    report, (only,) = run(folder)
    assert report.converted == 1
    assert {"rgb", "rgb_cam_ra"} < set(only.streams)
    assert sum("no plain text" in notice for notice in report.notices) == 4
    assert all(notice.isprintable() for notice in report.notices)


@pytest.mark.parametrize(
    "changes",
    [
        {"compressor": "blosc"},
        {"compressor": 0},
        {"compressor": [1]},
        {"filters": "delta"},
        {"filters": [None]},
        {"filters": {"id": "delta"}},
        {"compressor": {"id": "zstd", "level": float("nan")}},
    ],
)
def test_a_codec_that_is_none_leaves_its_array_out(tmp_path: Path, changes: dict[str, Any]) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6, tactile=False)])
    document = folder / "data/camera0_rgb/.zarray"
    document.write_text(json.dumps({**json.loads(document.read_text()), **changes}))
    notices = plan_conversion(folder, from_format="umi").notices
    assert any("camera0_rgb is left out: its .zarray is damaged" in notice for notice in notices)


def test_damaged_attributes_do_not_matter(tmp_path: Path) -> None:
    rows = [make_episode(6, tactile=False)]
    path = write_buffer(tmp_path / "b.zarr.zip", rows, attributes={"told": 1})
    assert open_buffer(path).attributes == {"told": 1}
    path.write_bytes(path.read_bytes().replace(b'"told"', b'"tolb"'))  # the checksum is wrong
    assert open_buffer(path).attributes == {}


def test_pickles_are_never_loaded(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6)])
    (folder / "data/notes").mkdir()
    document = {
        "zarr_format": 2,
        "shape": [6],
        "chunks": [6],
        "dtype": "|O",
        "fill_value": None,
        "order": "C",
        "compressor": None,
        "filters": [{"id": "pickle", "protocol": 5}],
    }
    (folder / "data/notes/.zarray").write_text(json.dumps(document))
    (folder / "data/notes/0").write_bytes(b"cos\nsystem\n(S'touch pwned'\ntR.")
    report, (only,) = run(folder)
    assert any("never loaded" in n and "Write the array again" in n for n in report.notices)
    assert "left-out" in {step.step for step in only.metadata.source.lossy or ()}
    (folder / "meta/episode_ends/.zarray").write_text(json.dumps(document))
    with pytest.raises(UnsupportedError, match=r"never loaded.*Write the array again"):
        plan_conversion(folder)


def test_links_are_not_followed(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6)])
    secret = tmp_path / "secret"
    secret.write_bytes((folder / "data/camera0_rgb/2.0.0.0").read_bytes())
    frame = folder / "data/camera0_rgb/2.0.0.0"
    frame.unlink()
    frame.symlink_to(secret)
    _, (only,) = run(folder)
    assert len(only["rgb"]) == 5
    assert "link" in notes(only)["damaged-frames"]
    shutil.move(folder / "data/tactile_combined", tmp_path / "elsewhere")
    (folder / "data/tactile_combined").symlink_to(tmp_path / "elsewhere")
    assert any("tactile_combined is left out" in n for n in plan_conversion(folder).notices)


def test_a_buffer_that_claims_too_much_is_refused(tmp_path: Path) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6, tactile=False)])
    document = folder / "data/camera0_rgb/.zarray"
    told = json.loads(document.read_text())
    for shape, chunks in (
        ([6, 60_000, 60_000, 3], [1, 60_000, 60_000, 3]),
        ([6, 60_000, 60_000, 3], [1, 1, 1, 1]),
        ([6, 48, 48, 3], [1 << 30, 48, 48, 3]),
    ):
        document.write_text(json.dumps({**told, "shape": shape, "chunks": chunks}))
        plan = plan_conversion(folder, from_format="umi")
        assert any("camera0_rgb is left out" in notice for notice in plan.notices)


@pytest.mark.parametrize("kept", [40, 4000])
def test_a_zip_that_is_cut_short(tmp_path: Path, buffer: Path, kept: int) -> None:
    path = tmp_path / "cut.zarr.zip"
    path.write_bytes(buffer.read_bytes()[:-kept])
    with pytest.raises(SourceError, match=r"cut short|damaged|missing"):
        plan_conversion(path, from_format="umi")


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "b.zarr.zip")
    with pytest.raises(SourceError, match="neither a folder nor a zip"):
        plan_conversion(tmp_path / "b.zarr.zip", from_format="umi")


def test_nothing_there(tmp_path: Path) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6)])
    for path in (folder / "data").glob("[a-z]*"):
        shutil.rmtree(path)
    with pytest.raises(SourceError, match="no array"):
        plan_conversion(folder, from_format="umi")
    with pytest.raises(SourceError, match="no such"):
        plan_conversion(tmp_path / "not", from_format="umi")
    with pytest.raises(SourceError, match="no replay buffer"):
        plan_conversion(tmp_path, from_format="umi")


def test_a_buffer_without_episodes(tmp_path: Path) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6)])
    document = folder / "meta/episode_ends/.zarray"
    document.write_text(json.dumps({**json.loads(document.read_text()), "shape": [0]}))
    with pytest.raises(SourceError, match="there is no episode"):
        plan_conversion(folder)


def test_labels_are_refused(buffer: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="labels"):
        plan_conversion(buffer, options=ConvertOptions(labels=tmp_path / "x.csv"))


def test_it_is_recognised_and_others_are_not(buffer: Path, tmp_path: Path) -> None:
    name, reason = detect_format(buffer, converters())
    assert (name, reason) == ("umi", "meta/episode_ends and data/robot0_eef_pos")
    other = write_buffer(tmp_path / "o.zarr", [Episode({"state": np.zeros((4, 2))})])
    assert converters()["umi"].recognise(other) is None
    (tmp_path / "x.zip").write_bytes(b"PK\3\4garbage")
    assert converters()["umi"].recognise(tmp_path / "x.zip") is None


def test_jpegxl_of_another_channel_count_is_damage(tmp_path: Path, run: Run) -> None:
    folder = write_buffer(tmp_path / "b.zarr", [make_episode(6)])
    grey = imagecodecs.jpegxl_encode(np.zeros((48, 48), np.uint8), lossless=True)
    (folder / "data/camera0_rgb/0.0.0.0").write_bytes(grey)
    _, (only,) = run(folder)
    assert len(only["rgb"]) == 5
