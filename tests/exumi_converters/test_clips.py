"""Folders of videos with tables: bytes are kept, rows meet frames, and what is wrong is said."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from exumi_converters import ConversionReport, ConvertOptions, convert
from exumi_data.dataset import Dataset
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import EncodedImages, TactileStream, WrenchStream

Run = Callable[..., tuple[ConversionReport, Dataset]]


def packets(path: Path) -> list[bytes]:
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


def table(rows: int, header: str = "frame,force_N,width_m") -> str:
    lines = [f"{i},{0.25 + 0.5 * i},{0.05 - 0.001 * i:.6f}" for i in range(rows)]
    return "\n".join([header, *lines]) + "\n"


@pytest.fixture
def grasps(tmp_path: Path, make_clip: Any) -> Path:
    """Two grasps with a table, one clip without."""
    root = tmp_path / "grasps"
    for index, name in enumerate(("2023/golf_ball_3", "2024/bolt__t=2", "2024/sweep")):
        make_clip(root / f"{name}.avi", 20, rate="30", codec="mjpeg", seed=index)
        if name != "2024/sweep":
            (root / f"{name}.csv").write_text(table(20))
    return root


def test_every_frame_is_the_packet_of_the_file(grasps: Path, run: Run) -> None:
    report, dataset = run(grasps, "clips")
    assert (report.converted, report.frames, report.failed) == (3, 60, ())
    assert report.layout == "clips: 3 video(s), 2 of them with a table"
    for episode in dataset:
        original = packets(grasps / str(episode.metadata.source.key))
        stream = episode["tactile"]
        assert [stream.encoded(i) for i in range(len(stream))] == original
        for index in (0, 7, 19):
            image = cv2.imdecode(np.frombuffer(original[index], np.uint8), cv2.IMREAD_COLOR)
            assert image is not None
            assert np.abs(stream.frames[index].astype(int) - image[..., ::-1]).max() <= 2


def test_the_encoder_that_the_jpegs_name_is_on_record(grasps: Path, run: Run) -> None:
    _, dataset = run(grasps, "clips")
    for episode in dataset:
        model = episode["tactile"].metadata
        assert isinstance(model, TactileStream)
        images = model.images
        assert isinstance(images, EncodedImages)
        assert str(images.jpeg_comment).startswith("Lavc")
        (step,) = episode.metadata.source.lossy or []
        assert (step.step, step.stream) == ("jpeg-encode", "tactile")
        assert step.by == f"FFmpeg ({images.jpeg_comment})"
        assert "at capture, before this conversion" in step.detail


def test_times_force_and_width_of_each_frame(grasps: Path, run: Run) -> None:
    _, dataset = run(grasps, "clips", sensor="gelsight-wedge", pad_type="dotted")
    episode = next(e for e in dataset if e.metadata.source.key == "2023/golf_ball_3.avi")
    times = [round(i * 1e9 / 30) for i in range(20)]
    assert episode["tactile"].time.tolist() == times
    assert episode["tactile"].metadata.nominal_rate == "30/1"
    assert episode["tactile"].metadata.clock.stamp_point == "nominal_rate"
    for name in ("force", "width"):
        assert episode[name].time.tolist() == times
        assert episode[name].metadata.clock == episode["tactile"].metadata.clock
        assert episode[name].metadata.nominal_rate == "30/1"
    force = episode["force"].metadata
    assert isinstance(force, WrenchStream)
    assert (force.kind, force.components) == ("wrench", ["f_grip"])
    assert np.array_equal(
        episode["force"].data, np.array([[0.25 + 0.5 * i] for i in range(20)], np.float32)
    )
    expected = np.array([round(0.05 - 0.001 * i, 6) for i in range(20)], np.float32)
    assert np.array_equal(episode["width"].data, expected)
    about = episode.metadata.annotations
    assert about is not None
    assert (about.object_id, about.trial, about.pad_type) == ("golf_ball", 3, "dotted")
    assert episode["tactile"].metadata.sensor is not None
    assert episode.metadata.regime == "touch"
    assert [i.name for i in episode.metadata.source.inputs or []] == [
        "2023/golf_ball_3.avi",
        "2023/golf_ball_3.csv",
    ]


def test_object_and_trial_come_from_the_name_or_are_unknown(grasps: Path, run: Run) -> None:
    _, dataset = run(grasps, "clips")
    found = {}
    for episode in dataset:
        about = episode.metadata.annotations
        found[episode.metadata.source.key] = about and (about.object_id, about.trial)
    assert found == {
        "2023/golf_ball_3.avi": ("golf_ball", 3),
        "2024/bolt__t=2.avi": ("bolt", 2),
        "2024/sweep.avi": None,
    }


def test_a_wrench_of_six_components(tmp_path: Path, make_clip: Any, run: Run) -> None:
    make_clip(tmp_path / "in" / "a.avi", 6, codec="mjpeg")
    header = "tz_Nm,fx_N,fy_N,fz_N,tx_Nm,ty_Nm"
    rows = [",".join(str(10 * r + c) for c in range(6)) for r in range(6)]
    (tmp_path / "in" / "a.CSV").write_text("\n".join([header, *rows]) + "\n")
    _, dataset = run(tmp_path / "in", "clips")
    model = dataset[0]["wrench"].metadata
    assert isinstance(model, WrenchStream)
    assert model.components == ["fx", "fy", "fz", "tx", "ty", "tz"]
    assert dataset[0]["wrench"].data[2].tolist() == [21, 22, 23, 24, 25, 20]


def test_other_codecs_are_kept_as_files_and_may_be_a_camera(
    tmp_path: Path, make_clip: Any, run: Run
) -> None:
    path = make_clip(tmp_path / "in" / "view_0.mp4", 24, rate="30000/1001")
    _, dataset = run(tmp_path / "in", "clips", stream="rgb_front", kind="rgb")
    (episode,) = dataset
    stream = episode["rgb_front"]
    assert stream.kind == "rgb"
    assert stream.container(0) == path.read_bytes()
    assert stream.metadata.nominal_rate == "30000/1001"
    assert (stream.reference, stream.activity, stream.salient) == (None, None, None)
    assert episode.derived is None
    # A camera has no activity; a second run finds nothing missing nevertheless.
    report, _ = run(tmp_path / "in", "clips", stream="rgb_front", kind="rgb")
    assert (report.converted, report.skipped) == (0, 1)


def test_columns_that_are_not_understood_are_named_twice(grasps: Path, run: Run) -> None:
    path = grasps / "2023" / "golf_ball_3.csv"
    rows = path.read_text().splitlines()
    extra = [f"{row},{'width_mm,force' if i == 0 else '50,1'}" for i, row in enumerate(rows)]
    path.write_text("\n".join(extra) + "\n")
    report, dataset = run(grasps, "clips")
    (notice,) = report.notices
    assert "width_mm (1 tables), force (1 tables) not converted" in notice
    assert "Understood are: frame, force_N" in notice
    episode = next(e for e in dataset if e.metadata.source.key == "2023/golf_ball_3.avi")
    steps = [step for step in episode.metadata.source.lossy or [] if step.step == "drop-columns"]
    assert "width_mm, force not converted" in steps[0].detail
    assert sorted(episode.streams) == ["force", "tactile", "width"]


def test_numbers_that_float32_rounds_are_on_record(grasps: Path, run: Run) -> None:
    path = grasps / "2023" / "golf_ball_3.csv"
    path.write_text(path.read_text().replace("0,0.25,", "0,123.456789,"))
    _, dataset = run(grasps, "clips")
    steps = {
        episode.metadata.source.key: [s.step for s in episode.metadata.source.lossy or []]
        for episode in dataset
    }
    assert steps["2023/golf_ball_3.avi"] == ["jpeg-encode", "round-float32"]
    assert steps["2024/bolt__t=2.avi"] == ["jpeg-encode"]


def test_orphans_and_foreign_files_are_named(grasps: Path, run: Run) -> None:
    (grasps / "2023" / "lost.csv").write_text(table(3))
    (grasps / "notes.txt").write_text("x")
    report, _ = run(grasps, "clips")
    assert report.notices == (
        "1 table(s) without a video of the same name: 2023/lost.csv",
        "1 file(s) that are no video and no table, not read: notes.txt",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table(19), "the table has 19 rows, the video 20 frames"),
        (table(21), "the table has 21 rows, the video 20 frames"),
        (table(20).replace("4,2.25,", "4,abc,"), "row 5: force_N is 'abc', not a number"),
        (table(20).replace("4,2.25,", "4,,"), "row 5: force_N is '', not a number"),
        (table(20).replace("4,2.25,", "4,inf,"), "row 5: force_N is 'inf', not a number"),
        (table(20).replace("4,2.25,", "4,2.25,7,"), "row 5: 4 cells, the header has 3"),
        (table(20).replace("\n4,", "\n5,"), "row 5: frame is '5', expected 4"),
        (table(20).replace("width_m", "force_N"), "column 'force_N' for the second time"),
        ("", "the table is empty"),
        (table(20).replace(",", ";"), "the columns are separated by ';', not by commas"),
    ],
)
def test_a_table_that_is_wrong_fails_by_name_and_nothing_is_written(
    grasps: Path, run: Run, text: str, message: str
) -> None:
    (grasps / "2023" / "golf_ball_3.csv").write_text(text)
    report, dataset = run(grasps, "clips")
    (failure,) = report.failed
    assert failure.name == "2023/golf_ball_3.avi"
    assert message in failure.reason
    assert "golf_ball_3.csv" in failure.reason
    assert (report.total, len(dataset)) == (3, 2)


def test_a_damaged_frame_leaves_a_gap_and_the_rows_stay_with_their_frames(
    grasps: Path, run: Run
) -> None:
    path = grasps / "2023" / "golf_ball_3.avi"
    content = path.read_bytes()
    broken = packets(path)[4]
    at = content.index(broken)
    path.write_bytes(content[:at] + bytes(len(broken)) + content[at + len(broken) :])
    report, dataset = run(grasps, "clips")
    episode = next(e for e in dataset if e.metadata.source.key == "2023/golf_ball_3.avi")
    times = [round(i * 1e9 / 30) for i in range(20)]
    assert episode["tactile"].time.tolist() == times[:4] + times[5:]
    assert [(gap.after, gap.lost) for gap in episode["tactile"].metadata.gaps or []] == [(3, 1)]
    assert episode["force"].time.tolist() == times
    assert episode["force"].metadata.gaps is None
    assert {flag.code for flag in report.flagged} >= {"damaged-frames"}
    activity = episode["tactile"].activity
    assert activity is not None
    assert activity.shape == (19,)


def test_a_cut_file_without_a_table_is_converted_and_flagged(grasps: Path, run: Run) -> None:
    path = grasps / "2024" / "sweep.avi"
    content = path.read_bytes()
    path.write_bytes(content[: content.index(packets(path)[12]) + 700])
    report, dataset = run(grasps, "clips")
    episode = next(e for e in dataset if e.metadata.source.key == "2024/sweep.avi")
    assert len(episode["tactile"]) == 12
    flagged = [flag for flag in report.flagged if flag.code == "truncated"]
    assert {flag.name for flag in flagged} == {"2024/sweep.avi"}
    assert any("declares 20 frames" in flag.message for flag in flagged)


def test_a_dataset_inside_the_source_is_not_read(grasps: Path, run: Run) -> None:
    run(grasps, "clips", to="grasps/converted")
    report, _ = run(grasps, "clips", to="grasps/converted")
    assert (report.total, report.skipped, report.notices) == (3, 3, ())


def test_links_are_followed_but_not_for_ever(grasps: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "linked").symlink_to(grasps / "2023")
    (grasps / "2023" / "up").symlink_to(tmp_path / "in")
    report, _ = run(tmp_path / "in", "clips")
    assert (report.total, report.failed) == (1, ())


def test_options_that_make_no_sense_are_refused(grasps: Path, tmp_path: Path) -> None:
    options = ConvertOptions(labels=tmp_path / "labels.csv")
    with pytest.raises(UsageError, match="takes no table of labels"):
        convert(grasps, tmp_path / "out", from_format="clips", options=options)
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no video found among 0"):
        convert(tmp_path / "empty", tmp_path / "out", from_format="clips")
    with pytest.raises(UsageError, match=r"Invalid format \(bag\). Supported values are clips"):
        convert(grasps, tmp_path / "out", from_format="bag")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [({"stream": "../evil"}, "stream name"), ({"rate": "abc"}, "rate"), ({"rate": "0"}, "rate")],
)
def test_an_option_that_is_none_is_refused_before_anything_is_written(
    grasps: Path, run: Run, tmp_path: Path, options: dict[str, str], message: str
) -> None:
    with pytest.raises(UsageError, match=f"Invalid {message}"):
        run(grasps, "clips", **options)
    assert not (tmp_path / "out").exists()
