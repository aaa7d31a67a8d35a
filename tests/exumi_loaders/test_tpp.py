"""TPP windows against what can be worked out by hand."""

import shutil
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import exumi_data
from exumi_data.catalog import build_catalog, write_catalog
from exumi_data.dataset import open_dataset
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.store.pack import pack
from exumi_loaders import TPPWindows, WindowSampler

TICK = 1 / 20
STEPS = np.arange(-15, 17)


def seconds(rate: float, duration: float, start: float = 0.0) -> np.ndarray:
    return start + np.arange(round(rate * duration)) / rate


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


def test_frames_are_the_nearest_to_their_ticks(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe)), random_history=False)
    assert len(windows) == 120
    item = windows[40]
    assert item["tactile"].shape == (8, 1, 8, 8)
    assert item["tactile"].dtype == torch.uint8
    steps = np.array([-12, -8, -4, 0, 4, 8, 12, 16])
    np.testing.assert_array_equal(item["tactile_steps"], steps)
    expected = np.round((40 + steps) * TICK * 30)
    np.testing.assert_allclose(item["tactile"][:, 0, 0, 0].numpy(), expected, atol=0.5)
    assert item["rgb"].shape == (1, 1, 8, 8)
    assert int(item["rgb"][0, 0, 0, 0]) == 60
    assert (item["tactile_reference"] == 7).all()
    assert bool(item["valid"])
    assert int(item["time_ns"]) == 2_000_000_000


def test_actions_are_relative_to_step_zero(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe)))
    item = windows[50]
    time = (50 + STEPS) * TICK
    start = Rotation.from_rotvec([0.3 * 2.5, 0, 0.1 * 2.5])
    turn = Rotation.from_rotvec(np.stack((0.3 * time, 0 * time, 0.1 * time), axis=1))
    position = np.stack((0.1 * time, 0.2 * np.sin(time), 0.05 * time), axis=1)
    expected_position = start.inv().apply(position - position[15])
    rows = (start.inv() * turn).as_matrix()[:, :2].reshape(32, 6)
    assert item["action"].shape == (32, 10)
    np.testing.assert_allclose(item["action"][:, :3], expected_position, atol=2e-5)
    np.testing.assert_allclose(item["action"][:, 3:9], rows, atol=2e-5)
    np.testing.assert_allclose(item["action"][:, 9], 0.05 + 0.01 * time, atol=1e-6)
    np.testing.assert_allclose(item["action"][15, :9], [0, 0, 0, 1, 0, 0, 0, 1, 0], atol=1e-6)
    assert item["action_valid"].all()


def test_only_streams_that_exist_have_keys(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(recipe(tactile_s=seconds(25, 5))))
    assert set(windows[3]) == {
        "tactile",
        "tactile_valid",
        "tactile_reference",
        "tactile_steps",
        "tactile_history_masked",
        "padding",
        "valid",
        "episode",
        "time_ns",
    }
    only_pose = make_dataset(full(recipe, width_s=None), name="pose")
    assert open_windows(only_pose)[0]["action"].shape == (32, 9)
    only_width = make_dataset(full(recipe, pose_s=None), name="width")
    assert open_windows(only_width)[0]["action"].shape == (32, 1)


