"""Touch clips of a real sensor, where there are some."""

from pathlib import Path

import pytest

import exumi_data
from exumi_converters import ConvertOptions, convert
from exumi_loaders import ContrastiveBatches, InstructionSamples, PropertyWindows

PARTS = ("controller_base", "controller_shoulderpads", "egg", "rice")


@pytest.fixture
def clips(real_data: Path, tmp_path: Path) -> exumi_data.Dataset:
    source = real_data.resolve() / "physiclear"
    (tmp_path / "videos").mkdir()
    for part in PARTS:
        for trial in range(2):
            name = f"{part}_{trial}.mov"
            (tmp_path / "videos" / name).symlink_to(source / "videos" / name)
    options = ConvertOptions(labels=source / "labels.csv")
    convert(tmp_path / "videos", tmp_path / "set", from_format="octopi", options=options)
    opened = exumi_data.open(tmp_path / "set")
    assert isinstance(opened, exumi_data.Dataset)
    return opened


def test_batches_ratings_and_samples_of_a_gelsight_mini(clips: exumi_data.Dataset) -> None:
    batches = ContrastiveBatches(clips, grey_tactile=True)
    assert batches.groups == (("gelsight-mini", "plain", PARTS, 1),)
    batch = batches[0]
    assert batch["frames"].shape == (4, 2, 10, 1, 240, 320)
    assert batch["frames"].float().std() > 1
    for one, other in batches.labels(batch):
        assert one.part_id == other.part_id
        assert one.trial != other.trial
    windows = PropertyWindows(clips)
    assert windows.rating_valid.all()
    assert ((windows.rating >= 0) & (windows.rating <= 10)).all()
    samples = InstructionSamples(clips, count=50)
    assert all(len(set(sample.parts)) == len(sample.parts) for sample in samples)
    assert any(samples.clips.table[p.clip].object_id == "a_game_controller"
               for sample in samples for p in sample.parts if p.part == 2)  # fmt: skip
