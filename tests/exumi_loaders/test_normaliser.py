"""Normalisers: fitted as NumPy would, undone exactly, refused where they do not belong."""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import exumi_data
from exumi_data.errors import MetadataError, UnsupportedError, UsageError
from exumi_loaders import ConcatWindows, Normaliser, PolicyWindows
from exumi_loaders.channel_statistics import ChannelStatistics

DURATION = 2.0


def full(recipe: Any, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "rgb_s": np.arange(40) / 20,
        "pose_s": np.arange(200) / 100,
        "width_s": np.arange(200) / 100,
    }
    return recipe(**{**values, **changes})


def open_windows(dataset: exumi_data.Dataset, **options: Any) -> PolicyWindows:
    options = {"tick_s": Fraction(1, 20), "cache": False, "split": "train", **options}
    return PolicyWindows(dataset, split_ratio=(2, 1), **options)


@pytest.fixture
def dataset(make_dataset: Any, recipe: Any) -> exumi_data.Dataset:
    gap = np.concatenate((np.arange(80), np.arange(120, 200))) / 100
    made: exumi_data.Dataset = make_dataset(
        full(recipe), full(recipe, pose_s=gap), full(recipe), full(recipe)
    )
    return made


@pytest.mark.parametrize("mode", ["limits", "gaussian"])
def test_fitted_to_what_is_valid(dataset: exumi_data.Dataset, mode: Any) -> None:
    windows = open_windows(dataset)
    normaliser = Normaliser.fit(windows, mode=mode)
    batch = windows.__getitems__(range(len(windows)))
    scaled = normaliser.normalise(batch)
    for key, padding in (
        ("action", batch["action_padding"]),
        ("proprioception", batch["observation_padding"]),
    ):
        valid = batch[f"{key}_valid"] & ~padding
        assert 0 < valid.float().mean() < 1
        rows = scaled[key][valid].double().numpy()
        original = batch[key][valid].double().numpy()
        channels = normaliser.document.keys[key]
        assert channels.count == len(rows)
        np.testing.assert_allclose(channels.mean, original.mean(axis=0), atol=1e-9)
        np.testing.assert_allclose(channels.deviation, original.std(axis=0), atol=1e-9)
        moving = np.ptp(original, axis=0) >= 1e-4
        free = np.array([".r" not in column for column in channels.columns]) & moving
        assert free.sum() >= 3
        if mode == "limits":
            np.testing.assert_allclose(rows.min(axis=0)[free], -1, atol=1e-5)
            np.testing.assert_allclose(rows.max(axis=0)[free], 1, atol=1e-5)
        else:
            np.testing.assert_allclose(rows.mean(axis=0)[free], 0, atol=1e-5)
            np.testing.assert_allclose(rows.std(axis=0)[free], 1, atol=1e-5)
        np.testing.assert_array_equal(rows[:, 3:9], original[:, 3:9])
    assert scaled["rgb"] is batch["rgb"]
    back = normaliser.unnormalise(scaled)
    for key in ("action", "proprioception"):
        torch.testing.assert_close(back[key], batch[key], atol=1e-6, rtol=1e-5)


def test_a_constant_channel_is_shifted_only(make_dataset: Any, recipe: Any) -> None:
    still = np.tile([0.3, 0.2, 0.1, 0, 0, 0, 1.0], (200, 1))
    still[:, 0] += np.arange(200) * 2e-7  # noise of a tracker: 0.04 mm
    dataset = make_dataset(*[full(recipe, poses=still) for _ in range(3)])
    windows = open_windows(dataset, action="absolute")
    for mode in ("limits", "gaussian"):
        normaliser = Normaliser.fit(windows, mode=mode)
        batch = windows.__getitems__([0, 10])
        scaled = normaliser.normalise(batch)["action"]
        assert scaled[..., :3].abs().max() < 1e-4
        back = normaliser.unnormalise({"action": scaled})["action"]
        torch.testing.assert_close(back, batch["action"])


def test_only_the_training_split(dataset: exumi_data.Dataset) -> None:
    for split in (None, "val"):
        windows = open_windows(dataset, split=split)
        with pytest.raises(UsageError, match="training split only"):
            Normaliser.fit(windows)
        assert Normaliser.fit(windows, any_split=True).document.fitted_to[0].split == split
    with pytest.raises(UsageError, match="mode"):
        Normaliser.fit(open_windows(dataset), mode="minmax")  # type: ignore[arg-type]