def test_slow_clips_work_with_the_default_tick(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(recipe(tactile_s=seconds(10, 5)))
    windows = TPPWindows(dataset, cache=False, random_history=False, edges="drop")
    assert len(windows) == 98 - 31
    for index in range(len(windows)):
        item = windows[index]
        assert item["valid"]
        tick = 15 + index + item["tactile_steps"].numpy()
        np.testing.assert_allclose(
            item["tactile"][:, 0, 0, 0].numpy() / 10, tick * 0.05005, atol=0.0501
        )


@pytest.mark.parametrize("edges", ["pad", "drop"])
def test_short_episodes_are_padded(make_dataset: Any, recipe: Any, edges: str) -> None:
    short = full(recipe, duration=0.2, activity=np.zeros(6))
    windows = open_windows(make_dataset(short), edges=edges)
    assert len(windows) == (4 if edges == "pad" else 1)
    item = windows[1 if edges == "pad" else 0]
    assert item["padding"].sum() == 32 - 4
    assert not item["valid"]
    assert item["tactile_valid"].all()
    assert item["action_valid"].sum() == 4
    first, last = item["tactile"][0, 0, 0, 0], item["tactile"][-1, 0, 0, 0]
    assert (int(first), int(last)) in {(0, 4), (0, 5)} or edges == "drop"
    assert torch.isfinite(item["action"]).all()


def test_padding_repeats_the_edge(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe)), random_history=False)
    item = windows[0]
    np.testing.assert_array_equal(item["tactile"][:4, 0, 0, 0], 0)
    np.testing.assert_array_equal(item["padding"].numpy(), STEPS < 0)
    np.testing.assert_array_equal(item["action_valid"].numpy(), STEPS >= 0)
    last = windows[len(windows) - 1]
    np.testing.assert_array_equal(last["padding"].numpy(), STEPS > 0)
    assert len({int(v) for v in last["tactile"][4:, 0, 0, 0]}) == 1


def test_gaps_are_invalid_and_black(make_dataset: Any, recipe: Any) -> None:
    time = seconds(30, 6)
    keep = (time < 2.0) | (time > 3.0)
    pose_time = seconds(90, 6)
    pose_keep = (pose_time < 4.0) | (pose_time > 4.5)
    windows = open_windows(
        make_dataset(
            full(recipe, tactile_s=time[keep], activity=None, pose_s=pose_time[pose_keep])
        ),
        random_history=False,
    )
    item = windows[50]  # 2.5 s: in the middle of the tactile gap
    at = 2.5 + np.array([-12, -8, -4, 0, 4, 8, 12, 16]) * TICK
    inside = (at > 2.06) & (at < 2.94)
    np.testing.assert_array_equal(item["tactile_valid"].numpy(), ~inside)
    assert (item["tactile"][inside] == 0).all()
    assert not item["valid"]
    actions = windows[80]  # 4.0 s
    steps_at = 4.0 + STEPS * TICK
    clearly_inside, clearly_outside = (
        (steps_at > 4.02) & (steps_at < 4.48),
        (steps_at < 3.98) | (steps_at > 4.52),
    )
    valid = actions["action_valid"].numpy()
    assert not valid[clearly_inside].any()
    assert torch.isfinite(actions["action"]).all()
    # The reference pose itself lies at the edge of the gap: valid only if it was measured.
    assert valid[clearly_outside].all() == valid[15]


def test_activity_of_a_window_against_a_loop(make_dataset: Any, recipe: Any) -> None:
    rng = np.random.default_rng(0)
    time = np.sort(rng.choice(1800, 180, replace=False)) / 300
    activity = (rng.random(180) < 0.03).astype(np.float32) * 0.01
    dataset = make_dataset(recipe(tactile_s=time, activity=activity))
    for mode in ("all", "future"):
        windows = open_windows(dataset, activity=mode)
        frame = windows.timeline.frame["tactile"]
        ticks = time[0] + np.arange(len(windows)) * TICK
        for index, at in enumerate(ticks):
            if mode == "all":
                span = (time >= at - 15.5 * TICK - 1e-9) & (time <= at + 16.5 * TICK + 1e-9)
                expected = bool((activity[span] > 1e-3).any())
            else:
                wanted = np.minimum(index + np.array([4, 8, 12, 16]), len(ticks) - 1)
                frames = frame[wanted]
                expected = bool((activity[frames[frames >= 0]] > 1e-3).any())
            assert windows.active[index] == expected, (mode, index)
    assert 0 < windows.active.mean() < 1


