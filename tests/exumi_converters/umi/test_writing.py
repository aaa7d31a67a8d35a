"""A buffer that is written holds what the episodes say, and other programs read it."""

import hashlib
import json
import os
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zarr
from imagecodecs.numcodecs import register_codecs
from scipy.spatial.transform import Rotation

from exumi_converters import (
    ConvertOptions,
    ExportOptions,
    ExportPlan,
    convert,
    export,
    plan_export,
    prepare,
)
from exumi_converters.zarr2_files.buffer import Buffer, open_buffer
from exumi_data.dataset import open_dataset
from exumi_data.errors import MissingExtraError, UsageError
from exumi_data.model import ArrayImages
from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_converters.umi.episodes import (
    CLOCK,
    FRAMES,
    PERIOD_NS,
    add_camera,
    add_gripper,
    add_tactile,
    dataset_of,
    frame_times,
    motion,
)

register_codecs(verbose=False)

INTEROP = Path(__file__).parents[3] / "scripts" / "interop_umi.py"
Add = Callable[[EpisodeWriter], object]


def write(source: Path, target: Path, **settings: str) -> Buffer:
    options = ExportOptions(settings=settings, workers=1, durable=False)
    report = export(source, target, to_format="umi", options=options)
    assert report.failed == ()
    return open_buffer(target)


def plan(source: Path, **settings: str) -> ExportPlan:
    return plan_export(
        source, source / "x.zarr", to_format="umi", options=ExportOptions(settings=settings)
    )


def rows(buffer: Buffer, name: str) -> np.ndarray:
    return buffer.rows(name, 0, int(buffer.ends[-1])).read()


def plain(writer: EpisodeWriter) -> None:
    add_gripper(writer)
    add_camera(writer)


# --------------------------------------------------------------------------------------- what it is


def test_motion_at_the_frames(grasps: Path, tmp_path: Path) -> None:
    buffer = write(grasps, tmp_path / "b.zarr", size="32")
    assert buffer.ends.tolist() == [FRAMES, 2 * FRAMES]
    position, rotation, width = motion(frame_times())
    both = np.concatenate([position, position])
    np.testing.assert_allclose(rows(buffer, "robot0_eef_pos"), both, atol=1e-6)
    found = Rotation.from_rotvec(rows(buffer, "robot0_eef_rot_axis_angle")[:FRAMES])
    assert (found.inv() * Rotation.from_quat(rotation)).magnitude().max() < 2e-6
    opening = rows(buffer, "robot0_gripper_width")
    assert opening.shape == (2 * FRAMES, 1)
    np.testing.assert_allclose(opening[:FRAMES, 0], width, atol=1e-6)
    for end, at in (("start", 0), ("end", FRAMES - 1)):
        pose = rows(buffer, f"robot0_demo_{end}_pose")
        assert pose.dtype == np.float64
        assert (pose[:FRAMES] == pose[0]).all()
        np.testing.assert_allclose(pose[0, :3], position[at], atol=1e-6)


def test_cameras_are_cut_and_resized(tmp_path: Path) -> None:
    pictures: list[np.ndarray] = []

    def add(writer: EpisodeWriter) -> None:
        add_gripper(writer)
        pictures.append(add_camera(writer))

    source = dataset_of(tmp_path / "d", add)
    buffer = write(source, tmp_path / "b.zarr", size="20", images="blosc")
    # 60x40 pixels: ten columns are cut on both sides, then two pixels become one.
    wanted = [cv2.resize(p[:, 10:50], (20, 20), interpolation=cv2.INTER_AREA) for p in pictures[0]]
    np.testing.assert_array_equal(rows(buffer, "camera0_rgb"), wanted)
    squeezed = write(source, tmp_path / "s.zarr", size="20", images="blosc", crop="no")
    wanted = [cv2.resize(p, (20, 20), interpolation=cv2.INTER_AREA) for p in pictures[0]]
    near = rows(squeezed, "camera0_rgb").astype(int) - np.array(wanted)
    assert np.abs(near).max() <= 1
    kept = write(source, tmp_path / "k.zarr", size="0", images="jpegxl-lossless")
    np.testing.assert_array_equal(rows(kept, "camera0_rgb"), pictures[0])


