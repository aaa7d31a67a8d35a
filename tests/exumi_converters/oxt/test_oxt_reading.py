"""``--from oxt``: stores as others write them, with what the contract leaves open, and damaged."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from scipy.spatial.transform import Rotation

from exumi_converters.conversion import convert, plan_conversion
from exumi_converters.converter import ConvertOptions
from exumi_converters.registry import find_converter
from exumi_converters.testing import check_converter
from exumi_data.dataset import Dataset, open_dataset
from exumi_data.episode import Episode
from exumi_data.errors import ExumiError, SourceError
from tests.exumi_converters.oxt.stores import SIZE, episode, group, pictures, write_store

CONVERTER = find_converter("oxt")
NS = 1_000_000_000
FIRST_FRAMES = "0.0.0.0"  # noqa: S104  # a chunk, no address


def read(source: Path, *, rate: str | None = None, **settings: str) -> Dataset:
    """Convert with one worker; what fails is in the report beside."""
    options = ConvertOptions(settings=settings, rate=rate, workers=1, durable=False)
    folder = source.parent / f"{source.name}-out-{len(list(source.parent.iterdir()))}"
    report = convert(source, folder, from_format="oxt", options=options)
    assert not report.failed, report.failed
    return open_dataset(folder)


def first(source: Path, **settings: Any) -> Episode:
    """Return the first episode by its key."""
    return min(read(source, **settings), key=lambda found: str(found.metadata.source.key))


def failures(source: Path, **settings: str) -> tuple[int, str]:
    """Return how many episodes were converted, and why the others were not."""
    options = ConvertOptions(settings=settings, workers=1, durable=False)
    report = convert(source, source.parent / "out", from_format="oxt", options=options)
    return report.converted, " / ".join(f"{item.name}: {item.reason}" for item in report.failed)


def notes(found: Episode) -> dict[str, str]:
    return {note.code: note.message for note in found.metadata.quality}


def test_the_contract_of_converters(tmp_path: Path) -> None:
    source = tmp_path / "domain"
    write_store(source / "wipe.zarr", episode(), episode(9, 1))
    write_store(source / "pour.zarr", episode(8, 2))
    check_converter(CONVERTER, source, tmp_path / "work")


def test_a_store_becomes_episodes(tmp_path: Path) -> None:
    one, two = episode(12, 0), episode(9, 1)
    dataset = read(write_store(tmp_path / "wipe.zarr", one, two), gripper="m")
    found = sorted(dataset, key=lambda e: str(e.metadata.source.key))
    assert [str(e.metadata.source.key) for e in found] == ["wipe.zarr/000000", "wipe.zarr/000001"]
    for given, made in zip((one, two), found, strict=True):
        assert set(made) == {"rgb", "tactile_left", "tactile_right", "pose", "width"}
        time = np.round(np.arange(len(given["timestamps"])) / 30 * NS).astype(np.int64)
        for stream in made.streams.values():
            np.testing.assert_array_equal(stream.time, time)
            assert stream.metadata.clock.stamp_point == "nominal_rate"
            assert stream.metadata.nominal_rate == "30/1"
        np.testing.assert_array_equal(made["rgb"].frames[:], given["right_wrist_camera_rgb"])
        for pad, side in enumerate(("left", "right")):
            stream = made[f"tactile_{side}"]
            np.testing.assert_array_equal(
                stream.frames[:], given["right_tactile_data_gripper"][:, pad]
            )
            assert stream.metadata.sensor is not None
            assert (stream.metadata.sensor.model, stream.metadata.sensor.side) == (
                "gelsight-mini",
                side,
            )
            assert stream.activity is not None
        pose = made["pose"].data
        np.testing.assert_array_equal(pose[:, :3], given["right_wrist_pose"][:, :3])
        turn = Rotation.from_rotvec(given["right_wrist_pose"][:, 3:])
        assert (turn.inv() * Rotation.from_quat(pose[:, 3:])).magnitude().max() < 1e-6
        np.testing.assert_array_equal(made["width"].data, given["right_hand_joints"][:, 0])
        assert made.metadata.task.name == "wipe"
        assert made.metadata.task.instruction == "wipe the table"
        steps = {step.step: step.parameters or {} for step in made.metadata.source.lossy or []}
        assert "right_arm_joints" in steps["left-out"]


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("dated", [False, True])
def test_timestamps_in_any_unit(unit: str, dated: bool, tmp_path: Path) -> None:
    scale = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    rng = np.random.default_rng(3)
    seconds = np.cumsum(rng.uniform(0.03, 0.05, 12)) + (1.77e9 if dated else 5.0)
    stamps = seconds if unit == "s" else np.round(seconds * scale).astype(np.int64)
    found = first(write_store(tmp_path / "a.zarr", {**episode(), "timestamps": stamps}))
    time = found["rgb"].time
    wanted = np.round((stamps - stamps[0]).astype(np.float64) * (NS / scale)).astype(np.int64)
    assert np.abs(time - wanted).max() <= 1
    assert found["rgb"].metadata.clock.stamp_point == "unknown"
    assert f"taken to be in {unit}" in notes(found)["assumed-unit"]
    assert (found.metadata.start is not None) == dated
    if dated:
        assert str(found.metadata.start).startswith("2026-02-")


@pytest.mark.parametrize("stamps", ["seconds", "milliseconds"])
def test_rounded_stamps_of_a_rate_are_its_times(stamps: str, tmp_path: Path) -> None:
    number = np.delete(np.arange(13), 4)
    given = 1.77e9 + number / 30
    if stamps == "milliseconds":
        given = np.round(number * 1000 / 30).astype(np.int64)
    found = first(write_store(tmp_path / "a.zarr", {**episode(), "timestamps": given}))
    np.testing.assert_array_equal(found["rgb"].time, np.round(number / 30 * NS))
    assert found["rgb"].metadata.clock.stamp_point == "nominal_rate"
    assert [(gap.after, gap.lost) for gap in found["rgb"].metadata.gaps or []] == [(3, 1)]


@pytest.mark.parametrize("value", ["null", "[]", "{}", "1e999", "9" * 400, '"x"', "true"])
def test_a_mark_that_makes_no_sense_is_passed_over(value: str, tmp_path: Path) -> None:
    cells = group(12, np.ones((12, 1, 4, 5), np.float32), name="pad", areas=(3,), kind="state")
    path = write_store(tmp_path / "a.zarr", {**episode(), **cells})
    keys = (
        "turned_about_z_deg",
        "parent",
        "child",
        "unit",
        "streams",
        "components",
        "offset",
        "sign",
    )
    about = "{" + ", ".join(f'"{key}": {value}' for key in keys) + "}"
    arrays = ("right_wrist_pose", "right_hand_joints", "timestamps", "right_tactile_data_pad")
    marked = ", ".join(f'"{array}": {about}' for array in arrays)
    told = f'{{"exumi": {{"exporter": "oxt/1", "task": {value}, "arrays": {{{marked}}}}}}}'
    (path / ".zattrs").write_text(told)
    assert {"pose", "tactile_left"} < set(first(path, gripper="m").streams)


def test_ends_of_which_none_makes_sense(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode(10))
    root = zarr.open_group(str(path), zarr_format=2)
    ends: Any = root["meta/episode_ends"]
    ends[:] = [-5]
    with pytest.raises(SourceError, match=r"no episode has its rows; .* rows 0 to -5"):
        plan_conversion(path, from_format="oxt")


def test_numbers_of_steps_need_a_rate(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", {**episode(), "timestamps": np.arange(12)})
    with pytest.raises(SourceError, match=r"nothing says how many a second.*--rate 30"):
        read(path)
    found = first(path, rate="24")
    np.testing.assert_array_equal(found["rgb"].time, np.round(np.arange(12) / 24 * NS))
    assert found["rgb"].metadata.clock.stamp_point == "nominal_rate"
    assert "numbers of steps" in notes(found)["assumed-unit"]


def test_numbers_that_are_missing_are_gaps(tmp_path: Path) -> None:
    numbers = np.array([0, 1, 2, 5, 6, 7, 8, 9, 10, 11, 12, 13])
    path = write_store(tmp_path / "a.zarr", {**episode(), "timestamps": numbers})
    found = first(path, rate="30", timestamps="number")
    gaps = found["pose"].metadata.gaps or []
    assert [(gap.after, gap.lost) for gap in gaps] == [(2, 2)]


def test_steps_are_counted_where_stamps_are_broken_and_the_user_says_so(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", {**episode(), "timestamps": np.zeros(12)})
    with pytest.raises(SourceError, match=r"nothing tells the unit"):
        read(path)
    assert "do not come after the one before" in failures(path, timestamps="s")[1]
    found = first(path, timestamps="number", rate="30")
    np.testing.assert_array_equal(found["rgb"].time, np.round(np.arange(12) / 30 * NS))


def test_one_stamp_that_goes_back_is_moved_and_flagged(tmp_path: Path) -> None:
    stamps = np.arange(12) / 30
    stamps[5] = stamps[4]
    found = first(write_store(tmp_path / "a.zarr", {**episode(), "timestamps": stamps}))
    time = found["rgb"].time
    assert time[5] == time[4] + 1
    flags = found["rgb"].flags
    assert flags is not None
    assert np.flatnonzero(flags).tolist() == [5]
    assert "time-nudged" in notes(found)


def test_a_stamp_that_is_no_number_fails_its_episode_alone(tmp_path: Path) -> None:
    stamps = np.arange(12) / 30
    stamps[7] = np.nan
    path = write_store(tmp_path / "a.zarr", episode(20), {**episode(), "timestamps": stamps})
    count, reasons = failures(path)
    assert count == 1
    assert "a.zarr/000001: the timestamp of step 7 is no number" in reasons


def test_poses_that_are_no_numbers_are_flagged(tmp_path: Path) -> None:
    given = episode()
    given["right_wrist_pose"][3] = np.nan
    found = first(write_store(tmp_path / "a.zarr", given))
    flags = found["pose"].flags
    assert flags is not None
    assert np.flatnonzero(flags).tolist() == [3]
    assert "1 of 12 samples" in notes(found)["not-finite"]


def test_a_grippers_number_needs_a_unit(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    options = ConvertOptions()
    notices = plan_conversion(path, from_format="oxt", options=options).notices
    assert any("right_hand_joints is left out" in n and "-o gripper=m" in n for n in notices)
    assert "width" not in first(path)
    np.testing.assert_allclose(first(path, gripper="cm")["width"].data[0], 1e-4, rtol=1e-6)


def test_a_name_that_states_metres_is_enough(tmp_path: Path) -> None:
    width = np.linspace(0, 0.08, 12, dtype=np.float32)[:, None]
    path = write_store(tmp_path / "a.zarr", {**episode(), "robot0_gripper_width_m": width})
    np.testing.assert_array_equal(first(path)["width"].data, width[:, 0])
    assert "width" not in first(path, gripper="skip")


def test_a_joint_that_is_no_gripper_is_left_out(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode(), right_hand_joints_idx=np.full((12, 1), 3))
    found = first(path, gripper="m")
    assert "width" not in found
    assert "is joint 3, no gripper" in notes(found)["not-converted"]


def test_images_of_other_axes_and_grey_ones(tmp_path: Path) -> None:
    given = episode()
    camera, pads = given["right_wrist_camera_rgb"], given["right_tactile_data_gripper"]
    path = write_store(
        tmp_path / "a.zarr",
        given,
        right_wrist_camera_rgb=np.moveaxis(camera, 3, 1).copy(),
        right_tactile_data_gripper=pads[..., 0].copy(),
        camera_main_rgb=camera[:, ::2],
    )
    found = first(path)
    np.testing.assert_array_equal(found["rgb_right_wrist"].frames[:], camera)
    np.testing.assert_array_equal(found["rgb_main"].frames[:], camera[:, ::2])
    np.testing.assert_array_equal(found["tactile_right"].frames[:], pads[:, 1, ..., :1])


def test_cameras_can_become_jpeg(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    found = first(path, images="jpeg", quality="90")
    images: Any = found["rgb"].metadata
    assert images.images.encoding == "encoded"
    steps = [s for s in found.metadata.source.lossy or [] if s.step == "jpeg-encode"]
    assert [(s.stream, (s.parameters or {})["quality"]) for s in steps] == [("rgb", 90)]


def test_cells_become_taxels_and_forces_are_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cells = rng.normal(0, 1, (12, 2, 4, 5)).astype(np.float32)
    touch = rng.integers(0, 2, (12, 1, 3, 3)).astype(np.uint8)
    axes = rng.normal(0, 1, (12, 2, 4, 4, 3)).astype(np.float32)
    force = rng.normal(0, 1, (12, 1, 6)).astype(np.float32)
    given = {
        **episode(),
        **group(12, cells, name="cells", kind="state", sensor="3DViTac"),
        **group(12, touch, name="palm", kind="binary", areas=(5,), sensor="Xela"),
        **group(12, axes, name="uskin", kind="matrix", sensor="uSkin"),
        **group(12, force, name="torque", kind="state", areas=(15,), sensor="ATIAxia80M20"),
    }
    found = first(write_store(tmp_path / "a.zarr", given))
    for pad, side in enumerate(("left", "right")):
        stream = found[f"tactile_cells_{side}"]
        assert stream.kind == "taxels"
        np.testing.assert_array_equal(stream.data, cells[:, pad])
    palm: Any = found["tactile_palm_5"]
    np.testing.assert_array_equal(palm.data, touch[:, 0].astype(np.int16))
    assert (palm.metadata.unit, palm.metadata.grid) == ("oxt:unstated", [3, 3])
    said = " / ".join(note.message for note in found.metadata.quality)
    assert "right_tactile_data_torque was left out: order and units" in said
    assert "right_tactile_data_uskin was left out: (4, 4, 3) is no grid" in said


def test_two_hands_are_told_apart(tmp_path: Path) -> None:
    given = episode()
    pads = pictures(np.random.default_rng(4), 12, 1)
    other = {
        "left_wrist_pose": given["right_wrist_pose"],
        "left_hand_joints": given["right_hand_joints"],
        "left_hand_joints_idx": given["right_hand_joints_idx"],
        **group(12, pads, side="left", areas=(1,)),
    }
    found = first(write_store(tmp_path / "a.zarr", {**given, **other}), gripper="m")
    assert set(found) == {
        "rgb",
        "left_tactile_right",
        "right_tactile_left",
        "right_tactile_right",
        "pose_left",
        "pose_right",
        "width_left",
        "width_right",
    }


def test_an_instruction_that_changes_becomes_segments(tmp_path: Path) -> None:
    given = episode()
    given["sub_task_instruction"] = np.array(["reach"] * 5 + ["grasp it"] * 7)
    found = first(write_store(tmp_path / "a.zarr", given))
    segments = (found.metadata.annotations.segments if found.metadata.annotations else None) or []
    time = found["pose"].time
    assert [(s.name, s.start_ns, s.end_ns) for s in segments] == [
        ("reach", 0, time[5]),
        ("grasp it", time[5], time[-1]),
    ]
    assert found.metadata.task.instruction == "reach"


@pytest.mark.parametrize("inside", [True, False])
def test_a_zip_is_read_as_its_folder(inside: bool, tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    root = {"root_dir": tmp_path, "base_dir": "a.zarr"} if inside else {"root_dir": path}
    shutil.make_archive(str(tmp_path / "zips" / "a.zarr"), "zip", **root)
    packed = first(tmp_path / "zips")
    plain = first(path)
    assert packed.metadata.task.name == plain.metadata.task.name == "a"
    np.testing.assert_array_equal(packed["rgb"].frames[:], plain["rgb"].frames[:])
    inputs = [{i.sha256 for i in e.metadata.source.inputs or []} for e in (packed, plain)]
    assert inputs[0] == inputs[1]


def test_groups_that_lack_their_own_documents_are_read(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    (path / "data" / ".zgroup").unlink()  # as in releases
    assert len(read(path)) == 1


def test_chunks_that_are_not_stored_hold_the_fill_value(tmp_path: Path) -> None:
    pads = pictures(np.random.default_rng(4), 12, 1)
    given = {k: v for k, v in episode().items() if "tactile" not in k}
    path = write_store(tmp_path / "a.zarr", {**given, **group(12, pads, areas=(0,))})
    folder = path / "data" / "right_tactile_area_gripper"
    for chunk in folder.glob("[0-9]*"):
        chunk.unlink(missing_ok=True)  # zarr writes none where all are the fill value
    assert "tactile_left" in first(path)
    (path / "data" / "right_wrist_pose" / "1.0").unlink()
    found = first(path)
    assert not found["pose"].data[5:10, :6].any()
    assert "right_wrist_pose lacks chunks" in notes(found)["fill-value"]


def rewrite(path: Path, array: str, **changes: Any) -> None:
    """Change the document of an array."""
    file = path / "data" / array / ".zarray"
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


def test_frames_that_are_damaged_are_left_out(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    chunk = path / "data" / "right_wrist_camera_rgb" / "1.0.0.0"
    chunk.write_bytes(chunk.read_bytes()[:100])
    (path / "data" / "right_tactile_data_gripper" / "0.0.0.0.0").unlink()
    found = first(path)
    assert len(found["rgb"]) == 7
    assert len(found["tactile_left"]) == 7
    assert len(found["pose"]) == 12
    given = episode()["right_wrist_camera_rgb"][[*range(5), 10, 11]]
    np.testing.assert_array_equal(found["rgb"].frames[:], given)
    assert "5 of 12 frames" in notes(found)["damaged-frames"]


def test_numbers_that_are_damaged_fail_their_episode_alone(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode(10), episode(10, 1))
    (path / "data" / "right_wrist_pose" / "3.0").write_bytes(b"\x02\x01garbled")
    count, reasons = failures(path)
    assert count == 1
    assert "a.zarr/000001: " in reasons
    assert "right_wrist_pose: rows from 5 cannot be read" in reasons


def test_counts_that_do_not_match_fail_the_episodes_they_touch(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode(10), episode(10, 1))
    rewrite(path, "right_wrist_camera_rgb", shape=[15, SIZE, SIZE, 3])
    count, reasons = failures(path)
    assert count == 1
    assert "data/right_wrist_camera_rgb has 15 rows, this episode is rows 10 to 20" in reasons


def test_ends_that_go_back_fail_their_episode_alone(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode(10), episode(10, 1))
    root = zarr.open_group(str(path), zarr_format=2)
    ends: Any = root["meta/episode_ends"]
    ends[:] = [10, 5]
    count, reasons = failures(path)
    assert count == 1
    assert "meta/episode_ends gives it rows 10 to 5" in reasons


@pytest.mark.parametrize(
    ("key", "values", "message"),
    [
        ("type", ["image"] * 4 + ["state"] * 8, "changes from 'image' to 'state' at step 4"),
        ("type", ["picture"] * 12, "is 'picture'; types are image, state, binary, matrix"),
        ("sensor", ["GelSightMini"] * 11 + ["DIGIT"], "changes from 'GelSightMini' to 'DIGIT'"),
        ("sensor", [""] * 12, "is empty"),
    ],
)
def test_words_of_a_tactile_group_are_checked(
    key: str, values: list[str], message: str, tmp_path: Path
) -> None:
    given = {**episode(), f"right_tactile_{key}_gripper": np.array(values)}
    assert message in failures(write_store(tmp_path / "a.zarr", given))[1]


def test_areas_are_checked(tmp_path: Path) -> None:
    areas = np.tile([0, 1], (12, 1))
    areas[6] = [1, 0]
    path = write_store(tmp_path / "a.zarr", episode(), right_tactile_area_gripper=areas)
    assert "is [1, 0] at step 6" in failures(path)[1]


def test_a_group_without_one_of_its_arrays_is_left_out(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode(), right_tactile_type_gripper=None)
    options = ConvertOptions()
    notices = plan_conversion(path, from_format="oxt", options=options).notices
    assert any("right_tactile_type_gripper is missing" in notice for notice in notices)
    assert set(first(path)) == {"rgb", "pose"}


def test_pickles_are_refused_with_a_way_out(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    pickled = {"dtype": "|O", "filters": [{"id": "pickle", "protocol": 5}], "fill_value": None}
    rewrite(path, "sub_task_instruction", **pickled)
    with pytest.raises(SourceError, match=r"pickles.*never loaded.*strings of fixed width"):
        read(path)


def test_one_store_that_holds_pickles_does_not_end_the_run(tmp_path: Path) -> None:
    source = tmp_path / "domain"
    path = write_store(source / "a.zarr", episode())
    write_store(source / "b.zarr", episode(8, 1))
    rewrite(path, "sub_task_instruction", compressor={"id": "pickle"}, filters=None)
    count, reasons = failures(source)
    assert count == 1
    assert "a.zarr: " in reasons
    assert "never loaded" in reasons


def test_tactile_words_that_are_objects_leave_their_group_out(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    rewrite(path, "right_tactile_sensor_gripper", dtype="|O", filters=[{"id": "vlen-utf8"}])
    assert set(first(path)) == {"rgb", "pose"}


def test_claims_of_enormous_arrays_cost_nothing(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    rewrite(path, "right_wrist_camera_rgb", chunks=[10**6, SIZE, SIZE, 3])
    rewrite(path, "right_wrist_pose", shape=[10**12, 6])
    found = first(path)
    assert "rgb" not in found
    assert len(found["pose"]) == 12
    steps = {s.step: s.parameters or {} for s in found.metadata.source.lossy or []}
    assert "a chunk of" in steps["left-out"]["right_wrist_camera_rgb"]


def test_a_bomb_is_one_damaged_chunk(tmp_path: Path) -> None:
    from numcodecs import Blosc

    path = write_store(tmp_path / "a.zarr", episode())
    bomb = Blosc("zstd", clevel=9).encode(np.zeros(1 << 28, np.uint8))
    (path / "data" / "right_wrist_camera_rgb" / FIRST_FRAMES).write_bytes(bomb)
    assert len(first(path)["rgb"]) == 7


def test_links_out_of_the_store_are_not_followed(tmp_path: Path) -> None:
    path = write_store(tmp_path / "domain" / "a.zarr", episode())
    chunk = path / "data" / "right_wrist_camera_rgb" / FIRST_FRAMES
    outside = tmp_path / "outside"
    chunk.rename(outside)
    chunk.symlink_to(outside)
    assert len(first(path)["rgb"]) == 7


def test_foreign_files_do_no_harm(tmp_path: Path) -> None:
    source = tmp_path / "domain"
    path = write_store(source / "a.zarr", episode())
    (source / "README.md").write_text("read me")
    (source / "broken.zarr.zip").write_bytes(b"PK\x03\x04 and no more")
    (source / "empty.zarr").mkdir()
    (path / "data" / "notes.txt").write_text("remember")
    count, reasons = failures(source)
    assert count == 1
    assert "broken.zarr.zip: " in reasons


@pytest.mark.parametrize("content", [b"{", b"[]", b'{"zarr_format": 3}', b"[" * 10_000])
def test_documents_that_are_garbled_are_refused(content: bytes, tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    (path / "data" / "timestamps" / ".zarray").write_bytes(content)
    with pytest.raises(ExumiError, match=r"timestamps"):
        read(path)


def test_an_attribute_of_nonsense_is_passed_over(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    mark: dict[str, Any] = {
        "exporter": "oxt/1",
        "task": 7,
        "episodes": "all",
        "arrays": {
            "right_wrist_pose": {"streams": ["../x"], "parent": 3, "turned_about_z_deg": "no"},
            "right_tactile_data_gripper": {"streams": ["rgb", "rgb"], "components": 5},
            "timestamps": {"unit": "fortnights"},
        },
    }
    (path / ".zattrs").write_text(json.dumps({"exumi": mark}))
    found = first(path)
    assert set(found) == {"rgb", "pose", "tactile_left", "tactile_right"}


def test_an_empty_store_and_an_empty_folder_are_refused(tmp_path: Path) -> None:
    path = write_store(tmp_path / "a.zarr", episode())
    (path / "meta" / "episode_ends" / ".zarray").write_text(
        json.dumps(
            {
                **json.loads((path / "meta" / "episode_ends" / ".zarray").read_text()),
                "shape": [0],
            }
        )
    )
    with pytest.raises(SourceError):
        read(path)
    (tmp_path / "nothing").mkdir()
    with pytest.raises(SourceError, match=r"no store in it.*unpack a .tar first"):
        read(tmp_path / "nothing")


def test_the_format_is_recognised_by_itself_and_alone(tmp_path: Path) -> None:
    source = tmp_path / "domain"
    write_store(source / "sub" / "a.zarr", episode())
    done = subprocess.run(
        [
            *(sys.executable, "-m", "exumi_data.cli", "convert"),
            *(str(source), str(tmp_path / "out"), "--dry-run"),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert (
        "read as oxt (a.zarr holds meta/episode_ends, data/timestamps" in done.stdout + done.stderr
    )