def test_rejected_windows_are_never_decoded(make_dataset: Any, recipe: Any) -> None:
    activity = np.zeros(180)
    activity[90:95] = 0.01
    dataset = make_dataset(
        full(recipe, activity=activity, encoded=True, rgb_s=None, pose_s=None, width_s=None)
    )
    location = Path(dataset.episode_location(0), "streams/tactile/data/c/0")
    with location.open("r+b") as file:  # damage the first frame: decoding it must fail
        file.seek(40)
        file.write(b"\xff" * 20)
    windows = open_windows(dataset)
    with pytest.raises(DamagedDataError, match="frame 0"):
        windows[0]
    seen = 0
    for batch in windows.loader(8, reject_inactive=1.0):
        seen += len(batch["valid"])
    assert seen == int(windows.active.sum()) > 0


def test_rejection_keeps_a_share_of_inactive_windows(make_dataset: Any, recipe: Any) -> None:
    activity = np.zeros(1800)
    activity[:150] = 0.01
    time = seconds(30, 60)
    dataset = make_dataset(recipe(tactile_s=time, activity=activity, channels=1))
    windows = open_windows(dataset)
    inactive = int((~windows.active).sum())
    kept = []
    for epoch in range(20):
        order = WindowSampler(windows, reject_inactive=0.9, seed=3).order(epoch)
        assert set(np.flatnonzero(windows.active)) <= set(order)
        kept.append(len(order) - int(windows.active.sum()))
    expected = 0.1 * inactive
    sigma = (0.1 * 0.9 * inactive / 20) ** 0.5
    assert abs(np.mean(kept) - expected) < 4 * sigma


def test_no_stored_activity_is_said_at_once(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(recipe(tactile_s=seconds(30, 5))))
    with pytest.raises(UsageError, match="stored tactile activity"):
        windows.loader(4, reject_inactive=0.5)


def test_history_draws_are_uniform_over_subsets(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe)))
    counts: dict[tuple[int, ...], int] = {}
    pairs = np.zeros((16, 16))
    draws = 0
    for epoch in range(150):
        windows.set_epoch(epoch)
        steps = windows._tactile_steps(  # 18,000 draws without decoding
            np.full(120, epoch), np.arange(120)
        )
        assert (np.diff(steps[:, :4], axis=1) > 0).all()
        for row in steps[:, :4]:
            counts[tuple(row)] = counts.get(tuple(row), 0) + 1
            for a, b in combinations(row + 15, 2):
                pairs[a, b] += 1
            draws += 1
    assert min(min(key) for key in counts) == -15
    assert max(max(key) for key in counts) == 0
    expected = draws * 6 / 120  # each of the C(16, 2) pairs is in C(14, 2)/C(16, 4) = 6/120 of them
    upper = pairs[np.triu_indices(16, 1)]
    chi2 = ((upper - expected) ** 2 / expected).sum()
    assert chi2 < 180  # 119 degrees of freedom: p < 0.0003 beyond


