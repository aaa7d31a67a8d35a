"""Damaged frames of touch clips: named, replaced by other clips, or black and counted."""

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import exumi_data
from exumi_data.demo import TouchSettings, write_touch_dataset
from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_loaders import (
    Clips,
    ContrastiveBatches,
    InstructionSamples,
    PropertyWindows,
    TwoViews,
)

PARTS, CLIPS = 4, 4
LOADERS = (ContrastiveBatches, PropertyWindows, TwoViews, InstructionSamples)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("touches") / "touches"
    write_touch_dataset(root, TouchSettings(parts=PARTS, clips=CLIPS), workers=1)
    return root


@pytest.fixture
def touches(sound: Path, tmp_path: Path) -> exumi_data.Dataset:
    opened = exumi_data.open(shutil.copytree(sound, tmp_path / "touches"))
    assert isinstance(opened, exumi_data.Dataset)
    return opened


def damage(dataset: exumi_data.Dataset, episode: int, frame: int) -> None:
    """Spoil one JPEG file."""
    with dataset[episode] as opened:
        start = int(np.asarray(opened["tactile"]._frame_source.offset)[frame])  # type: ignore[attr-defined]
    with Path(dataset.episode_location(episode), "streams/tactile/data/c/0").open("r+b") as file:
        file.seek(start + 20)
        file.write(b"\xff" * 8)


def salient(dataset: exumi_data.Dataset, episode: int) -> list[int]:
    return [int(number) for number in Clips(dataset).salient(episode).numbers]


def without_frames(dataset: exumi_data.Dataset, episode: int) -> None:
    Path(dataset.episode_location(episode), "streams/tactile/data/c/0").unlink()


def clips_of(dataset: exumi_data.Dataset, part: str) -> list[int]:
    return [n for n, clip in enumerate(Clips(dataset).table) if clip.part_id == part]


@pytest.mark.parametrize("loader", LOADERS)
def test_by_default_the_frame_is_named(touches: exumi_data.Dataset, loader: Any) -> None:
    frame = salient(touches, 5)[3]
    damage(touches, 5, frame)
    windows = loader(touches)
    with pytest.raises(DamagedDataError) as caught:
        list(map(windows.__getitem__, range(min(len(windows), 200))))
    assert caught.value.where is not None
    assert caught.value.where.endswith(f"stream tactile, frame {frame}")
    assert touches.ids[5] in caught.value.where
    with pytest.raises(UsageError, match="'substitute'"):
        loader(touches, on_corrupt="ignore")


def test_a_damaged_frame_that_is_not_salient_does_no_harm(touches: exumi_data.Dataset) -> None:
    (other, *_) = set(range(14)) - set(salient(touches, 5))
    damage(touches, 5, other)
    assert PropertyWindows(touches)[5]["frames_valid"].all()


def test_substituted_frames_are_black_and_counted(touches: exumi_data.Dataset) -> None:
    everything = list(range(PARTS * CLIPS))
    before = PropertyWindows(touches, on_corrupt="substitute").__getitems__(everything)
    assert not before["substituted"].any()
    damage(touches, 5, salient(touches, 5)[3])
    shutil.rmtree(Path(touches.episode_location(7), "streams/tactile/reference"))
    batch = PropertyWindows(touches, on_corrupt="substitute").__getitems__(everything)
    bad = torch.zeros(16, 10, dtype=torch.bool)
    bad[5, 3] = True
    bad[7] = True  # without its reference, a clip is worth nothing
    assert torch.equal(batch["frames_valid"], ~bad)
    assert torch.equal(batch["substituted"], bad.sum(dim=1))
    assert not batch["frames"][bad].any()
    assert torch.equal(batch["frames"][~bad], before["frames"][~bad])
    assert not batch["reference"][7].any()
    assert torch.equal(batch["rating"], before["rating"])
    views = TwoViews(touches, on_corrupt="substitute")
    (view,) = views.loader(160, shuffle=False)
    assert torch.equal(view["valid"], ~bad.flatten())
    assert torch.equal(view["substituted"], bad.flatten().long())


@pytest.mark.parametrize("workers", [0, 2])
def test_skipped_clips_are_replaced_with_their_ratings(
    touches: exumi_data.Dataset, workers: int
) -> None:
    damage(touches, 5, salient(touches, 5)[3])
    without_frames(touches, 6)
    windows = PropertyWindows(touches, on_corrupt="skip")
    sizes = []
    for start, batch in enumerate(windows.loader(6, shuffle=False, num_workers=workers)):
        asked = np.arange(6 * start, min(6 * start + 6, 16))
        sizes.append(len(asked))
        np.testing.assert_array_equal(batch["replaced"] > 0, np.isin(asked, [5, 6]))
        got = batch["clip"].numpy()
        assert not np.isin(got, [5, 6]).any()
        untouched = ~np.isin(asked, [5, 6])
        np.testing.assert_array_equal(got[untouched], asked[untouched])
        assert batch["frames_valid"].all()
        for row, clip in enumerate(got.tolist()):  # the whole item is that of the other clip
            item = windows[clip]
            for key in ("frames", "reference", "rating", "rating_valid", "episode"):
                assert torch.equal(batch[key][row], item[key]), key
    assert sizes == [6, 6, 4]
    assert windows[5]["clip"] == windows[5]["clip"]
    drawn = {
        int(PropertyWindows(touches, on_corrupt="skip", seed=seed)[5]["clip"]) for seed in range(8)
    }
    assert len(drawn) > 1


