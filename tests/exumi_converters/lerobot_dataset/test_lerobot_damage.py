"""Bad datasets: each fault is told for its episode, and the others are read."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from exumi_converters import ConversionReport, ConvertOptions, convert, plan_conversion
from exumi_data.dataset import open_dataset
from exumi_data.errors import ExumiError, SourceError
from exumi_data.store import parquet_limits
from tests.exumi_converters.lerobot_dataset.theirs import (
    EPISODES,
    FRONT,
    ROWS,
    Theirs,
    edit_info,
    edit_rows,
    write_theirs,
    write_video,
)

Change = Callable[[Path], object]
Rows = list[dict[str, Any]]
FRONT_FILE = f"videos/{FRONT}/chunk-000/file-000.mp4"


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_theirs(tmp_path_factory.mktemp("sound") / "theirs", Theirs(videos=(FRONT,)))


@pytest.fixture
def source(sound: Path, tmp_path: Path) -> Path:
    shutil.copytree(sound, tmp_path / "theirs")
    return tmp_path / "theirs"


def run(source: Path) -> ConversionReport:
    options = ConvertOptions(workers=1, durable=False)
    return convert(source, source.parent / "read", options=options)


def of_episode(number: int, change: Callable[[dict[str, Any]], object]) -> Callable[[Rows], None]:
    def edit(rows: Rows) -> None:
        for row in rows:
            if row["episode_index"] == number:
                change(row)

    return edit


def rows(number: int, change: Callable[[dict[str, Any]], object]) -> Change:
    return lambda source: edit_rows(source, of_episode(number, change))


def table(number: int, change: Callable[[dict[str, Any]], object]) -> Change:
    return lambda source: edit_rows(source, of_episode(number, change), EPISODES)


def begins_at(seconds: float) -> Callable[[dict[str, Any]], object]:
    return lambda row: row.update({f"videos/{FRONT}/from_timestamp": seconds})


def drop_rows(source: Path) -> None:
    edit_rows(source, lambda found: found.__delitem__(slice(14, 17)))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (drop_rows, "holds 12 rows of the episode, which has 15 frames"),
        (rows(1, lambda row: row.update(frame_index=row["frame_index"] * 2)), "not numbered 0 to"),
        (rows(1, lambda row: row.update(episode_index=7)), "holds no row of episode 1"),
        (table(1, lambda row: row.update(length=14)), r"14 frames and rows 12 to 27"),
        (table(1, lambda row: row.update({"data/file_index": 3})), "file-003.parquet is missing"),
        (
            table(1, lambda row: row.update({f"videos/{FRONT}/from_timestamp": 99.0})),
            "(holds|cannot|no frame)",
        ),
        *(
            (table(1, begins_at(at)), "no time at which it begins")
            for at in (float("nan"), float("inf"), -1.0, 1e300)
        ),
    ],
)
def test_one_bad_episode_is_named_and_the_others_are_read(
    source: Path, change: Change, reason: str
) -> None:
    change(source)
    report = run(source)
    assert [failure.name for failure in report.failed] == ["episode_000001"]
    assert re.search(reason, report.failed[0].reason), report.failed
    assert report.converted == 2


def of_all(change: Callable[[dict[str, Any]], object]) -> Change:
    return lambda source: edit_rows(source, lambda found: [change(row) for row in found])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (of_all(lambda row: row.update(episode_index=str(row["episode_index"]))), "as Parquet"),
        (of_all(lambda row: row.update(frame_index=None)), "'frame_index' holds"),
        (of_all(lambda row: row.update(timestamp="now")), "'timestamp' holds"),
        (of_all(lambda row: row["observation.state"].pop()), "has 7 numbers, fewer than"),
        (rows(0, lambda row: row["observation.state"].pop(row["frame_index"] % 8)), None),
        (of_all(lambda row: row.pop("index")), "has no column 'index'"),
        (rows(0, lambda row: row["observation.state"].extend([0] * row["frame_index"])), "differ"),
    ],
)
def test_rows_of_other_types_end_in_a_message(
    source: Path, change: Change, reason: str | None
) -> None:
    change(source)
    report = run(source)
    assert report.failed
    assert not [failure for failure in report.failed if "defect" in failure.reason]
    assert reason is None or reason in report.failed[0].reason


def test_texts_of_any_length_and_lines_become_tasks(source: Path) -> None:
    text = "lift\nthe " + "very " * 100 + "cup"
    edit_rows(source, of_episode(0, lambda row: row.update(tasks=[text])), EPISODES)
    edit_info(source, lambda info: info.update(robot_type="an\narm"))
    assert not run(source).failed
    episodes = {e.metadata.source.key: e for e in open_dataset(source.parent / "read")}
    metadata = episodes["episode_000000"].metadata
    assert metadata.task.instruction == text
    assert metadata.task.name.startswith("lift the very")
    assert metadata.device is not None
    assert metadata.device.name == "an arm"


def test_pictures_that_two_episodes_claim_are_given_to_neither(source: Path) -> None:
    # A merge that forgot to move the second's place in the video.
    table(1, lambda row: row.update({f"videos/{FRONT}/from_timestamp": 0.0}))(source)
    report = run(source)
    assert {f.name for f in report.failed} == {"episode_000000", "episode_000001"}
    assert all("claim the same frames" in failure.reason for failure in report.failed)
    assert report.converted == 1


def test_two_rows_of_one_number_are_refused(source: Path) -> None:
    edit_rows(source, lambda found: found[2].update(episode_index=1), EPISODES)
    report = run(source)
    assert [failure.name for failure in report.failed] == ["episode_000001"]
    assert "2 rows of the table bear its number" in report.failed[0].reason


def test_wrong_running_numbers_are_noted_and_do_no_harm(source: Path) -> None:
    rows(2, lambda row: row.update(index=row["index"] - 20))(source)
    report = run(source)
    assert not report.failed
    assert {flag.name for flag in report.flagged if flag.code == "wrong-index"} == {
        "episode_000002"
    }


@pytest.mark.parametrize(("off_s", "noted"), [(0.8e-4, False), (1.3e-4, True)])
def test_timestamps_are_held_to_lerobots_tolerance(source: Path, off_s: float, noted: bool) -> None:
    rows(1, lambda row: row.update(timestamp=row["timestamp"] + off_s))(source)
    report = run(source)
    assert not report.failed
    assert ("timestamps-off" in {flag.code for flag in report.flagged}) is noted
    times = {e.metadata.source.key: e["pose"].time for e in open_dataset(source.parent / "read")}
    np.testing.assert_allclose(times["episode_000001"], np.arange(15) / 30 * 1e9, atol=1)


def test_a_missing_video_is_told_before_anything_is_written(source: Path) -> None:
    (source / FRONT_FILE).unlink()
    plan = plan_conversion(source)
    assert len(plan.failed) == 3
    assert plan.failed[0].reason == f"{FRONT_FILE} is missing"


def test_a_video_with_too_few_frames_is_refused(source: Path) -> None:
    write_video(source / FRONT_FILE, Theirs(lengths=(12, 15, 8)))
    report = run(source)
    assert [failure.name for failure in report.failed] == ["episode_000002"]
    assert "holds 8 frames of the episode, which has 11" in report.failed[0].reason


def test_a_video_of_another_rate_is_refused(source: Path) -> None:
    write_video(source / FRONT_FILE, Theirs(fps=25))
    report = run(source)
    assert report.converted == 0
    assert all("frames" in failure.reason for failure in report.failed)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_truncated_video_is_refused(source: Path, share: float) -> None:
    path = source / FRONT_FILE
    raw = path.read_bytes()
    path.write_bytes(raw[: int(len(raw) * share)])
    report = run(source)
    assert len(report.failed) == 3
    assert not [failure for failure in report.failed if "defect" in failure.reason]


@pytest.mark.parametrize("name", [ROWS, EPISODES, "meta/tasks.parquet", "meta/info.json"])
@pytest.mark.parametrize("how", ["cut", "empty", "noise"])
def test_damaged_documents_end_in_a_message(source: Path, name: str, how: str) -> None:
    path = source / name
    raw = path.read_bytes()
    noise = np.random.default_rng(3).integers(0, 255, 200).astype(np.uint8).tobytes()
    path.write_bytes({"cut": raw[: len(raw) // 2], "empty": b"", "noise": raw[:99] + noise}[how])
    try:
        report = convert(
            source,
            source.parent / "read",
            from_format="lerobot",
            options=ConvertOptions(workers=1, durable=False),
        )
    except ExumiError:
        return
    assert not [failure for failure in report.failed if "defect" in failure.reason]
    assert report.failed


@pytest.mark.parametrize(
    "path",
    [
        "../../etc/passwd",
        "/etc/passwd",
        "data/{chunk_index.__class__}/x",
        "data/{chunk_index!r}.parquet",
        "data/{video_key}/../../../x",
        "",
    ],
)
def test_paths_that_lead_out_are_refused(source: Path, path: str) -> None:
    edit_info(source, lambda info: info.update(data_path=path))
    plan = plan_conversion(source)
    assert len(plan.failed) == 3
    assert all("leads out of the dataset" in failure.reason for failure in plan.failed)


@pytest.mark.parametrize(
    "change",
    [
        {"fps": 0},
        {"fps": float("inf")},
        {"fps": 1e-300},
        {"robot_type": "half a \ud83d"},
        {"features": {"a": {"dtype": "float32", "shape": [10**12]}}},
        {"features": {"a": {"dtype": "float32", "shape": [-1]}}},
        {"fps": "many"},
        {"features": []},
        {"features": {"a": {"dtype": "float32"}}},
        {"codebase_version": 3},
    ],
)
def test_a_document_that_says_nonsense_is_refused(source: Path, change: dict[str, Any]) -> None:
    edit_info(source, lambda info: info.update(change))
    with pytest.raises(ExumiError):
        plan_conversion(source, from_format="lerobot")


def test_rows_that_would_fill_the_memory_are_not_read(
    source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Half a gigabyte takes seconds to write; the limit is what is tried here.
    monkeypatch.setattr(parquet_limits, "MAX_TABLE_BYTES", 1 << 20)
    edit_rows(source, lambda found: found.extend(found[-1:] * 40_000))
    assert (source / ROWS).stat().st_size < 1 << 19
    report = run(source)
    assert len(report.failed) == 3
    assert "more memory" in report.failed[0].reason


def test_files_that_no_episode_uses_are_named(source: Path) -> None:
    (source / "videos/old.mp4").write_bytes(b"x")
    (source / "README.md").write_text("a card")
    notices = plan_conversion(source).notices
    assert any("1 file(s) that no episode uses, not read: videos/old.mp4" in n for n in notices)


def test_a_table_that_counts_otherwise_than_the_document_is_said(source: Path) -> None:
    edit_info(source, lambda info: info.update(total_episodes=9))
    assert "meta/info.json says 9 episodes, the table has 3" in plan_conversion(source).notices


def test_links_into_a_cache_are_followed(source: Path, tmp_path: Path) -> None:
    # As in the cache of the Hugging Face Hub, where every file is a link.
    blobs = tmp_path / "blobs"
    blobs.mkdir()
    for number, name in enumerate((ROWS, FRONT_FILE, "meta/info.json")):
        (source / name).rename(blobs / str(number))
        (source / name).symlink_to(blobs / str(number))
    assert run(source).converted == 3


def test_pictures_at_other_times_than_rows_are_refused_or_noted(tmp_path: Path) -> None:
    for slow, expected in ((1.002, "noted"), (1.1, "refused")):
        source = write_theirs(
            tmp_path / expected / "theirs", Theirs(lengths=(20,), videos=(FRONT,))
        )
        _stretch(source / FRONT_FILE, slow)
        report = run(source)
        if expected == "noted":
            assert {f.code for f in report.flagged} >= {"timestamps-off"}
        else:
            assert "nothing says which belongs to which row" in report.failed[0].reason


def _stretch(path: Path, factor: float) -> None:
    """Write a video again whose frames lie farther apart."""
    out = path.with_suffix(".new.mp4")
    with av.open(str(path)) as old, av.open(str(out), "w") as new:
        stream = new.add_stream_from_template(old.streams.video[0])
        for packet in old.demux(old.streams.video[0]):
            if packet.pts is not None and packet.dts is not None:
                packet.pts, packet.dts = round(packet.pts * factor), round(packet.dts * factor)
                packet.stream = stream
                new.mux(packet)
    out.rename(path)


def test_json_is_not_believed_blindly(source: Path) -> None:
    info = json.loads((source / "meta/info.json").read_text())
    (source / "meta/info.json").write_text(json.dumps(info)[:-1] + "," + " " * (17 << 20) + "}")
    with pytest.raises(ExumiError):
        plan_conversion(source, from_format="lerobot")


def test_a_length_that_nothing_has_is_told_without_the_memory_for_it(source: Path) -> None:
    table(2, lambda row: row.update(length=2**50, dataset_to_index=2**50 + 27))(source)
    report = run(source)
    assert [failure.name for failure in report.failed] == ["episode_000002"]
    assert "11 rows of the episode, which has 1125899906842624 frames" in report.failed[0].reason


def test_numbers_of_episodes_that_are_not_whole_are_told(source: Path) -> None:
    edit_rows(source, lambda found: [row.update(length=float("nan")) for row in found], EPISODES)
    with pytest.raises(SourceError, match="'length' holds what is no whole number"):
        run(source)


def test_texts_that_are_none_are_told(source: Path) -> None:
    path = source / "meta/tasks.parquet"
    raw = pq.read_table(path)
    column = pa.array([b"\xff\xfe"] * raw.num_rows, pa.binary()).view(pa.string())
    name = next(name for name in raw.column_names if name != "task_index")
    pq.write_table(raw.set_column(raw.column_names.index(name), name, column), path)
    with pytest.raises(SourceError, match="holds what is no text"):
        run(source)
