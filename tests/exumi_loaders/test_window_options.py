"""Spans, masks, dropout and proprioception of windows, against what can be worked out by hand."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

import exumi_data
from exumi_data.errors import MetadataError, UsageError
from exumi_data.geometry import rotation_from_6d
from exumi_data.store import jpeg
from exumi_loaders import TPPWindows
from exumi_loaders.draws import normal
from exumi_loaders.masks import MASKS, MODALITIES
from exumi_loaders.steps import WindowSteps


def seconds(rate: float, duration: float = 6.0) -> np.ndarray:
    return np.arange(round(rate * duration)) / rate


def full(recipe: Any, duration: float = 6.0, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "tactile_s": seconds(30, duration),
        "rgb_s": seconds(30, duration),
        "pose_s": seconds(90, duration),
        "width_s": seconds(200, duration),
        "activity": np.zeros(round(30 * duration)),
    }
    return recipe(**{**values, **changes})


def open_windows(dataset: exumi_data.Dataset, **options: Any) -> TPPWindows:
    return TPPWindows(dataset, **{"tick_s": Fraction(1, 20), "cache": False, **options})


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor], keys: Any) -> bool:
    return all(torch.equal(one[key], other[key]) for key in keys)


def test_a_split_without_episodes_is_named(make_dataset: Any, recipe: Any) -> None:
    with pytest.raises(UsageError, match="the split 'val' holds no episodes"):
        open_windows(make_dataset(full(recipe)), split="val")


# Spans and counts.


def test_the_defaults_are_the_papers() -> None:
    steps = WindowSteps()
    assert steps.all.tolist() == list(range(-15, 17))
    assert steps.fixed_history.tolist() == [-12, -8, -4, 0]
    assert steps.tactile_future.tolist() == [4, 8, 12, 16]
    assert steps.past.tolist() == list(range(-15, 1))
    assert steps.all[steps.zero] == 0


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.integers(1, 20),
    st.integers(0, 20),
    st.data(),
    st.sampled_from(["pad", "drop"]),
    st.integers(1, 5),
)
def test_shapes_and_padding_follow_from_the_span(
    opened: exumi_data.Dataset, history: int, future: int, data: Any, edges: str, stride: int
) -> None:
    frames = (data.draw(st.integers(1, history)), data.draw(st.integers(0, future)))
    windows = open_windows(
        opened,
        history=history,
        future=future,
        history_frames=frames[0],
        future_frames=frames[1],
        rgb_steps=[1 - history, 0],
        edges=edges,
        stride=stride,
    )
    index = data.draw(st.integers(0, len(windows) - 1))
    item = windows[index]
    assert item["tactile"].shape == (sum(frames), 1, 8, 8)
    assert item["rgb"].shape == (2, 1, 8, 8)
    assert item["action"].shape == (history + future, 10)
    assert set(windows.spec) == set(item)
    steps = item["tactile_steps"]
    assert (steps.diff() > 0).all()
    assert (steps[: frames[0]] <= 0).all()
    assert (steps[frames[0] :] > 0).all()
    tick = round(int(item["time_ns"]) / 50_000_000)
    at = tick + np.arange(1 - history, future + 1)
    np.testing.assert_array_equal(item["padding"], (at < 0) | (at >= 120))
    np.testing.assert_array_equal(item["action_valid"], ~item["padding"])
    if edges == "drop":
        assert not item["padding"].any()
        assert len(windows) == -(-(121 - history - future) // stride)
    expected = np.clip(tick + steps.numpy(), 0, 119) * 1.5
    np.testing.assert_allclose(item["tactile"][:, 0, 0, 0], expected, atol=0.5)


@pytest.fixture
def opened(make_dataset: Any, recipe: Any) -> exumi_data.Dataset:
    dataset: exumi_data.Dataset = make_dataset(full(recipe))
    return dataset


def test_activity_follows_the_span(make_dataset: Any, recipe: Any) -> None:
    activity = np.zeros(180)
    activity[90] = 0.01  # at 3 s: tick 60
    dataset = make_dataset(full(recipe, activity=activity))
    narrow = open_windows(dataset, history=3, future=4, history_frames=1, future_frames=2)
    np.testing.assert_array_equal(np.flatnonzero(narrow.active), np.arange(56, 63))
    ahead = open_windows(
        dataset, history=3, future=4, history_frames=1, future_frames=2, activity="future"
    )
    np.testing.assert_array_equal(np.flatnonzero(ahead.active), [56, 58])
    assert open_windows(dataset).active.sum() == 32


def test_thresholds_are_those_stored_with_the_activity(make_dataset: Any, recipe: Any) -> None:
    """Both fingers in one image are active at half the share of pixels that one finger is."""
    activity = np.full(180, 7e-4)
    for above, active in ((None, False), (5e-4, True), (8e-4, False)):
        combined = full(recipe, tactile="tactile_combined", activity=activity, active_above=above)
        windows = open_windows(make_dataset(combined, name=str(above)))
        assert windows[3]["tactile_combined"].shape == (8, 1, 8, 8)
        assert windows.active.all() == windows.active.any() == active
        assert open_windows(windows.episodes, active_above=6e-4).active.all()


def test_another_stored_threshold_is_noticed(make_dataset: Any, recipe: Any, tmp_path: Any) -> None:
    activity = np.full(180, 7e-4)
    for above, active in ((1e-3, False), (5e-4, True)):
        dataset = make_dataset(full(recipe, activity=activity, active_above=above))
        assert open_windows(dataset, cache=tmp_path / "cache").active.all() == active


def test_a_threshold_that_is_no_number_is_refused(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe, active_above=0.001))
    document = Path(dataset.episode_location(0), "derived/zarr.json")
    document.write_text(document.read_text().replace("0.001", '"much"'))
    with pytest.raises(MetadataError, match="'much', not a number"):
        open_windows(dataset)


def test_spans_that_make_no_sense_are_refused(opened: exumi_data.Dataset) -> None:
    for options, words in (
        ({"history": 0}, "0 steps of history"),
        ({"history_frames": 17}, "17 tactile frames"),
        ({"future_frames": 17}, "17 tactile frames"),
        ({"rgb_steps": [17]}, "rgb_steps"),
        ({"rgb_steps": []}, "rgb_steps"),
        ({"activity": "future", "future_frames": 0}, "future_frames"),
        ({"stride": 0}, "stride"),
        ({"start_noise_m": -1}, "start_noise_m"),
        ({"on_corrupt": "ignore"}, "'raise', 'skip', 'substitute'"),
    ):
        with pytest.raises(UsageError, match=words):
            open_windows(opened, **options)


def test_several_cameras(make_dataset: Any, recipe: Any) -> None:
    extra = {"rgb_front": seconds(15), "rgb_wrist": seconds(60, 3.0)}
    windows = open_windows(make_dataset(full(recipe, extra_rgb=extra)), rgb_steps=(-10, 0))
    assert windows.layout.rgb == ("rgb", "rgb_front", "rgb_wrist")
    item = windows[40]
    assert item["rgb"][:, 0, 0, 0].tolist() == [45, 60]
    assert item["rgb_front"][:, 0, 0, 0].tolist() == [22, 30]
    assert item["rgb_wrist"][:, 0, 0, 0].tolist() == [90, 120]
    masked = open_windows(windows.episodes, mask="rgb")[40]
    for name in windows.layout.rgb:
        assert not masked[name].any()
        assert not masked[f"{name}_valid"].any()


# Masks and dropout.


def test_masks_take_away_what_they_say_and_nothing_else(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    options = {"proprioception": True}
    shown = open_windows(dataset, **options).__getitems__([0, 40, 70])
    for mask, hidden in MASKS.items():
        windows = open_windows(dataset, mask=mask, **options)
        batch = windows.__getitems__([0, 40, 70])
        assert batch.keys() == shown.keys()
        for modality in MODALITIES:
            assert batch[f"{modality}_masked"].tolist() == [modality in hidden] * 3
        for modality in ("rgb", "action", "proprioception"):
            keys = (modality, f"{modality}_valid")
            if modality in hidden:
                assert not any(batch[key].any() for key in keys)
            else:
                assert same(batch, shown, keys)
        past, future = (slice(None), slice(0, 4)), (slice(None), slice(4, 8))
        for key in ("tactile", "tactile_valid"):
            if "tactile_history" in hidden:
                assert not batch[key][past].any()
            else:
                assert torch.equal(batch[key][past], shown[key][past])
            assert torch.equal(batch[key][future], shown[key][future])
        others = ("tactile_steps", "tactile_reference", "padding", "episode", "time_ns", "valid")
        assert same(batch, shown, others)
    assert shown["valid"].tolist() == [False, True, True]


@pytest.mark.parametrize("how", [{"mask": "rgb"}, {"dropout": {"rgb": 1.0}}])
def test_masked_images_are_never_decoded(
    make_dataset: Any, recipe: Any, monkeypatch: pytest.MonkeyPatch, how: Any
) -> None:
    dataset = make_dataset(full(recipe, encoded=True, channels=3))
    decoded = []
    decode = jpeg.decode_into

    def counting(data: bytes, out: np.ndarray) -> None:
        decoded.append(out.shape)
        decode(data, out)

    monkeypatch.setattr(jpeg, "decode_into", counting)
    windows = open_windows(dataset, random_history=False, **how)
    windows.__getitems__([40, 50])
    assert len(decoded) == 2 * 8
    decoded.clear()
    open_windows(dataset, random_history=False, mask="tactile_history")[40]
    assert len(decoded) == 4 + 1


def test_dropout_is_drawn_by_window(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    dropout = {"rgb": 0.3, "action": 0.6, "tactile_history": 0.5}
    windows = open_windows(dataset, dropout=dropout, seed=4)
    shown = open_windows(dataset, seed=4)
    masked: dict[str, list[bool]] = {name: [] for name in dropout}
    for epoch in range(12):
        windows.set_epoch(epoch)
        shown.set_epoch(epoch)
        batch = windows.__getitems__(range(len(windows)))
        whole = shown.__getitems__(range(len(windows)))
        for name in dropout:
            masked[name] += batch[f"{name}_masked"].tolist()
        kept = ~batch["rgb_masked"]
        assert torch.equal(batch["rgb"][kept], whole["rgb"][kept])
        assert not batch["rgb"][~kept].any()
        assert not batch["action"][batch["action_masked"]].any()
        assert torch.equal(batch["valid"], whole["valid"])
    for name, share in dropout.items():
        drawn = np.array(masked[name])
        assert stats.binomtest(int(drawn.sum()), len(drawn), share).pvalue > 1e-4
    both = 2 * np.array(masked["rgb"], dtype=int) + np.array(masked["action"], dtype=int)
    counts = np.bincount(both, minlength=4).reshape(2, 2)
    assert stats.chi2_contingency(counts).pvalue > 1e-4  # independent of one another
    windows.set_epoch(0)
    alone = [bool(windows[i]["rgb_masked"]) for i in range(30)]
    assert alone == masked["rgb"][:30]
    assert alone != masked["rgb"][len(windows) : len(windows) + 30]  # another epoch


def test_dropout_is_the_same_in_workers(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    options: Any = {"dropout": {"rgb": 0.5}, "proprioception": True}
    alone, others = (
        list(open_windows(dataset, **options).loader(30, num_workers=n)) for n in (0, 2)
    )
    for one, other in zip(alone, others, strict=True):
        assert same(one, other, one)


def test_what_is_not_there_cannot_be_masked(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe, rgb_s=None))
    for options, words in (
        ({"mask": "action+rgb"}, "leaves out rgb"),
        ({"mask": "touch"}, "'action\\+rgb'"),
        ({"dropout": {"rgb": 0.1}}, "leaves out rgb"),
        ({"dropout": {"proprioception": 0.1}}, "leaves out proprioception"),
        ({"dropout": {"depth": 0.1}}, "no modality"),
        ({"dropout": {"action": 1.1}}, r"not in \[0, 1\]"),
    ):
        with pytest.raises(UsageError, match=words):
            open_windows(dataset, **options)
    touch = make_dataset(recipe(tactile_s=seconds(30)), name="touch")
    with pytest.raises(UsageError, match="pose stream"):
        open_windows(touch, proprioception=True)


# Proprioception.


def test_proprioception_is_relative_to_the_start(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(
        make_dataset(full(recipe)), proprioception=True, start_noise_m=0, start_noise_rad=0
    )
    item = windows[50]
    assert item["proprioception"].shape == (16, 10)
    time = (50 + np.arange(-15, 1)) / 20
    position = np.stack((0.1 * time, 0.2 * np.sin(time), 0.05 * time), axis=1)
    turn = Rotation.from_rotvec(np.stack((0.3 * time, 0 * time, 0.1 * time), axis=1))
    np.testing.assert_allclose(item["proprioception"][:, :3], position, atol=2e-5)
    rows = turn.as_matrix()[:, :2].reshape(16, 6)
    np.testing.assert_allclose(item["proprioception"][:, 3:9], rows, atol=2e-5)
    np.testing.assert_allclose(item["proprioception"][:, 9], 0.05 + 0.01 * time, atol=1e-6)
    assert item["proprioception_valid"].all()
    np.testing.assert_array_equal(windows[0]["proprioception_valid"], np.arange(16) == 15)


def test_noise_of_the_start_has_the_stated_spread(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe, grippers={"left": 0.0, "right": 0.3}))
    options: Any = {"proprioception": True, "tactile": [], "mask": "rgb"}  # nothing to decode
    noisy = open_windows(dataset, seed=9, **options)
    exact = open_windows(dataset, start_noise_m=0, start_noise_rad=0, **options)
    turns, moves = [], []
    for epoch in range(15):
        noisy.set_epoch(epoch)
        one = noisy.__getitems__(range(120))["proprioception"].double().numpy()
        other = exact.__getitems__(range(120))["proprioception"].double().numpy()
        for first in (0, 10):
            mine, true = (
                Rotation.from_quat(rotation_from_6d(p[:, :, first + 3 : first + 9]).reshape(-1, 4))
                for p in (one, other)
            )
            # inv(T_noisy)·T = inv(error)·inv(T_start)·T: the same for all steps of a window
            error = (true * mine.inv()).as_rotvec().reshape(120, 16, 3)
            assert np.abs(error - error[:, :1]).max() < 1e-5
            turns.append(error[:, 0])
            base = mine.inv().apply(one[:, :, first : first + 3].reshape(-1, 3))
            exact_base = true.inv().apply(other[:, :, first : first + 3].reshape(-1, 3))
            moves.append((exact_base - base).reshape(120, 16, 3)[:, 15])
    for drawn in (np.concatenate(turns), np.concatenate(moves)):
        np.testing.assert_allclose(drawn.mean(axis=0), 0, atol=0.004)
        assert np.sqrt((drawn**2).sum(axis=1).mean() / 3) == pytest.approx(0.05, rel=0.03)
    left, right = turns[0::2], turns[1::2]
    correlation = np.corrcoef(np.concatenate(left).ravel(), np.concatenate(right).ravel())[0, 1]
    assert abs(correlation) < 0.05
    noisy.set_epoch(3)
    torch.testing.assert_close(
        noisy[17]["proprioception"], noisy.__getitems__([5, 17])["proprioception"][1]
    )


def test_normal_draws_are_normal() -> None:
    drawn = normal(1, np.zeros(20_000, np.int64), np.arange(20_000), 3, purpose=20)
    assert drawn.shape == (20_000, 3)
    for column in drawn.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(drawn.T) - np.eye(3)).max() < 0.03