def test_skipped_views_are_frames_of_other_clips(touches: exumi_data.Dataset) -> None:
    without_frames(touches, 5)
    views = TwoViews(touches, on_corrupt="skip")
    (batch,) = views.loader(160, shuffle=False)
    np.testing.assert_array_equal(np.flatnonzero(batch["replaced"]), range(50, 60))
    assert batch["valid"].all()
    assert not (batch["clip"] == 5).any()
    assert len(batch["clip"][50:60].unique()) > 1


def test_a_part_takes_another_of_its_clips_or_is_left_out(touches: exumi_data.Dataset) -> None:
    part = Clips(touches).table[0].part_id
    assert part is not None
    mine = clips_of(touches, part)
    without_frames(touches, mine[0])
    batches = ContrastiveBatches(touches, on_corrupt="skip")
    replaced = 0
    for number in range(len(batches)):
        batch = batches[number]
        assert batch["frames"].shape[:2] == (PARTS, 2)
        assert batch["frames_valid"].all()
        assert not (batch["clip"] == mine[0]).any()
        planned = batches.plan(0)[number][1]
        np.testing.assert_array_equal(batch["replaced"] > 0, planned == mine[0])
        for (one, other), name in zip(batches.labels(batch), batch["part"], strict=True):
            assert one.part_id == other.part_id == batches.parts[name]
            assert one.id != other.id
        replaced += int(batch["replaced"].sum())
    assert replaced == 1
    for clip in mine[1:3]:
        without_frames(touches, clip)
    less = ContrastiveBatches(touches, on_corrupt="skip")[0]  # one sound clip is no pair
    assert len(less["part"]) == len(less["frames"]) == len(less["replaced"]) == PARTS - 1
    assert part not in {batches.parts[number] for number in less["part"]}


def test_a_batch_of_too_few_sound_parts_is_an_error(touches: exumi_data.Dataset) -> None:
    batches = ContrastiveBatches(touches, on_corrupt="skip", min_parts=4)
    assert batches[0]["replaced"].shape == (4, 2)
    for clip in clips_of(touches, "part_02"):
        without_frames(touches, clip)
    again = ContrastiveBatches(touches, on_corrupt="skip", min_parts=4)
    with pytest.raises(DamagedDataError, match="too few others"):
        again[0]


def test_skipped_samples_are_replaced_as_a_whole(touches: exumi_data.Dataset) -> None:
    without_frames(touches, 5)
    samples = InstructionSamples(touches, on_corrupt="skip", count=30, max_objects=2)
    replaced = 0
    for index in range(30):
        item = samples[index]
        assert item["frames_valid"].all()
        assert not (item["clip"] == 5).any()
        planned = samples.instruction(index)
        has_it = 5 in [part.clip for part in planned.parts]
        assert (item["replaced"] > 0) == has_it
        assert (item["answer"] == planned.answer) or has_it
        replaced += has_it
    assert replaced > 0
    black = InstructionSamples(touches, on_corrupt="substitute", count=30, max_objects=2)
    item = next(i for i in map(black.__getitem__, range(30)) if 5 in i["clip"])
    at = item["clip"].tolist().index(5)
    assert item["substituted"][at] == 10
    assert not item["frames"][at].any()


def test_when_all_is_damaged_skipping_ends(touches: exumi_data.Dataset) -> None:
    for episode in range(len(touches)):
        without_frames(touches, episode)
    for loader in LOADERS:
        windows: Any = loader(touches, on_corrupt="skip")
        with pytest.raises(DamagedDataError, match="exumi validate"):
            windows[0]
    batch = ContrastiveBatches(touches, on_corrupt="substitute")[0]
    assert (batch["substituted"] == 10).all()


def test_a_damaged_selection_counts_as_a_damaged_clip(touches: exumi_data.Dataset) -> None:
    folder = Path(touches.episode_location(5), "derived/tactile/salient/c")
    for file in folder.rglob("*"):
        if file.is_file():
            os.truncate(file, 3)
    with pytest.raises(DamagedDataError):
        PropertyWindows(touches)[5]
    item = PropertyWindows(touches, on_corrupt="substitute")[5]
    assert item["substituted"] == 10
    assert not item["frames"].any()
    assert PropertyWindows(touches, on_corrupt="skip")[5]["clip"] != 5


@pytest.mark.parametrize("policy", ["raise", "skip", "substitute"])
def test_another_revision_is_an_error_in_any_case(touches: exumi_data.Dataset, policy: Any) -> None:
    windows = PropertyWindows(touches, on_corrupt=policy)
    here, there = (Path(touches.episode_location(number)) for number in (5, 6))
    shutil.rmtree(here)
    shutil.copytree(there, here)
    with pytest.raises(ChangedDataError, match="another revision"):
        windows[5]
    shutil.rmtree(here)
    with pytest.raises(ChangedDataError, match="can no longer be read"):
        windows[5]
