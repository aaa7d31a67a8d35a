"""What would harm the data without a word is refused with one."""

from pathlib import Path
from typing import Any

import pytest

from exumi_converters import prepare
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.errors import UsageError
from exumi_data.model import DatasetMetadata
from exumi_data.stats import measure


def test_a_training_set_has_one_sort_of_frames(octopi: Path, run: Any, tmp_path: Path) -> None:
    run(octopi, "octopi")
    prepare(tmp_path / "out", tmp_path / "training", size=32, gray=True, workers=1)
    count = len(open_dataset(tmp_path / "training"))
    with pytest.raises(UsageError, match=r"other settings: size 32 \(now 48\)"):
        prepare(tmp_path / "out", tmp_path / "training", size=48, gray=True, workers=1)
    again = prepare(tmp_path / "out", tmp_path / "training", size=32, gray=True, workers=1)
    assert again.converted == 0
    assert len(open_dataset(tmp_path / "training")) == count == again.skipped


def test_a_link_that_leads_nowhere_fails_by_name(octopi: Path, run: Any) -> None:
    (octopi / "egg_9.mov").symlink_to(octopi / "nowhere.mov")
    report, _ = run(octopi, "octopi")
    assert [failure.name for failure in report.failed] == ["egg_9.mov"]


def test_statistics_do_not_pass_over_a_missing_shard(
    octopi: Path, run: Any, tmp_path: Path
) -> None:
    _, dataset = run(octopi, "octopi")
    shard = next((tmp_path / "out").glob("episodes/*/*/streams/tactile/data/c/0"))
    shard.unlink()
    (unreadable,) = measure(dataset, workers=1).unreadable
    assert "shard is missing" in unreadable.reason


def test_a_dataset_that_another_run_is_making_is_taken_up(tmp_path: Path) -> None:
    (tmp_path / "set" / "episodes").mkdir(parents=True)
    (tmp_path / "set" / ".partial-1-dataset.json").write_text("{")
    metadata = DatasetMetadata(name="set", licence="CC0-1.0")
    assert create_dataset(tmp_path / "set", metadata).is_dir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="is no exUMI dataset"):
        create_dataset(tmp_path / "other", metadata)