def test_kept_as_json_beside_the_dataset(dataset: exumi_data.Dataset, tmp_path: Path) -> None:
    windows = open_windows(dataset)
    normaliser = Normaliser.fit(windows)
    file = tmp_path / "runs" / "normaliser.json"
    normaliser.save(file)
    document = json.loads(file.read_text())
    assert document["fitted_to"][0]["dataset"] == windows.episodes.fingerprint
    assert document["fitted_to"][0]["split"] == "train"
    assert document["fitted_to"][0]["action_steps"] == list(range(1, 17))
    loaded = Normaliser.load(file)
    assert loaded.document == normaliser.document
    batch = windows.__getitems__([3])
    assert torch.equal(loaded(batch)["action"], normaliser(batch)["action"])
    for inside in (Path(dataset.path), Path(dataset.episode_location(0))):
        with pytest.raises(UsageError, match="no part of"):
            normaliser.save(inside / "normaliser.json")
        assert not (inside / "normaliser.json").exists()


def test_data_of_other_settings_is_refused(
    dataset: exumi_data.Dataset, make_dataset: Any, recipe: Any
) -> None:
    windows = open_windows(dataset)
    normaliser = Normaliser.fit(windows)
    normaliser.check(open_windows(dataset, split="val"))
    normaliser.check(windows.policy_spec)
    others: dict[str, dict[str, Any]] = {
        "action_steps": {"action_steps": 8},
        "tick_s": {"tick_s": Fraction(1, 10)},
        "action absolute|action relative": {"action": "absolute"},
        "latency_ns": {"latency_s": {"pose": 0.02}},
        "columns": {"width": ()},
    }
    for name, options in others.items():
        with pytest.raises(UsageError, match=name):
            normaliser.check(open_windows(dataset, **options))
    other = make_dataset(*[full(recipe, child="flange") for _ in range(3)], name="other")
    with pytest.raises(UsageError, match="child frames"):
        normaliser.check(open_windows(other))
    with pytest.raises(UsageError, match="channels"):
        normaliser.normalise({"action": torch.zeros(2, 16, 9)})


def test_several_datasets(dataset: exumi_data.Dataset, make_dataset: Any, recipe: Any) -> None:
    other = make_dataset(*[full(recipe, width_s=np.arange(300) / 100) for _ in range(3)], name="b")
    parts = [open_windows(dataset), open_windows(other)]
    both = Normaliser.fit(ConcatWindows(parts))
    single = [Normaliser.fit(part).document.keys["action"] for part in parts]
    found = both.document.keys["action"]
    assert found.count == sum(channels.count for channels in single)
    assert found.maximum == tuple(np.maximum(single[0].maximum, single[1].maximum))
    assert len(both.document.fitted_to) == 2
    both.check(ConcatWindows(parts))


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"format": "something"}, MetadataError),
        ({"version": "2.0"}, UnsupportedError),
        ({"mode": "robust"}, MetadataError),
        ({"keys": {"action": {"columns": ["x"]}}}, MetadataError),
        ({"surprise": 1}, MetadataError),
    ],
)
def test_other_documents_are_refused(
    dataset: exumi_data.Dataset, tmp_path: Path, change: Any, error: Any
) -> None:
    file = tmp_path / "normaliser.json"
    Normaliser.fit(open_windows(dataset)).save(file)
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(error):
        Normaliser.load(file)


def test_the_state_moves_with_the_model(dataset: exumi_data.Dataset) -> None:
    normaliser = Normaliser.fit(open_windows(dataset))
    assert not list(normaliser.parameters())
    other = Normaliser.fit(open_windows(dataset), mode="gaussian")
    other.load_state_dict(normaliser.state_dict())
    assert torch.equal(other.get_buffer("action_scale"), normaliser.get_buffer("action_scale"))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32), st.lists(st.integers(0, 9), min_size=1, max_size=6))
def test_statistics_do_not_depend_on_the_blocks(seed: int, sizes: list[int]) -> None:
    if not sum(sizes):
        return
    values = np.random.default_rng(seed).normal(1000, 1, (sum(sizes), 3))
    found = ChannelStatistics.of(np.split(values, np.cumsum(sizes)[:-1]), 3)
    assert found.count == len(values)
    np.testing.assert_array_equal(found.minimum, values.min(axis=0))
    np.testing.assert_array_equal(found.maximum, values.max(axis=0))
    np.testing.assert_allclose(found.mean, values.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.deviation, values.std(axis=0), atol=1e-9)
