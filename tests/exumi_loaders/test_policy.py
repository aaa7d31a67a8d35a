"""Policy windows against what can be worked out by hand."""

import copy
import json
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import exumi_data
from exumi_data.errors import MetadataError, UsageError
from exumi_data.geometry import compose, relative, rotation_6d
from exumi_loaders import ActiveWindowSampler, ConcatWindows, PolicySpec, PolicyWindows
from tests.exumi_loaders.conftest import smooth_poses, width_m

TICK = 1 / 20


def seconds(rate: float, duration: float = 4.0, start: float = 0.0) -> np.ndarray:
    return start + np.arange(round(rate * duration)) / rate


def full(recipe: Any, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "tactile_s": seconds(30),
        "rgb_s": seconds(30),
        "pose_s": seconds(100),
        "width_s": seconds(200),
        "activity": np.zeros(120),
    }
    return recipe(**{**values, **changes})


def open_windows(dataset: exumi_data.Dataset, **options: Any) -> PolicyWindows:
    return PolicyWindows(dataset, **{"tick_s": Fraction(1, 20), "cache": False, **options})


def test_shapes_and_defaults(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe, channels=3)))
    batch = windows.__getitems__([3, 20])
    assert {name: tuple(value.shape[1:]) for name, value in batch.items()} == {
        "tactile": (2, 3, 8, 8),
        "tactile_valid": (2,),
        "tactile_reference": (3, 8, 8),
        "rgb": (2, 3, 8, 8),
        "rgb_valid": (2,),
        "proprioception": (2, 10),
        "proprioception_valid": (2,),
        "observation_padding": (2,),
        "action": (16, 10),
        "action_valid": (16,),
        "action_padding": (16,),
        "valid": (),
        "episode": (),
        "time_ns": (),
    }
    assert batch["rgb"].dtype == torch.uint8
    assert batch["valid"].all()
    assert set(windows.observation(batch)) == set(windows.policy_spec.observation)


@pytest.mark.parametrize("late", [0.0, 0.1])
def test_frames_and_poses_are_those_at_hand(make_dataset: Any, recipe: Any, late: float) -> None:
    """At a tick, the newest that is at least `late` old, and never a later one."""
    windows = open_windows(
        make_dataset(full(recipe)), latency_s={"rgb": late, "pose": late}, observation_stride=3
    )
    first = late  # when rgb and pose are at hand
    for index in (3, 10, 30):
        item = windows[index]
        now = first + index * TICK
        steps = now + np.array([-3, 0]) * TICK
        newest = np.floor((steps - late) * 30 + 1e-6)
        np.testing.assert_array_equal(item["rgb"][:, 0, 0, 0].numpy(), newest)
        np.testing.assert_array_equal(
            item["tactile"][:, 0, 0, 0].numpy(), np.floor(steps * 30 + 1e-6)
        )
        held = np.floor((steps - late) * 100 + 1e-6) / 100
        poses = smooth_poses(held)
        expected = relative(poses[-1:], poses)
        np.testing.assert_allclose(item["proprioception"][:, :3], expected[:, :3], atol=1e-6)
        np.testing.assert_allclose(
            item["proprioception"][:, 3:9], rotation_6d(expected[:, 3:]), atol=1e-6
        )
        at = np.floor(steps * 200 + 1e-6) / 200
        np.testing.assert_allclose(item["proprioception"][:, 9], width_m(at), atol=1e-7)
        assert int(item["time_ns"]) == round(now * 1e9)


def test_actions_are_true_and_relative_to_what_is_known(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(
        make_dataset(full(recipe)), latency_s={"pose": 0.05}, action_steps=4, action_stride=2
    )
    item = windows[20]
    now = 0.05 + 20 * TICK
    then = now + np.array([2, 4, 6, 8]) * TICK
    base = smooth_poses([now - 0.05])
    absolute = np.concatenate(
        (item["action"][:, :3], rotation_back(item["action"][:, 3:9].numpy())), axis=1
    )
    found = compose(base, absolute)
    expected = smooth_poses(then)
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=1e-4)
    turn = Rotation.from_quat(found[:, 3:]) * Rotation.from_quat(expected[:, 3:]).inv()
    assert turn.magnitude().max() < 1e-4
    np.testing.assert_allclose(item["action"][:, 9], width_m(then), atol=1e-6)


def rotation_back(six: np.ndarray) -> np.ndarray:
    from exumi_data.geometry import rotation_from_6d

    return rotation_from_6d(six)


