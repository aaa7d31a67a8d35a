"""``--to oxt``: what the contract asks for, on one timeline, cut where there is nothing to say."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from scipy.spatial.transform import Rotation

from exumi_converters.exporter import ExportOptions
from exumi_converters.exporting import export, plan_export
from exumi_converters.registry import find_exporter
from exumi_converters.testing import check_exporter
from exumi_data.errors import UsageError
from tests.exumi_converters.oxt.motions import NS, SIZE, motion, times, write_motions
from tests.exumi_converters.whole import write_dataset

EXPORTER = find_exporter("oxt")


def write(dataset: Path, folder: Path, **settings: str) -> Path:
    """Export with one worker."""
    options = ExportOptions(settings=settings, workers=1, durable=False)
    export(dataset, folder, to_format="oxt", options=options)
    return folder


def opened(path: Path) -> Any:
    return zarr.open_group(str(path), mode="r", zarr_format=2)


def plan(dataset: Path, **settings: str) -> Any:
    options = ExportOptions(settings=settings)
    return plan_export(dataset, dataset.parent / "never", to_format="oxt", options=options)


@pytest.fixture(scope="module")
def motions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_motions(tmp_path_factory.mktemp("motions") / "data", {}, {"seconds": 1.2})


def test_the_contract_of_exporters(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", seconds=0.5, tactile=2)
    check_exporter(EXPORTER, dataset, tmp_path / "out")


def test_a_store_holds_what_the_contract_asks_for(motions: Path, tmp_path: Path) -> None:
    root = opened(write(motions, tmp_path / "domain") / "turn.zarr")
    ends = root["meta/episode_ends"][:]
    length = int(ends[-1])
    data = {key: root[f"data/{key}"] for key in root["data"]}
    assert len(ends) == 2
    assert {array.shape[0] for array in data.values()} == {length}
    assert {key: (array.shape[1:], array.dtype.str) for key, array in data.items()} == {
        "timestamps": ((), "<f8"),
        "sub_task_instruction": ((), "<U7"),
        "right_wrist_camera_rgb": ((SIZE, SIZE, 3), "|u1"),
        "right_wrist_pose": ((6,), "<f4"),
        "right_hand_joints": ((1,), "<f4"),
        "right_hand_joints_idx": ((1,), "<i8"),
        "right_tactile_data_gripper": ((2, SIZE, SIZE, 3), "|u1"),
        "right_tactile_area_gripper": ((2,), "<i8"),
        "right_tactile_sensor_gripper": ((), "<U12"),
        "right_tactile_type_gripper": ((), "<U5"),
    }
    assert (data["right_hand_joints_idx"][:] == 28).all()
    assert (data["right_tactile_area_gripper"][:] == [0, 1]).all()
    assert set(data["right_tactile_sensor_gripper"][:]) == {"GelSightMini"}
    assert set(data["right_tactile_type_gripper"][:]) == {"image"}
    assert set(data["sub_task_instruction"][:]) == {"turn it"}


def test_steps_are_the_cameras_own_times_and_values_are_those_of_the_steps(
    motions: Path, tmp_path: Path
) -> None:
    root = opened(write(motions, tmp_path / "domain") / "turn.zarr")
    stop = int(root["meta/episode_ends"][0])
    time = np.round(root["data/timestamps"][:stop] * NS).astype(np.int64)
    camera, pads = times(30.0, 2.0), times(25.0, 2.0, 0.003)
    first = int(np.searchsorted(camera, time[0]))
    assert first == 1  # the pose begins 1 ms after the first frame
    np.testing.assert_array_equal(time, camera[first : first + stop])
    frames = root["data/right_wrist_camera_rgb"][:stop]
    np.testing.assert_array_equal(frames[:, 0, 0, 0], np.arange(first, first + stop))
    nearest = np.abs(pads[None, :] - time[:, None]).argmin(axis=1)
    touch = root["data/right_tactile_data_gripper"][:stop]
    np.testing.assert_array_equal(
        touch, np.broadcast_to(nearest[:, None, None, None, None], touch.shape)
    )
    poses, width = motion(time)
    found = root["data/right_wrist_pose"][:stop]
    assert np.abs(found[:, :3] - poses[:, :3]).max() < 2e-5
    turn = Rotation.from_rotvec(found[:, 3:]).inv() * Rotation.from_quat(poses[:, 3:])
    assert np.degrees(turn.magnitude()).max() < 0.01
    assert np.abs(root["data/right_hand_joints"][:stop, 0] - width).max() < 1e-5


def test_a_declared_rate_gives_the_steps(motions: Path, tmp_path: Path) -> None:
    root = opened(write(motions, tmp_path / "domain", rate="60000/1001") / "turn.zarr")
    stop = int(root["meta/episode_ends"][0])
    time = np.round(root["data/timestamps"][:stop] * NS).astype(np.int64)
    wanted = 3_000_000 + np.round(np.arange(stop) * 1001 / 60000 * NS).astype(np.int64)
    np.testing.assert_array_equal(time, wanted)  # the pads begin last, after 3 ms
    camera = times(30.0, 2.0)
    frames = root["data/right_wrist_camera_rgb"][:stop, 0, 0, 0]
    np.testing.assert_array_equal(frames, np.abs(camera[None] - time[:, None]).argmin(axis=1))


def test_another_stream_can_give_the_steps(motions: Path, tmp_path: Path) -> None:
    root = opened(write(motions, tmp_path / "domain", timeline="tactile_right") / "turn.zarr")
    stop = int(root["meta/episode_ends"][0])
    found = np.round(root["data/timestamps"][:stop] * NS).astype(np.int64)
    assert set(found.tolist()) <= set(times(25.0, 2.0, 0.003).tolist())


def hole(time: np.ndarray) -> np.ndarray:
    return np.asarray((time < 0.8 * NS) | (time > 1.3 * NS))


@pytest.mark.parametrize("given", [{"keep": hole}, {"invalid": lambda time: ~hole(time)}])
def test_an_episode_is_cut_where_a_stream_has_no_value(
    given: dict[str, Any], tmp_path: Path
) -> None:
    dataset = write_motions(tmp_path / "data", given)
    found = plan(dataset)
    assert any("are cut into pieces" in notice and "2 pieces" in notice for notice in found.notices)
    root = opened(write(dataset, tmp_path / "domain") / "turn.zarr")
    ends = root["meta/episode_ends"][:]
    time = root["data/timestamps"][:]
    assert len(ends) == 2
    assert time[ends[0] - 1] < 0.8
    assert time[ends[0]] > 1.3
    poses, _ = motion(np.round(time * NS).astype(np.int64))
    assert np.abs(root["data/right_wrist_pose"][:, :3] - poses[:, :3]).max() < 2e-5


def test_an_episode_with_a_gap_can_be_refused(tmp_path: Path) -> None:
    dataset = write_motions(tmp_path / "data", {"keep": hole}, {})
    found = plan(dataset, gaps="refuse")
    assert len(found.items) == 1
    assert "fall into gaps (pose: " in found.refused[0].reason
    with pytest.raises(UsageError, match="--keep-going"):
        write(dataset, tmp_path / "domain", gaps="refuse")


def test_a_gap_that_is_short_enough_is_interpolated_over(tmp_path: Path) -> None:
    def short(time: np.ndarray) -> np.ndarray:
        return np.asarray((time < 0.80 * NS) | (time > 0.88 * NS))

    dataset = write_motions(tmp_path / "data", {"keep": short})
    root = opened(write(dataset, tmp_path / "domain") / "turn.zarr")
    assert len(root["meta/episode_ends"][:]) == 1


def test_the_cameras_own_gap_cuts_too(tmp_path: Path) -> None:
    camera = times(30.0, 2.0)
    dataset = write_motions(tmp_path / "data", {"camera": camera[hole(camera)]})
    root = opened(write(dataset, tmp_path / "domain") / "turn.zarr")
    assert len(root["meta/episode_ends"][:]) == 2


def test_what_the_contract_cannot_hold_is_refused_with_the_reason(tmp_path: Path) -> None:
    given: list[dict[str, Any]] = [
        {},
        {"with_pose": False, "with_width": False},
        {"camera": np.empty(0, np.int64)},
        {"camera": times(30.0, 2.0) + 60 * NS},
    ]
    dataset = write_motions(tmp_path / "data", *given)
    reasons = " / ".join(failure.reason for failure in plan(dataset).refused)
    assert len(plan(dataset).items) == 1
    assert "neither a pose nor a width has a place" in reasons
    assert "no camera has a place" in reasons
    assert "there are not two steps in a row" in reasons


def test_an_episode_that_cannot_be_written_leaves_no_trace(tmp_path: Path) -> None:
    short = {"seconds": 0.5}
    dataset = write_motions(tmp_path / "data", short, {**short, "nan_at": (20,)}, short)
    options = ExportOptions(workers=1, durable=False, keep_going=True)
    report = export(dataset, tmp_path / "domain", to_format="oxt", options=options)
    assert report.written == 2
    assert "sample 20 is not finite, and it is not flagged invalid" in report.failed[0].reason
    root = opened(tmp_path / "domain" / "turn.zarr")
    ends = root["meta/episode_ends"][:].tolist()
    time = root["data/timestamps"][:]
    assert len(ends) == 2
    np.testing.assert_array_equal(time[: ends[0]], time[ends[0] :])
    assert {root[f"data/{key}"].shape[0] for key in root["data"]} == {ends[-1]}


def test_episodes_of_other_tasks_and_streams_get_stores_of_their_own(tmp_path: Path) -> None:
    one: dict[str, Any] = {"pads": {"tactile": "right"}, "with_width": False}
    dataset = write_motions(tmp_path / "data", {}, {"task": "Pour: tea"}, one, {})
    folder = write(dataset, tmp_path / "domain")
    stores = {path.name: opened(path) for path in folder.glob("*.zarr")}
    assert set(stores) == {"turn.zarr", "Pour_tea.zarr", "turn_2.zarr"}
    lengths = sorted(len(root["meta/episode_ends"][:]) for root in stores.values())
    assert lengths == [1, 1, 2]
    alone = next(r for r in stores.values() if "right_hand_joints" not in r["data"])
    assert (
        alone["data/right_tactile_area_gripper"][:].tolist()
        == [[1]] * alone["data/timestamps"].size
    )
    assert any("have no width" in notice for notice in plan(dataset).notices)


def test_grey_pads_get_three_channels(tmp_path: Path) -> None:
    dataset = write_motions(tmp_path / "data", {"channels": 1})
    root = opened(write(dataset, tmp_path / "domain") / "turn.zarr")
    assert root["data/right_tactile_data_gripper"].shape[2:] == (SIZE, SIZE, 3)


def test_the_user_says_where_streams_go(motions: Path, tmp_path: Path) -> None:
    said = "rgb=camera_main_rgb,tactile_left=left_tactile_data_pad:5,tactile_right=-"
    said += ",pose=left_wrist_pose"
    folder = write(motions, tmp_path / "domain", streams=said, side="left")
    data = opened(folder / "turn.zarr")["data"]
    assert {"camera_main_rgb", "left_wrist_pose", "left_hand_joints"} <= set(data)
    assert data["left_tactile_area_pad"][0].tolist() == [5]
    assert not any("right" in key for key in data)
    losses = {(loss.facet, loss.stream, loss.detail) for loss in plan(motions, streams=said).losses}
    assert ("streams", "tactile_right", "-o streams says so") in losses


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("rgb", "names no place"),
        ("rgb=camera_rear_rgb", "names no place"),
        ("pad=right_tactile_data_x:99", "areas from 0 to 23"),
        ("rgb=camera_main_rgb,rgb=-", "named twice"),
    ],
)
def test_places_that_are_none_are_refused(motions: Path, said: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        plan(motions, streams=said)


def test_other_options_that_make_no_sense_are_refused(motions: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="invalid rate"):
        plan(motions, rate="29.97")
    with pytest.raises(UsageError, match="no stream 'gone'"):
        plan(motions, timeline="gone")
    options = ExportOptions()
    with pytest.raises(UsageError, match="a folder of stores is written"):
        plan_export(motions, tmp_path / "x.zarr", to_format="oxt", options=options)


def test_axes_of_umi_are_turned_to_those_of_the_contract(motions: Path, tmp_path: Path) -> None:
    kept = opened(write(motions, tmp_path / "kept") / "turn.zarr")["data/right_wrist_pose"][:]
    turned = opened(write(motions, tmp_path / "umi", axes="umi") / "turn.zarr")
    poses = turned["data/right_wrist_pose"][:]
    np.testing.assert_array_equal(poses[:, :3], kept[:, :3])
    before = Rotation.from_rotvec(kept[:, 3:]).as_matrix()
    after = Rotation.from_rotvec(poses[:, 3:]).as_matrix()
    # x of the contract is y of UMI (down), y of the contract is -x of UMI (left), z is z (forward)
    np.testing.assert_allclose(after[:, :, 0], before[:, :, 1], atol=1e-6)
    np.testing.assert_allclose(after[:, :, 1], -before[:, :, 0], atol=1e-6)
    np.testing.assert_allclose(after[:, :, 2], before[:, :, 2], atol=1e-6)


_ZARR2 = """
import json, sys, zarr
root = zarr.open(sys.argv[1], mode="r")
found = {key: [array.dtype.str, int(array.shape[0]), array[-1].tolist()]
         for key, array in root["data"].arrays()}
print(json.dumps([zarr.__version__, root["meta/episode_ends"][:].tolist(), found]))
"""


@pytest.mark.skipif(
    "EXUMI_ZARR2_PYTHON" not in os.environ, reason="EXUMI_ZARR2_PYTHON names no Python with zarr 2"
)
def test_zarr_2_reads_the_same(motions: Path, tmp_path: Path) -> None:
    path = write(motions, tmp_path / "domain") / "turn.zarr"
    python = os.environ["EXUMI_ZARR2_PYTHON"]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        [python, "-c", _ZARR2, str(path)],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    version, ends, found = json.loads(done.stdout)
    root = opened(path)
    assert version.startswith("2.")
    assert ends == root["meta/episode_ends"][:].tolist()
    assert found == {
        key: [a.dtype.str, a.shape[0], np.asarray(a[-1]).tolist()]
        for key, a in root["data"].arrays()
    }