def test_draws_depend_on_seed_epoch_and_index_alone(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    windows = open_windows(dataset, seed=5)
    alone = windows[17]["tactile_steps"]
    batch = windows.__getitems__([3, 17, 99])["tactile_steps"]
    assert torch.equal(alone, batch[1])
    assert torch.equal(alone, open_windows(dataset, seed=5)[17]["tactile_steps"])
    others = [open_windows(dataset, seed=s)[17]["tactile_steps"] for s in range(6, 12)]
    assert any(not torch.equal(alone, other) for other in others)
    windows.set_epoch(1)
    changed = [windows[i]["tactile_steps"] for i in range(10)]
    windows.set_epoch(0)
    assert any(not torch.equal(c, windows[i]["tactile_steps"]) for i, c in enumerate(changed))


def collect(windows: TPPWindows, workers: int) -> list[dict[str, torch.Tensor]]:
    loader = windows.loader(7, num_workers=workers, reject_inactive=0.5)
    return [*loader, *loader]  # two epochs


def test_workers_change_nothing(make_dataset: Any, recipe: Any) -> None:
    activity = np.zeros(180)
    activity[60:90] = 0.01
    dataset = make_dataset(full(recipe, activity=activity, encoded=True))
    alone = collect(open_windows(dataset), 0)
    for workers in (1, 2):
        others = collect(open_windows(dataset), workers)
        assert len(others) == len(alone)
        for one, other in zip(alone, others, strict=True):
            assert one.keys() == other.keys()
            for key in one:
                assert torch.equal(one[key], other[key]), key
    first, second = alone[: len(alone) // 2], alone[len(alone) // 2 :]
    assert not all(
        torch.equal(a["time_ns"], b["time_ns"]) for a, b in zip(first, second, strict=False)
    )


def test_batches_equal_items(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe), full(recipe, duration=0.3, activity=np.zeros(9)))
    windows = open_windows(dataset)
    indices = [0, 5, len(windows) - 1, 60, 5]
    batch = windows.__getitems__(indices)
    for position, index in enumerate(indices):
        for key, value in windows[index].items():
            # Sums of a batch may be ordered otherwise than those of one item: the last bit.
            torch.testing.assert_close(batch[key][position], value, rtol=0, atol=1e-6)


def test_colour_is_channels_first_without_a_copy(make_dataset: Any, recipe: Any) -> None:
    windows = open_windows(make_dataset(full(recipe, channels=3)))
    batch = windows.__getitems__([1, 2])
    assert batch["tactile"].shape == (2, 8, 3, 8, 8)
    assert batch["tactile"].stride()[2] == 1
    grey = open_windows(make_dataset(full(recipe, channels=3), name="g"), grey_tactile=True)
    item = grey[40]
    assert item["tactile"].shape == (8, 1, 8, 8)
    assert item["tactile_reference"].shape == (1, 8, 8)
    assert item["rgb"].shape == (1, 3, 8, 8)


def test_frames_of_different_sizes_are_refused(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe), full(recipe, side=10))
    with pytest.raises(UsageError, match="exumi prepare"):
        open_windows(dataset)


def test_missing_streams_are_refused_by_name(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe), full(recipe, pose_s=None))
    with pytest.raises(UsageError, match=r"1 of 2 episodes have a pose stream"):
        open_windows(dataset)
    with pytest.raises(UsageError, match="rgb stream 'front'"):
        open_windows(dataset, rgb=["front"])
    assert "rgb" not in open_windows(dataset.select(stream="pose"), rgb=[])[0]


def test_several_tactile_streams(make_dataset: Any, recipe: Any) -> None:
    extra = {"tactile_right": seconds(15, 6, start=0.02)}
    windows = open_windows(make_dataset(full(recipe, extra=extra, activity=None)))
    item = windows[40]
    assert item["tactile_right"].shape == (8, 1, 8, 8)
    assert windows.layout.tactile == ("tactile", "tactile_right")


def test_invalid_options_name_the_supported_ones(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe))
    with pytest.raises(UsageError, match="'pad', 'drop'"):
        open_windows(dataset, edges="wrap")
    with pytest.raises(UsageError, match="'all', 'future'"):
        open_windows(dataset, activity="some")
    with pytest.raises(UsageError, match="tick_s"):
        open_windows(dataset, tick_s=0)
    with pytest.raises(IndexError):
        open_windows(dataset)[10_000]
    assert len(open_windows(dataset, stride=3)) == 40


def test_a_stream_that_does_not_overlap_gives_no_windows(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(full(recipe), full(recipe, rgb_s=seconds(30, 6, start=100)))
    windows = open_windows(dataset)
    assert len(windows) == 120


def test_packed_episodes_give_the_same_windows(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(
        full(recipe, encoded=True), full(recipe, encoded=True, duration=3.0, activity=np.zeros(90))
    )
    before = [open_windows(dataset)[i] for i in (0, 40, 130)]
    root = Path(dataset.path)
    for index in range(len(dataset)):
        folder = Path(dataset.episode_location(index))
        pack(folder)
        shutil.rmtree(folder)
    table, failed = build_catalog(root)
    assert not failed
    write_catalog(root, table)
    packed = open_windows(open_dataset(root).select(dataset.ids))
    assert packed.episodes.episode_location(0).endswith(".zarr.zip")
    for index, item in zip((0, 40, 130), before, strict=True):
        for key, value in packed[index].items():
            torch.testing.assert_close(value, item[key], rtol=0, atol=1e-6)