def test_absolute_actions_and_the_first_one(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(
        make_dataset(full(recipe)), action="absolute", first_action=0, action_steps=3
    )
    item = windows[10]
    at = (10 + np.arange(3)) * TICK
    np.testing.assert_allclose(item["action"][:, :3], smooth_poses(at)[:, :3], atol=1e-5)
    np.testing.assert_allclose(item["proprioception"][1], item["action"][0], atol=1e-6)


def test_padding_and_validity_at_the_edges(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe)), observation_steps=3, action_steps=4)
    first, last = windows[0], windows[len(windows) - 1]
    assert first["observation_padding"].tolist() == [True, True, False]
    assert first["valid"]  # an observation repeats the first tick, as it will at run time
    assert (first["tactile"] == first["tactile"][2]).all()
    assert last["action_padding"].all()
    assert not last["action_valid"].any()
    assert (last["action"] == last["action"][0]).all()
    assert not last["valid"]
    dropped = open_windows(
        make_dataset(full(recipe), name="b"), observation_steps=3, action_steps=4, edges="drop"
    )
    assert len(dropped) == len(windows) - 6
    batch = dropped.__getitems__(range(len(dropped)))
    assert not batch["observation_padding"].any()
    assert not batch["action_padding"].any()


def test_stale_streams_are_black_or_held(make_dataset: Any, recipe: Any) -> None:
    time = seconds(30)
    keep = (time <= 1.0) | (time >= 2.0)
    poses = seconds(100)
    pose_keep = (poses <= 1.0) | (poses >= 2.0)
    windows = open_windows(
        make_dataset(full(recipe, rgb_s=time[keep], pose_s=poses[pose_keep])),
        stale_s={"rgb": 0.2, "pose": 0.3},
        observation_steps=1,
    )
    batch = windows.__getitems__(range(len(windows)))
    at = np.arange(len(windows)) * TICK
    gap = (at > 1.0) & (at < 2.0 - 1e-9)
    rgb = batch["rgb_valid"][:, 0].numpy()
    np.testing.assert_array_equal(rgb, ~(gap & (at > 1.2 + 1e-9)))
    assert (batch["rgb"][~batch["rgb_valid"][:, 0]] == 0).all()
    pose = batch["proprioception_valid"][:, 0].numpy()
    np.testing.assert_array_equal(pose, ~(gap & (at > 1.3 + 1e-9)))
    # What is done cannot be said relative to a pose that is not known.
    assert not batch["action_valid"].numpy()[~pose].any()
    assert not batch["valid"].numpy()[~(rgb & pose)].any()


def test_two_grippers(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe, grippers={"left": 0.0, "right": 0.25}))
    windows = open_windows(dataset)
    item = windows[12]
    assert item["action"].shape == (16, 20)
    assert windows.action_columns[0] == "pose_left.x"
    # Both have the same motion: relative to its own pose neither knows of the distance.
    np.testing.assert_allclose(item["action"][:, 3:9], item["action"][:, 13:19], atol=1e-6)
    now = smooth_poses([12 * TICK])
    moved = now + np.array([0.25, 0, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(item["between"][1, :3], relative(now, moved)[0, :3], atol=1e-6)
    assert item["between_valid"].all()


def test_loader_sampler_and_low_dimensional_agree(make_dataset: Any, recipe: Any) -> None:
    activity = np.zeros(120)
    activity[60:63] = 0.01
    windows = open_windows(make_dataset(full(recipe, activity=activity)))
    assert 0 < windows.active.mean() < 1
    sampler = ActiveWindowSampler(windows, count=16, seed=1)
    for batch in windows.loader(8, sampler=sampler):
        assert batch["action"].shape == (8, 16, 10)
    everything = windows.__getitems__(range(len(windows)))
    for name, values in windows.low_dimensional(np.arange(len(windows))).items():
        np.testing.assert_array_equal(values, everything[name].numpy())


@pytest.mark.parametrize("second", [{"child": "flange"}, {"calibration": {"tcp": [0, 0, 0.2]}}])
def test_other_tool_frames_are_refused(make_dataset: Any, recipe: Any, second: Any) -> None:
    dataset = make_dataset(full(recipe, calibration={"tcp": [0, 0, 0.1]}), full(recipe, **second))
    with pytest.raises(UsageError) as caught:
        open_windows(dataset)
    assert all(episode_id in str(caught.value) for episode_id in dataset.ids)


def test_the_same_tool_measured_twice_is_for_the_user_to_say(
    make_dataset: Any, recipe: Any
) -> None:
    dataset = make_dataset(
        full(recipe, calibration={"tcp": 1, "intrinsics/rgb": 1}),
        full(recipe, calibration={"tcp": 2, "intrinsics/rgb": 2}),
    )
    windows = open_windows(dataset, same_calibration=False)
    assert len(windows.policy_spec.streams["pose"].calibrations) == 2
    assert len(windows.policy_spec.streams["rgb"].calibrations) == 2
    with pytest.raises(UsageError, match="same_calibration=False"):
        open_windows(dataset)


def test_absolute_actions_need_one_parent_frame(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe), full(recipe, parents={"pose": "table"}))
    open_windows(dataset)
    with pytest.raises(UsageError, match="parent frame of pose is 'world'") as caught:
        open_windows(dataset, action="absolute")
    assert all(episode_id in str(caught.value) for episode_id in dataset.ids)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"latency_s": {"camera": 0.1}}, "names 'camera'"),
        ({"latency_s": {"rgb": 120.0}}, "not in"),
        ({"stale_s": float("nan")}, "not in"),
        ({"observation_steps": 0}, "at least 1"),
        ({"action_stride": 0}, "at least 1"),
        ({"first_action": -1}, "before step 0"),
        ({"action": "delta"}, "Supported values"),
        ({"pose": (), "width": ()}, "no pose and no width"),
    ],
)
def test_wrong_options(make_dataset: Any, recipe: Any, options: Any, message: str) -> None:
    dataset = make_dataset(full(recipe))
    with pytest.raises(UsageError, match=message):
        open_windows(dataset, **options)


