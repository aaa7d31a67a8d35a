"""HDF5 files that mislead: links out, things that claim to be huge, names that are none."""

import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from exumi_converters import ConvertOptions, convert, plan_conversion
from exumi_data.dataset import open_dataset
from exumi_data.errors import UsageError
from tests.exumi_converters.hdf5_files.test_hdf5 import (
    COUNT,
    QUICK,
    codes,
    freetacman,
    only,
    robomimic,
    turns,
)

OUTSIDE = "/outside.hdf5"


def demo(number: int) -> str:
    return f"data/demo_{number}"


def link_demo(file: h5py.File, outside: str) -> None:
    file["data/demo_7"] = h5py.ExternalLink(outside, "/data/demo_0")


def link_observations(file: h5py.File, outside: str) -> None:
    del file["data/demo_1/obs"]
    file["data/demo_1/obs"] = h5py.ExternalLink(outside, "/data/demo_0/obs")


def dangling_demo(file: h5py.File, _: str) -> None:
    file["data/demo_7"] = h5py.SoftLink("/nowhere")


def demo_of_numbers(file: h5py.File, _: str) -> None:
    file["data/demo_7"] = np.zeros(3)


def observations_of_numbers(file: h5py.File, _: str) -> None:
    del file["data/demo_1/obs"]
    file["data/demo_1/obs"] = np.zeros(3)


def a_number_twice(file: h5py.File, _: str) -> None:
    file.copy("data/demo_1", "data/demo_01")


@pytest.mark.parametrize(
    ("spoil", "whole", "failed"),
    [
        (link_demo, 2, "demo_7 is no group of this file"),
        (link_observations, 1, "holds no observations"),
        (dangling_demo, 2, "demo_7 is no group of this file"),
        (demo_of_numbers, 2, "demo_7 is no group of this file"),
        (observations_of_numbers, 1, "holds no observations"),
        (a_number_twice, 2, "two demonstrations 1"),
    ],
)
def test_one_bad_demonstration_is_named_and_the_others_are_listed(
    tmp_path: Path, spoil: Callable[[h5py.File, str], None], whole: int, failed: str
) -> None:
    outside = robomimic(tmp_path / "outside.hdf5", demos=1)
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=2)
    with h5py.File(path, "r+") as file:
        spoil(file, str(outside))
    plan = plan_conversion(tmp_path / "in", from_format="hdf5")
    assert len(plan.episodes) == whole
    (failure,) = plan.failed
    assert failed in failure.reason
    assert failure.name.startswith("a.hdf5/data/demo_")


def test_files_whose_groups_lead_out_have_no_layout(tmp_path: Path) -> None:
    mimic = robomimic(tmp_path / "mimic.hdf5", demos=1)
    man = freetacman(tmp_path / "man.hdf5")
    (tmp_path / "in").mkdir()
    for name, group, outside in (("a", "data", mimic), ("b", "observations", man)):
        with h5py.File(tmp_path / "in" / f"{name}.hdf5", "w") as file:
            file[group] = h5py.ExternalLink(str(outside), f"/{group}")
    report = convert(tmp_path / "in", tmp_path / "out", from_format="hdf5", options=QUICK)
    assert (report.converted, len(report.failed)) == (0, 2)
    assert all("has neither" in failure.reason for failure in report.failed)


def test_groups_in_themselves_and_data_of_other_files_are_left_and_named(tmp_path: Path) -> None:
    outside = robomimic(tmp_path / "outside.hdf5", demos=1)
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    with h5py.File(path, "r+") as file:
        obs = file["data/demo_0/obs"]
        layout = h5py.VirtualLayout((COUNT, 8, 10, 3), np.uint8)
        layout[:] = h5py.VirtualSource(
            str(outside), "data/demo_0/obs/agentview_image", (COUNT, 8, 10, 3)
        )
        obs.create_virtual_dataset("elsewhere_image", layout)
        obs["again"] = obs
        at = obs
        for level in range(30):  # 2^30 ways lead to the last one
            below = file.create_group(f"level_{level}")
            at["one"] = at["other"] = below
            at = below
        at = obs
        for _ in range(2000):
            at = at.create_group("deeper")
    convert(path, tmp_path / "out", options=QUICK)
    episode = only(tmp_path / "out")
    assert sorted(episode) == ["agentview_image", "pose", "width"]
    said = codes(episode)["not-converted"]
    assert "obs/elsewhere_image" in said
    assert "obs/again" in said


def test_what_was_announced_and_never_written_is_not_made_up(tmp_path: Path) -> None:
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=3)
    with h5py.File(path, "r+") as file:
        file[f"{demo(0)}/obs"].create_dataset(
            "black_image", (10**7, 8, 10, 3), chunks=(1, 8, 10, 3), dtype=np.uint8
        )
        obs = file[f"{demo(1)}/obs"]
        del obs["robot0_eef_pos"]
        obs.create_dataset("robot0_eef_pos", (10**11, 3), chunks=(1000, 3), dtype=np.float64)
    tracemalloc.start()
    report = convert(path, tmp_path / "out", options=QUICK)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert report.converted == 1
    first, second = (failure.reason for failure in report.failed)
    assert "10,000,000 of the 10,000,000 pieces" in first
    assert "has 100,000,000,000 samples" in second
    assert peak < 200_000_000


