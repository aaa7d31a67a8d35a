"""Which format a source has: said with its reason, refused when nobody can know."""

from pathlib import Path

import pytest

from exumi_converters import ConvertOptions, convert, converters, plan_conversion
from exumi_converters.clips import ClipsConverter
from exumi_converters.detection import detect_format
from exumi_data.dataset import create_dataset
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import DatasetMetadata


def test_a_raw_tree_is_octopis(raw_tree: Path) -> None:
    with pytest.raises(UsageError, match=r"more than one format: clips .*; octopi .*--from"):
        detect_format(raw_tree, converters())


def test_samples_are_recognised_with_the_reason(samples: Path, tmp_path: Path) -> None:
    name, reason = detect_format(samples, converters())
    assert name == "octopi"
    assert "Octopi-1.5" in reason
    report = convert(samples, tmp_path / "out", options=ConvertOptions(workers=1))
    assert report.converter.startswith("octopi/")
    assert any(line.startswith("read as octopi") for line in report.notices)


def test_videos_of_any_name_are_clips(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "bolt.mp4").write_bytes(b"")
    assert detect_format(tmp_path, converters())[0] == "clips"


def test_a_session_of_exumi_is_no_folder_of_clips(tmp_path: Path) -> None:
    hub = tmp_path / "task" / "batch_1" / "tactile_20250322_214647"
    hub.mkdir(parents=True)
    (hub / "left_0.mp4").write_bytes(b"")
    (hub.parent / "raw_videos").mkdir()
    (hub.parent / "raw_videos" / "GX010001.MP4").write_bytes(b"")
    for source in (hub.parent, tmp_path / "task"):
        name, reason = detect_format(source, converters())
        assert (name, "tactile_20250322_214647" in reason or "batch_1" in reason) == (
            "exumi-session",
            True,
        )
    # Its videos alone are clips like any others.
    assert detect_format(hub.parent / "raw_videos", converters())[0] == "clips"


def test_nothing_known_is_refused_with_what_is_known(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(SourceError, match=r"no format is recognised.*clips \(any folder of"):
        detect_format(tmp_path, converters())
    with pytest.raises(SourceError, match="no such file"):
        detect_format(tmp_path / "nowhere", converters())


def test_a_dataset_of_ours_is_sent_to_the_other_direction(tmp_path: Path) -> None:
    create_dataset(tmp_path / "ours", DatasetMetadata(name="ours", licence="CC0-1.0"))
    with pytest.raises(UsageError, match=r"an exUMI dataset already.*--to FORMAT"):
        detect_format(tmp_path / "ours", converters())


def test_a_plan_says_what_would_be_written_and_writes_nothing(octopi: Path) -> None:
    before = sorted(octopi.rglob("*"))
    plan = plan_conversion(octopi, from_format="octopi")
    assert len(plan.episodes) == 5
    size = sum(path.stat().st_size for path in octopi.iterdir())
    assert plan.estimated_bytes == size
    assert plan.keeps
    assert plan.loses
    assert sorted(octopi.rglob("*")) == before


def test_a_plan_is_refused_as_the_conversion_is(octopi: Path) -> None:
    wrong = ConvertOptions(settings={"speed": "high"})
    with pytest.raises(UsageError, match=r"there is no option 'speed'. Options of octopi: none"):
        plan_conversion(octopi, from_format="octopi", options=wrong)


def test_a_format_that_fails_to_look_is_named(tmp_path: Path) -> None:
    class Broken(ClipsConverter):
        def recognise(self, source: Path) -> str | None:
            raise KeyError("oops")

    with pytest.raises(SourceError, match=r"the format 'broken' fails to look at it \(KeyError"):
        detect_format(tmp_path, {"broken": Broken()})


def test_a_source_that_cannot_even_be_looked_for_is_told(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"cannot be read \(File name too long\)"):
        convert("a" * 5000, tmp_path / "out")
    with pytest.raises(SourceError, match=r"cannot be read \(File name too long\)"):
        convert("a" * 5000, tmp_path / "out", from_format="lerobot")
