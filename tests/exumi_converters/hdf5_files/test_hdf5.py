"""HDF5 of robomimic and FreeTacMan: read lazily, nothing guessed, nothing unpickled."""

import json
import tracemalloc
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from exumi_converters import ConvertOptions, convert
from exumi_converters.registry import find_converter
from exumi_converters.testing import check_converter
from exumi_data.dataset import open_dataset
from exumi_data.episode import Episode
from exumi_data.errors import SourceError, UsageError

QUICK = ConvertOptions(workers=1, durable=False)
COUNT = 12


def turns(count: int = COUNT) -> np.ndarray:
    """Rotations about z, xyzw, with a change of sign on the way."""
    half = np.linspace(0, 0.4, count)
    found = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
    found[count // 2 :] *= -1
    return found


def robomimic(path: Path, demos: int = 3, rate: float | None = 10) -> Path:
    """A file as robomimic's programs write it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        arguments: dict[str, Any] = {} if rate is None else {"control_freq": rate}
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "env_kwargs": arguments})
        for number in range(demos):
            demo = data.create_group(f"demo_{number}")
            demo.attrs["num_samples"] = COUNT
            demo["actions"] = rng.normal(size=(COUNT, 7))
            obs = demo.create_group("obs")
            obs.create_dataset(
                "agentview_image",
                data=rng.integers(0, 255, (COUNT, 8, 10, 3), dtype=np.uint8),
                chunks=(1, 8, 10, 3),
                compression="gzip",
            )
            obs["robot0_eef_pos"] = rng.normal(size=(COUNT, 3))
            obs["robot0_eef_quat"] = turns()
            obs["robot0_gripper_qpos"] = np.tile([0.02, -0.021], (COUNT, 1)) + number / 1000
        file["mask/train"] = np.array([b"demo_0", b"demo_2"])
        file["mask/valid"] = np.array([b"demo_1"])
    return path


def freetacman(path: Path, count: int = COUNT) -> Path:
    """A file as FreeTacMan's process_data.py writes it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(2)
    with h5py.File(path, "w") as file:
        file.attrs["compress"] = False
        file["observations/images/front"] = rng.integers(0, 255, (count, 6, 8, 3), dtype=np.uint8)
        touch = np.full((count, 12, 16, 3), 90, np.uint8)
        touch[count // 2 :, 3:8, 4:9] = 140
        file["observations/images/tactile"] = touch
        file["observations/end_pose"] = np.hstack([np.ones((count, 3)), turns(count)])
        file["observations/qpos"] = np.tile(np.arange(7) / 100, (count, 1))
        file["action"] = np.zeros((count, 7))
    return path


def only(dataset: Path) -> Episode:
    (episode,) = open_dataset(dataset)
    return episode


def codes(episode: Episode) -> dict[str, str]:
    return {note.code: note.message for note in episode.metadata.quality}


def test_the_contract(tmp_path: Path) -> None:
    robomimic(tmp_path / "in" / "low.hdf5")
    check_converter(find_converter("hdf5"), tmp_path / "in", tmp_path / "work")


def test_a_demonstration_of_robomimic(tmp_path: Path) -> None:
    file = robomimic(tmp_path / "in" / "ph.hdf5")
    report = convert(file, tmp_path / "out", options=QUICK)
    assert report.converter == "hdf5/1"
    dataset = open_dataset(tmp_path / "out")
    found = {str(e.metadata.source.key): e for e in dataset}
    assert sorted(found) == [f"ph.hdf5/{n:09d}" for n in range(3)]
    assert dataset.splits["robomimic"].lists == {
        "train": sorted([found["ph.hdf5/000000000"].id, found["ph.hdf5/000000002"].id]),
        "val": [found["ph.hdf5/000000001"].id],
    }
    episode = found["ph.hdf5/000000001"]
    assert episode.metadata.task.name == "Lift"
    with h5py.File(file) as raw:
        obs = raw["data/demo_1/obs"]
        assert np.array_equal(episode["agentview_image"].frames[:], obs["agentview_image"][:])
        pose = episode["pose"].data
        assert np.array_equal(pose[:, :3], obs["robot0_eef_pos"][:])
    assert np.allclose(pose[:, 3:], turns() * np.where(np.arange(COUNT) < 6, 1, -1)[:, None])
    assert np.allclose(episode["width"].data, 0.041)
    assert episode["pose"].time.tolist() == [i * 100_000_000 for i in range(COUNT)]
    assert episode["pose"].metadata.clock.stamp_point == "nominal_rate"
    assert "assumed-rate" not in codes(episode)
    assert codes(episode)["not-converted"] == "keys that were not read: actions"


def test_an_episode_of_freetacman(tmp_path: Path) -> None:
    file = freetacman(tmp_path / "in" / "episode_0.hdf5")
    told = ConvertOptions(workers=1, durable=False, sensor="mctac")
    convert(tmp_path / "in", tmp_path / "out", options=told)
    episode = only(tmp_path / "out")
    touch = episode["tactile"]
    assert touch.kind == "tactile"
    assert touch.metadata.sensor is not None
    assert touch.activity is not None
    assert touch.activity[-1] > 0 == touch.activity[0]
    with h5py.File(file) as raw:
        # It stores what OpenCV read: blue first.
        front = raw["observations/images/front"][:]
    assert np.array_equal(episode["front"].frames[:], front[..., ::-1])
    assert np.allclose(episode["width"].data, 0.06)
    assert len(episode["pose"]) == COUNT
    assert "30/1 a second was assumed" in codes(episode)["assumed-rate"]
    (step,) = episode.metadata.source.lossy or []
    assert step.step == "resample"
    as_is = ConvertOptions(workers=1, durable=False, settings={"channels": "rgb"})
    convert(tmp_path / "in", tmp_path / "rgb", options=as_is)
    assert np.array_equal(only(tmp_path / "rgb")["front"].frames[:], front)


def test_quaternions_that_were_mixed_are_told(tmp_path: Path) -> None:
    path = freetacman(tmp_path / "in" / "e.hdf5")
    with h5py.File(path, "r+") as file:
        file["observations/end_pose"][6, 3:] = [0, 0, 0.2, 0.3]
    convert(tmp_path / "in", tmp_path / "out", options=QUICK)
    assert (
        "1 quaternions of end_pose are far from length 1"
        in codes(only(tmp_path / "out"))["mixed-quaternions"]
    )


def test_counts_that_differ_are_told_and_nothing_is_cut(tmp_path: Path) -> None:
    path = freetacman(tmp_path / "in" / "e.hdf5")
    with h5py.File(path, "r+") as file:
        del file["observations/images/tactile"]
        file["observations/images/tactile"] = np.zeros((COUNT - 3, 12, 16, 3), np.uint8)
    convert(tmp_path / "in", tmp_path / "out", options=QUICK)
    episode = only(tmp_path / "out")
    assert (len(episode["front"]), len(episode["tactile"])) == (COUNT, COUNT - 3)
    assert "images/tactile 9" in codes(episode)["lengths"]


def test_other_orders_of_quaternions_are_told_by_the_user(tmp_path: Path) -> None:
    robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    told = ConvertOptions(workers=1, durable=False, settings={"quaternion": "wxyz"})
    convert(tmp_path / "in", tmp_path / "out", options=told)
    assert np.allclose(np.abs(only(tmp_path / "out")["pose"].data[0, 3:]), [0, 0, 1, 0])


@pytest.mark.parametrize("rate", [None, "fast", 0, 20.5, True])
def test_a_rate_that_is_not_stated_is_assumed_and_said(tmp_path: Path, rate: Any) -> None:
    robomimic(tmp_path / "in" / "a.hdf5", demos=1, rate=rate)
    convert(tmp_path / "in", tmp_path / "out", options=QUICK)
    assert "assumed-rate" in codes(only(tmp_path / "out"))


def test_damaged_foreign_and_empty_files_are_named_and_the_rest_is_done(tmp_path: Path) -> None:
    root = tmp_path / "in"
    whole = robomimic(root / "whole.hdf5", demos=1)
    (root / "cut.hdf5").write_bytes(whole.read_bytes()[:3000])
    (root / "text.hdf5").write_text("hello")
    with h5py.File(root / "other.hdf5", "w") as file:
        file["weights"] = np.zeros(3)
    with h5py.File(root / "empty.hdf5", "w") as file:
        file.create_group("data/demo_0/obs")
    report = convert(root, tmp_path / "out", from_format="hdf5", options=QUICK)
    reasons = {failure.name: failure.reason for failure in report.failed}
    assert report.converted == 1
    assert "damaged or cut short" in reasons["cut.hdf5"]
    assert "no HDF5 file" in reasons["text.hdf5"]
    assert "neither robomimic's" in reasons["other.hdf5"]
    assert "holds no observations" in reasons["empty.hdf5/data/demo_0"]
    assert not any("defect" in reason for reason in reasons.values())


def test_what_is_no_plain_number_is_never_read(tmp_path: Path) -> None:
    outside = robomimic(tmp_path / "outside.hdf5", demos=1)
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    with h5py.File(path, "r+") as file:
        obs = file["data/demo_0/obs"]
        obs["lead_out_image"] = h5py.ExternalLink(str(outside), "/data/demo_0/obs/agentview_image")
        obs["around_image"] = h5py.SoftLink("/data")
        obs["pickled"] = np.void(b"\x80\x04.")
        words = obs.create_dataset("words", (2,), dtype=h5py.string_dtype())
        words[0] = "hello"
    convert(tmp_path / "in", tmp_path / "out", from_format="hdf5", options=QUICK)
    assert sorted(only(tmp_path / "out")) == ["agentview_image", "pose", "width"]


def test_poses_that_are_none_end_this_demonstration_only(tmp_path: Path) -> None:
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=2)
    with h5py.File(path, "r+") as file:
        file["data/demo_0/obs/robot0_eef_quat"][4] = 0
    report = convert(tmp_path / "in", tmp_path / "out", options=QUICK)
    assert report.converted == 1
    assert "robot0_eef_pos: row 4 holds no pose" in report.failed[0].reason


def test_pieces_that_would_fill_the_memory_are_refused(tmp_path: Path) -> None:
    path = robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    with h5py.File(path, "r+") as file:
        # Nothing of it is stored: a few bytes claim 768 MB.
        file["data/demo_0/obs"].create_dataset(
            "big_image", (1, 16_000, 16_000, 3), dtype=np.uint8, chunks=(1, 16_000, 16_000, 3)
        )
    tracemalloc.start()
    report = convert(tmp_path / "in", tmp_path / "out", options=QUICK)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "stored in pieces of 732 MiB" in report.failed[0].reason
    assert peak < 200_000_000


def test_options_and_sources_that_make_no_sense(tmp_path: Path) -> None:
    robomimic(tmp_path / "in" / "a.hdf5", demos=1)
    wrong = ConvertOptions(settings={"channels": "cmyk", "speed": "1"})
    with pytest.raises(UsageError, match=r"Invalid channels \(cmyk\).*no option 'speed'"):
        convert(tmp_path / "in", tmp_path / "out", from_format="hdf5", options=wrong)
    (tmp_path / "none").mkdir()
    with pytest.raises(SourceError, match=r"no \.hdf5 or \.h5 file"):
        convert(tmp_path / "none", tmp_path / "out", from_format="hdf5")