@pytest.mark.parametrize(
    "mask",
    [
        pytest.param(5, id="one number"),
        pytest.param(np.zeros(3), id="numbers"),
        pytest.param(np.array([b"x" * 300]), id="long words"),
    ],
)
def test_masks_that_are_none_are_told(tmp_path: Path, mask: Any) -> None:
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    with h5py.File(path, "r+") as file:
        del file["mask/train"]
        file["mask/train"] = mask
    plan = plan_conversion(path)
    assert plan.notices[-1] == "a.hdf5: mask/train is no list of names, not read"
    with h5py.File(path, "r+") as file:
        del file["mask/train"]
        file["mask"].create_dataset("train", (10**10,), "S8", chunks=(1000,))
    assert "mask/train is not read" in plan_conversion(path).notices[-1]


@pytest.mark.parametrize(
    ("said", "task"),
    [
        ("[" * 50_000, "touch"),
        (json.dumps({"env_name": ""}), "touch"),
        (json.dumps({"env_name": "a\x00b \ud800"}), "a b ?"),
        (json.dumps({"env_name": "x" * 5000}), "x" * 200),
    ],
)
def test_what_env_args_may_say(tmp_path: Path, said: str, task: str) -> None:
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    with h5py.File(path, "r+") as file:
        file["data"].attrs["env_args"] = said
    convert(path, tmp_path / "out", options=QUICK)
    assert only(tmp_path / "out").metadata.task.name == task


def test_names_that_are_alike_long_or_none(tmp_path: Path) -> None:
    path = freetacman(tmp_path / "in" / "a.hdf5")
    names = ("Front", "b/front", "pose", "n" * 300, "éä x", "\x1b[31m", "9")
    with h5py.File(path, "r+") as file:
        images = file["observations/images"]
        for name in names:
            images[name] = images["front"][:]
    convert(path, tmp_path / "out", options=QUICK)
    episode = only(tmp_path / "out")
    assert len(episode.of_kind("rgb")) == 1 + len(names)
    assert episode["pose"].kind == "pose"
    assert {"front", "front_2", "front_3", "pose_2", "stream_9"} <= set(episode)


def test_qpos_is_what_its_numbers_say(tmp_path: Path) -> None:
    poses = np.hstack([np.ones((COUNT, 3)), turns()])
    for name, numbers in (("poses", poses), ("two-arms", np.zeros((COUNT, 14)))):
        path = freetacman(tmp_path / name / "a.hdf5")
        with h5py.File(path, "r+") as file:
            del file["observations/end_pose"], file["observations/qpos"]
            file["observations/qpos"] = numbers
        convert(path, tmp_path / f"out-{name}", options=QUICK)
    # With qpos_mode "pose" the last number is of a quaternion; of two arms nothing is known.
    assert sorted(only(tmp_path / "out-poses")) == ["front", "pose", "tactile"]
    assert sorted(only(tmp_path / "out-two-arms")) == ["front", "tactile"]


def test_pictures_that_are_compressed_are_warned_of(tmp_path: Path) -> None:
    path = freetacman(tmp_path / "in" / "a.hdf5")
    with h5py.File(path, "r+") as file:
        del file["observations/images/front"]
        file["observations/images/front"] = np.zeros((COUNT, 500), np.uint8)
    report = convert(path, tmp_path / "out", options=QUICK)
    (flag,) = [flag for flag in report.flagged if flag.code == "pictures-not-read"]
    assert flag.severity == "warning"
    assert "observations/images/front" in flag.message


def test_keys_of_tactile_images_must_be_there(tmp_path: Path) -> None:
    path = freetacman(tmp_path / "in" / "a.hdf5")
    wrong = ConvertOptions(settings={"tactile": "finger"})
    with pytest.raises(UsageError, match=r"no images are called 'finger'.*images/front"):
        convert(path, tmp_path / "out", options=wrong)
    for key in ("front", "images/front"):
        told = ConvertOptions(workers=1, durable=False, settings={"tactile": key})
        convert(path, tmp_path / key.replace("/", "-"), options=told)
        episode = only(tmp_path / key.replace("/", "-"))
        assert [stream.name for stream in episode.of_kind("tactile")] == ["front"]


def test_a_full_disk_is_not_taken_for_a_damaged_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from exumi_data.store.stream_writer import DataStreamWriter

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    monkeypatch.setattr(DataStreamWriter, "append", full)
    report = convert(tmp_path / "in", tmp_path / "out", from_format="hdf5", options=QUICK)
    assert report.failed[0].reason == "No space left on device"


def test_a_damaged_file_does_not_hide_the_others(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.hdf5").write_bytes(b"cut")
    robomimic(tmp_path / "in" / "b.hdf5", demos=2)
    plan = plan_conversion(tmp_path / "in")
    assert len(plan.episodes) == 2
    # Of each demonstration what is stored of it, not the whole file again.
    assert plan.estimated_bytes < (tmp_path / "in" / "b.hdf5").stat().st_size
    report = convert(tmp_path / "in", tmp_path / "out", options=QUICK)
    assert len(open_dataset(tmp_path / "out")) == report.converted == 2