def test_concatenation(make_dataset: Any, recipe: Any) -> None:
    one = open_windows(make_dataset(full(recipe)))
    two = open_windows(make_dataset(full(recipe, shift=100), name="two"))
    both = ConcatWindows([one, two], weights=[1, 3])
    batch = both.__getitems__([5, len(one) + 5])
    assert batch["part"].tolist() == [0, 1]
    torch.testing.assert_close(batch["rgb"][1], batch["rgb"][0] + 100)
    late = open_windows(two.episodes, latency_s={"rgb": 0.1})
    with pytest.raises(UsageError, match="latency_ns"):
        ConcatWindows([one, late])
    other = make_dataset(full(recipe, child="flange"), name="three")
    with pytest.raises(UsageError, match="child frames"):
        ConcatWindows([one, open_windows(other)])
    calibrated = make_dataset(full(recipe, calibration={"tcp": 1}), name="four")
    with pytest.raises(UsageError, match="calibration"):
        ConcatWindows([one, open_windows(calibrated)])


def test_the_spec_is_a_document(make_dataset: Any, recipe: Any, tmp_path: Any) -> None:
    windows = open_windows(make_dataset(full(recipe)), latency_s={"rgb": 0.1})
    windows.policy_spec.save(tmp_path / "spec.json")
    assert PolicySpec.load(tmp_path / "spec.json") == windows.policy_spec
    with pytest.raises(Exception, match="frozen"):
        windows.policy_spec.action = "absolute"  # type: ignore[misc]  # that is the point
    with pytest.raises(UsageError, match="no part of"):
        windows.policy_spec.save(tmp_path / "set" / "runs" / "spec.json")


@pytest.mark.parametrize(
    "change",
    [
        {"observation_steps": [0, -1]},
        {"observation_steps": [-2, -1]},
        {"action_steps": []},
        {"rgb": []},
        {"tick_s": "0.05"},
        {"action": "delta"},
        {"version": "1.0", "unknown": 1},
    ],
)
def test_other_documents_are_refused(
    make_dataset: Any, recipe: Any, tmp_path: Any, change: dict[str, Any]
) -> None:
    file = tmp_path / "spec.json"
    open_windows(make_dataset(full(recipe))).policy_spec.save(file)
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(MetadataError):
        PolicySpec.load(file)


def test_windows_go_to_workers(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe)))
    windows[0]
    sent = copy.deepcopy(windows)  # by the same means as to a worker
    for name, value in windows[9].items():
        assert torch.equal(sent[9][name], value)


def test_a_cached_timeline_gives_the_same(make_dataset: Any, recipe: Any, tmp_path: Any) -> None:
    dataset = make_dataset(full(recipe, calibration={"tcp": 1}))
    options = {"latency_s": {"rgb": 0.1}, "cache": tmp_path / "cache"}
    computed, cached = open_windows(dataset, **options), open_windows(dataset, **options)
    assert isinstance(cached.timeline.seen_low["pose"], np.memmap)
    assert computed.policy_spec == cached.policy_spec
    for name, value in computed[7].items():
        assert torch.equal(value, cached[7][name])
    other = open_windows(dataset, cache=tmp_path / "cache", latency_s={"rgb": 0.2})
    assert other.policy_spec != cached.policy_spec
    assert other[7]["time_ns"] == cached[7]["time_ns"] + 100_000_000