def test_the_tactile_image_is_exumis_clamped(tmp_path: Path) -> None:
    fingers: list[tuple[np.ndarray, np.ndarray]] = []

    def add(writer: EpisodeWriter) -> None:
        plain(writer)
        fingers.append(add_tactile(writer))

    buffer = write(dataset_of(tmp_path / "d", add), tmp_path / "b.zarr", size="0")
    found = rows(buffer, "tactile_combined")
    assert buffer.arrays["tactile_combined"].chunks == (1, 32, 64, 1)
    # The sensors have half the camera's rate: frame i of a finger is at rows 2i and 2i+1.
    for row in range(FRAMES):
        left, right = (f[row // 2].astype(int) for f in fingers[0])
        own = [f[0].astype(int) for f in fingers[0]]

        def turned(one: np.ndarray, other: np.ndarray) -> np.ndarray:
            return np.hstack([np.rot90(one, 1), np.rot90(other, -1)])

        grey, reference = turned(left, right), turned(*own)
        concave = np.clip(7 * (reference - grey), 0, 255)
        convex = np.clip(7 * (grey - reference), 0, 255)
        np.testing.assert_array_equal(found[row], np.stack([concave, convex, grey], axis=-1))
    assert found[..., 0].max() == 255


def test_our_own_channels_are_not_called_damaged(grasps: Path, tmp_path: Path) -> None:
    buffer = write(grasps, tmp_path / "b.zarr.zip", size="32")
    assert buffer.attributes["exumi"]["shared"]["tactile_made"] is True
    convert(buffer.path, tmp_path / "back", options=ConvertOptions(workers=1))
    for episode in open_dataset(tmp_path / "back"):
        codes = {note.code for note in episode.metadata.quality}
        assert not codes & {"wrapped-differences", "reversed-channels", "assumed-rate"}
        period = np.diff(episode["rgb"].time)
        assert np.abs(period - PERIOD_NS).max() <= 1


def test_channels_that_came_with_a_buffer_stay_as_they_are(converted: Path, tmp_path: Path) -> None:
    buffer = write(converted, tmp_path / "b.zarr", size="0")
    assert buffer.attributes["exumi"]["shared"]["tactile_made"] is False
    convert(buffer.path, tmp_path / "back", options=ConvertOptions(workers=1))
    for episode in open_dataset(tmp_path / "back"):
        assert "wrapped-differences" in {note.code for note in episode.metadata.quality}


def test_channels_are_made_anew_where_the_image_was_resized(
    converted: Path, tmp_path: Path
) -> None:
    prepare(converted, tmp_path / "prepared", size=24, lossless=True, workers=1)
    buffer = write(tmp_path / "prepared", tmp_path / "b.zarr", size="0")
    assert buffer.attributes["exumi"]["shared"]["tactile_made"] is True
    assert buffer.arrays["tactile_combined"].shape[1:] == (24, 24, 3)


def test_zarr_itself_reads_it(grasps: Path, tmp_path: Path) -> None:
    buffer = write(grasps, tmp_path / "b.zarr", size="32")
    root = zarr.open_group(tmp_path / "b.zarr", mode="r", zarr_format=2)
    names = set(buffer.arrays)
    assert {name for name, _ in root.require_group("data").arrays()} == names
    for name in names:
        np.testing.assert_array_equal(np.asarray(root[f"data/{name}"][:]), rows(buffer, name))  # type: ignore[index]  # an array


def test_a_zip_is_whole_and_says_where_it_is_from(grasps: Path, tmp_path: Path) -> None:
    write(grasps, tmp_path / "b.zarr.zip", size="32")
    with zipfile.ZipFile(tmp_path / "b.zarr.zip") as archive:
        assert archive.testzip() is None
        about = json.loads(archive.read(".zattrs"))["exumi"]
    assert [e["id"] for e in about["episodes"]] == open_dataset(grasps).ids
    assert about["exporter"] == "umi/1"


def test_two_robots_and_two_cameras(tmp_path: Path) -> None:
    def add(writer: EpisodeWriter) -> None:
        for number in (0, 1):
            add_gripper(writer, f"_robot{number}")
            add_camera(writer, f"rgb_camera{number}", seed=number)

    buffer = write(dataset_of(tmp_path / "d", add), tmp_path / "b.zarr", size="16")
    assert {"robot1_eef_pos", "robot1_gripper_width", "camera1_rgb"} <= set(buffer.arrays)
    assert (rows(buffer, "camera0_rgb") != rows(buffer, "camera1_rgb")).any()


def test_regular_rows(grasps: Path, tmp_path: Path) -> None:
    buffer = write(grasps, tmp_path / "b.zarr", size="16", timeline="rate", rate="20/1")
    count = int(buffer.ends[0])
    # From the first frame of the fingers to their last, which are the last to begin and end.
    start = 1_001_000_000
    ticks = start + np.arange(count) * 50_000_000
    np.testing.assert_allclose(rows(buffer, "robot0_eef_pos")[:count], motion(ticks)[0], atol=1e-6)
    assert buffer.attributes["exumi"]["rate"] == "20/1"


# ---------------------------------------------------------------------------------------- holes


def test_an_episode_with_a_hole_is_refused_or_cut(tmp_path: Path) -> None:
    def holed(writer: EpisodeWriter) -> None:
        add_gripper(writer, hole=True)
        add_camera(writer)

    source = dataset_of(tmp_path / "d", plain, holed)
    (refused,) = plan(source).refused
    assert "1 hole" in refused.reason
    assert "-o gaps=longest" in refused.reason
    with pytest.raises(UsageError, match="hole"):
        write(source, tmp_path / "b.zarr")
    cut = plan(source, gaps="longest")
    assert cut.refused == ()
    assert any("cut" in notice for notice in cut.notices)
    # 1.05 s to 1.2 s are missing, and what comes after is longer than what comes before.
    spans = {item.id: (item.settings["first"], item.settings["stop"]) for item in cut.items}
    first, stop = spans[refused.name]
    times = frame_times()
    assert stop == FRAMES
    assert 1_200_000_000 < times[first] < 1_200_000_000 + 2 * PERIOD_NS


def test_a_camera_that_lost_frames_is_a_hole(tmp_path: Path) -> None:
    keep = np.delete(np.arange(FRAMES), [8, 9])

    def add(writer: EpisodeWriter) -> None:
        add_gripper(writer)
        add_camera(writer, keep=keep)

    source = dataset_of(tmp_path / "d", add)
    with pytest.raises(UsageError, match="1 hole"):
        plan(source)


def test_ends_where_not_all_is_known_are_cut(tmp_path: Path) -> None:
    def add(writer: EpisodeWriter) -> None:
        add_gripper(writer)
        add_camera(writer)
        late = add_camera(writer, "rgb_late", keep=np.arange(8, FRAMES))
        assert len(late) == FRAMES - 8

    source = dataset_of(tmp_path / "d", add)
    (item,) = plan(source).items
    assert item.settings["first"] == 7  # a frame is the nearest one to the tick before it, too
    assert item.settings["stop"] == FRAMES


def test_cameras_of_two_rates_are_refused(tmp_path: Path) -> None:
    def slow(writer: EpisodeWriter) -> None:
        add_gripper(writer)
        add_camera(writer, keep=np.arange(0, FRAMES, 2))

    source = dataset_of(tmp_path / "d", plain, slow)
    with pytest.raises(UsageError, match="timeline=rate"):
        plan(source)
    assert len(plan(source, timeline="rate").items) == 2


# ---------------------------------------------------------------------------------------- refusals


def unpaired(writer: EpisodeWriter) -> None:
    add_gripper(writer)
    width = writer.add_stream("width_robot1", kind="width")
    width.append([0], [0.1])


def without_reference(writer: EpisodeWriter) -> None:
    plain(writer)
    add_tactile(writer, reference=False)


@pytest.mark.parametrize(
    ("add", "reason"),
    [
        (add_camera, "no pose"),
        (add_gripper, "no camera"),
        (unpaired, "do not belong together"),
        (without_reference, "no reference image"),
    ],
)
def test_what_an_episode_lacks_is_said(tmp_path: Path, add: Add, reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        plan(dataset_of(tmp_path / "d", add))


def test_the_few_that_differ_from_the_many_are_refused(tmp_path: Path) -> None:
    def more(writer: EpisodeWriter) -> None:
        plain(writer)
        add_tactile(writer)

    made = plan(dataset_of(tmp_path / "d", more, more, plain))
    assert len(made.items) == 2
    assert "it has no tactile_combined" in made.refused[0].reason
    made = plan(dataset_of(tmp_path / "e", plain, plain, more))
    assert made.refused == ()
    assert {loss.stream for loss in made.losses if loss.facet == "streams"} == {
        "tactile_left",
        "tactile_right",
    }


def test_sizes_that_differ(tmp_path: Path) -> None:
    def other(writer: EpisodeWriter) -> None:
        add_gripper(writer)
        images = ArrayImages(encoding="array", height=8, width=8, channels=3)
        stream = writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=images)
        stream.append(frame_times(), np.zeros((FRAMES, 8, 8, 3), np.uint8))

    source = dataset_of(tmp_path / "d", plain, other)
    assert len(plan(source).items) == 2
    (refused,) = plan(source, size="0").refused
    assert "-o size=224" in refused.reason


@pytest.mark.parametrize(
    "settings", [{"size": "-1"}, {"rate": "59.94"}, {"images": "gif"}, {"nonsense": "1"}]
)
def test_options_that_make_no_sense(grasps: Path, settings: dict[str, str]) -> None:
    with pytest.raises(UsageError):
        plan(grasps, **settings)


def test_without_imagecodecs_there_is_a_way_out(
    grasps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "imagecodecs", None)
    with pytest.raises(MissingExtraError, match=r"exumi-data\[umi\].*images=blosc"):
        plan(grasps)


# ------------------------------------------------------------------------------ UMI's own way


def test_zarr_2_reads_it_as_umi_does(grasps: Path, tmp_path: Path) -> None:
    python = os.environ.get("EXUMI_ZARR2_PYTHON")
    if not python:
        pytest.skip("EXUMI_ZARR2_PYTHON names no Python with zarr 2 and imagecodecs")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    for name, images in (("b.zarr.zip", "jpegxl-lossless"), ("b.zarr", "jpegxl")):
        buffer = write(grasps, tmp_path / name, size="32", images=images)
        done = subprocess.run(
            [python, str(INTEROP), str(tmp_path / name)],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
            timeout=100,
        )
        assert done.returncode == 0, done.stderr
        found: dict[str, Any] = json.loads(done.stdout)
        assert found["zarr"].startswith("2.")
        assert found["episode_ends"] == buffer.ends.tolist()
        assert set(found["arrays"]) == set(buffer.arrays)
        for array, one in found["arrays"].items():
            # Versions of libjxl differ by a level or two in what they decode of lossy files.
            if images == "jpegxl-lossless" or array != "camera0_rgb":
                ours = np.ascontiguousarray(rows(buffer, array)).tobytes()
                assert one["sha256"] == hashlib.sha256(ours).hexdigest(), array
            assert one["shape"] == list(buffer.arrays[array].shape)
