"""Numbers of a dataset: sums over episodes, counts, and what could not be read."""

import shutil
from dataclasses import asdict
from pathlib import Path

import pytest

from exumi_data.dataset import Dataset
from exumi_data.errors import ExumiError
from exumi_data.stats import DatasetSummary, EpisodeSummary, Range, measure, summarize


def test_demonstrations_per_hour_counts_no_touch_clips(small_dataset: Dataset) -> None:
    statistics = measure(small_dataset)
    assert statistics.episodes == 3
    assert statistics.duration_s == pytest.approx(3.0)
    assert statistics.demonstrations_per_hour == pytest.approx(3600)
    assert {name: r.episodes for name, r in statistics.regimes.items()} == {"play": 2, "touch": 1}
    assert statistics.regimes["touch"].per_hour == pytest.approx(3600)


def test_streams_are_added_up(small_dataset: Dataset) -> None:
    tactile, pose = measure(small_dataset).streams
    assert (tactile.name, tactile.episodes, tactile.n) == ("tactile", 3, 33)
    assert (pose.name, pose.episodes, pose.n) == ("pose", 2, 22)
    assert tactile.rate_hz is not None
    assert tactile.rate_hz.min == pytest.approx(10)
    assert (tactile.active, tactile.measured_activity) == (10, 22)


def test_episodes_without_stored_activity_are_left_out(small_dataset: Dataset) -> None:
    active = measure(small_dataset).active
    assert (active.episodes, active.unmeasured) == (2, 1)
    assert (active.active, active.frames) == (10, 22)
    assert active.ratio == pytest.approx(10 / 22)


def test_an_episode_without_a_required_stream_is_not_usable(small_dataset: Dataset) -> None:
    usable = measure(small_dataset, tick_s=0.1, required=["tactile", "pose"]).usable
    assert (usable.ticks, usable.usable, usable.without) == (33, 22, 1)


def test_labels(small_dataset: Dataset) -> None:
    hardness, words = measure(small_dataset).labels
    assert (hardness.property, hardness.episodes, hardness.missing) == ("hardness", 2, 1)
    assert hardness.numbers == Range(3.0, 5.25, 7.5)
    assert hardness.scales == [[0, 10]]
    assert hardness.provenance == {"human": 2}
    assert words.words == {"smooth": 2, "egg": 1, "rice": 1}
    assert words.numbers is None


def test_content_counts_those_that_do_not_say(small_dataset: Dataset) -> None:
    content = measure(small_dataset).content
    assert content.objects == {"": 1, "egg": 1, "rice": 1}
    assert content.licences == {"CC0-1.0": 2, "CC-BY-4.0": 1}
    assert content.quality == {"truncated": 1}
    assert content.tasks == {"test": 3}


def test_processes_give_the_same_numbers(small_dataset: Dataset) -> None:
    done: list[int] = []
    alone = measure(small_dataset, workers=1, on_done=done.append)
    assert done == [1, 2, 3]
    assert asdict(measure(small_dataset, workers=2)) == asdict(alone)


def test_what_cannot_be_read_is_named_and_not_counted(small_dataset: Dataset) -> None:
    path = Path(small_dataset.episode_location(0))
    shutil.rmtree(path / "streams" / "tactile" / "time")
    statistics = measure(small_dataset)
    assert statistics.episodes == 2
    assert [item.path for item in statistics.unreadable] == [str(path)]
    assert "missing" in statistics.unreadable[0].reason


def test_a_selection_is_measured_alone(small_dataset: Dataset) -> None:
    assert measure(small_dataset.select(part_id="egg")).episodes == 1


def test_a_summary_of_a_dataset_reads_no_episode(small_dataset: Dataset) -> None:
    shutil.rmtree(Path(small_dataset.path) / "episodes")
    summary = summarize(small_dataset)
    assert isinstance(summary, DatasetSummary)
    assert summary.episodes == 3
    assert summary.duration_s == pytest.approx(3.0)
    assert summary.labels == {"hardness": 2, "words": 2}
    assert [(s.name, s.kind, s.encodings, s.n) for s in summary.streams] == [
        ("tactile", "tactile", ["array"], 33),
        ("pose", "pose", [], 22),
    ]
    assert summary.objects == {"egg": 1, "rice": 1}


def test_a_summary_of_an_episode_reads_no_data(small_dataset: Dataset) -> None:
    path = Path(small_dataset.episode_location(0))
    for shard in path.rglob("c/*"):
        if shard.is_file():
            shard.unlink()
    summary = summarize(small_dataset[0])
    assert isinstance(summary, EpisodeSummary)
    assert summary.samples["tactile"] == 11
    assert summary.metadata["id"] == small_dataset.ids[0]
    assert not summary.packed


def test_a_catalog_that_lies_is_found(small_dataset: Dataset) -> None:
    shutil.rmtree(small_dataset.episode_location(1))
    statistics = measure(small_dataset)
    assert len(statistics.unreadable) == 1
    with pytest.raises(ExumiError):
        small_dataset[1]
