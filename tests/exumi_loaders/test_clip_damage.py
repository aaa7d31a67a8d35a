"""Damaged clips, and clips that change while they are read."""

import shutil
from pathlib import Path
from typing import Any

import pytest

import exumi_data
from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_loaders import Clips, ContrastiveBatches, InstructionSamples, PropertyWindows, TwoViews


@pytest.fixture
def damaged(make_touches: Any, touch: Any, rated: Any) -> exumi_data.Dataset:
    """Two clips of each of two parts; the first frame of the first clip is damaged."""
    labels = rated(hardness=3.0, roughness=1.0)
    looks = [("a", 1), ("a", 2), ("b", 3), ("b", 4)]
    dataset: exumi_data.Dataset = make_touches(
        *(
            touch(part, brightness=(first, 50 + first, 90 + first), labels=labels, stored=3)
            for part, first in looks
        )
    )
    file = Path(dataset.episode_location(0), "streams/tactile/data/c/0/0/0/0")
    content = bytearray(file.read_bytes())
    content[3] ^= 0xFF
    file.write_bytes(content)
    return dataset


def test_by_default_the_frame_is_named(damaged: exumi_data.Dataset) -> None:
    named = rf"{damaged.ids[0]}\.zarr, stream tactile, frame \d"
    for read in (
        lambda: Clips(damaged, frames=3).read(0),
        lambda: list(ContrastiveBatches(damaged, frames=3).loader()),
        lambda: list(PropertyWindows(damaged, frames=3).loader(4)),
        lambda: list(TwoViews(damaged, frames=3).loader(4)),
    ):
        with pytest.raises(DamagedDataError, match=named):
            read()


def test_substituted_frames_are_black_and_counted(damaged: exumi_data.Dataset) -> None:
    windows = PropertyWindows(damaged, frames=3, on_corrupt="substitute")
    for workers in (0, 1):
        (batch,) = windows.loader(4, shuffle=False, num_workers=workers)
        bad = ~batch["frames_valid"]
        assert bad.sum(dim=1).tolist() == batch["substituted"].tolist() == [1, 0, 0, 0]
        assert not batch["frames"][bad].any()
        assert (batch["frames"][~bad] > 0).all()


def test_all_that_reads_clips_can_go_on(damaged: exumi_data.Dataset) -> None:
    pairs = next(iter(ContrastiveBatches(damaged, frames=3, on_corrupt="substitute").loader()))
    assert pairs["substituted"].shape == pairs["clip"].shape
    assert (pairs["substituted"] > 0).tolist() == (pairs["episode"] == 0).tolist()
    (views,) = TwoViews(damaged, frames=3, on_corrupt="substitute").loader(12)
    assert views["substituted"].tolist() == (~views["valid"]).int().tolist()
    assert views["substituted"].sum() == pairs["substituted"].sum()


@pytest.mark.parametrize("kind", [ContrastiveBatches, PropertyWindows, TwoViews])
def test_other_words_are_refused(damaged: exumi_data.Dataset, kind: Any) -> None:
    with pytest.raises(UsageError, match="on_corrupt"):
        kind(damaged, on_corrupt="skip")


@pytest.mark.parametrize("gone", [True, False])
def test_an_episode_that_was_exchanged_is_never_read(
    damaged: exumi_data.Dataset, gone: bool
) -> None:
    windows = PropertyWindows(damaged, frames=3, on_corrupt="substitute")
    place = Path(damaged.episode_location(1))
    shutil.rmtree(place)
    if not gone:
        shutil.copytree(damaged.episode_location(2), place)
    with pytest.raises(ChangedDataError, match=damaged.ids[1]):
        windows[1]


@pytest.mark.parametrize("kind", [TwoViews, InstructionSamples, PropertyWindows])
def test_what_is_no_dataset_is_said(damaged: exumi_data.Dataset, kind: Any) -> None:
    for wrong in (damaged.episode_location(1), damaged[1]):
        with pytest.raises(UsageError, match="not a dataset, but"):
            kind(wrong)
