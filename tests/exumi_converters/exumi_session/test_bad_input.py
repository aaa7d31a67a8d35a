"""Sessions that something is wrong with: what can be read is converted, the rest is named."""

import json
import os
import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from exumi_converters import ConvertOptions, plan_conversion
from exumi_converters.exumi_session.camera_clock import infer_zone_s, stated_zone_s
from exumi_data.cli.options import Format
from exumi_data.cli.run_report import finish
from exumi_data.errors import SourceError, UsageError
from exumi_data.simulation.demonstrations import simulate_demonstrations
from exumi_data.simulation.gopro import SimulatedGoPro
from exumi_data.simulation.hub_session import HubSession
from exumi_data.standard import flags
from exumi_validators import validate
from tests.exumi_converters.exumi_session.conftest import Converted, run

HOUR = 3600


def mask(name: str) -> int:
    return int(flags()[name].mask)


def chunk_of(session: HubSession, second: float) -> int:
    """The number of the chunk in which a second of the session was saved."""
    return int(second // 5.0)


def test_one_bad_file_does_not_end_the_session(small: HubSession, tmp_path: Path) -> None:
    clips = sorted((small.root / "raw_videos").glob("*.MP4"))
    whole = clips[1].read_bytes()
    clips[1].write_bytes(whole[: len(whole) // 2])  # the index is at the end: nothing is left
    table = small.hub / f"angle_{chunk_of(small, 0.5 * sum(small.truth.spans_s[1]))}.json"
    table.write_text(table.read_text()[:700])
    number = chunk_of(small, small.truth.spans_s[0][0] + 1.0)
    short = small.hub / f"left_{number}.json"
    short.write_text(json.dumps(json.loads(short.read_text())[:-3]))
    cut = small.hub / f"right_{number}.mp4"
    cut.write_bytes(cut.read_bytes()[:1000])
    (small.root / "raw_videos" / "notes.txt").write_text("hello")
    (small.root / "realsense_20250322").mkdir()
    (small.root / "realsense_20250322" / "realsense_0.json").write_text("[]")
    report, dataset = run(small.root, tmp_path / "out")
    assert [failure.name for failure in report.failed] == [f"raw_videos/{clips[1].name}"]
    assert report.converted == 2
    said = "\n".join(report.notices)
    assert f"{table.name} was left out: no JSON: it is cut short" in said
    assert "2 other file(s), not read" in said
    codes = {note.code for episode in dataset for note in episode.metadata.quality}
    assert {"mismatched-counts", "unreadable-chunk"} <= codes
    assert [p.message for p in validate(dataset.path).problems if p.severity == "error"] == []


def test_a_clip_cut_after_its_index_keeps_its_frames(small: HubSession, tmp_path: Path) -> None:
    import av

    clip = min((small.root / "raw_videos").glob("*.MP4"))
    front = tmp_path / "front.mp4"
    with (
        av.open(str(clip)) as old,
        av.open(str(front), "w", options={"movflags": "faststart"}) as new,
    ):
        for key in ("creation_time",):
            new.metadata[key] = old.metadata[key]
        stream = new.add_stream_from_template(old.streams.video[0])
        data = new.add_data_stream("bin_data")
        data.time_base = old.streams.data[-1].time_base
        for packet in old.demux(old.streams.video[0], old.streams.data[-1]):
            if packet.size:
                packet.stream = stream if packet.stream.type == "video" else data
                new.mux(packet)
    raw = front.read_bytes()
    clip.write_bytes(raw[: len(raw) - 1500])
    report, dataset = run(small.root, tmp_path / "out")
    assert report.converted + len(report.failed) == 3
    keys = {str(episode.metadata.source.key) for episode in dataset}
    if f"raw_videos/{clip.name}" in keys:
        (episode,) = (e for e in dataset if str(e.metadata.source.key).endswith(clip.name))
        assert "truncated" in {note.code for note in episode.metadata.quality}


def test_mixed_rates(small: HubSession, tmp_path: Path) -> None:
    start, stop = small.truth.spans_s[2]
    name = max((small.root / "raw_videos").glob("*.MP4"))
    settings = small.settings
    SimulatedGoPro(rate=Fraction(24), clock_s=settings.zone_s + settings.camera_ahead_s).film(
        name, small.truth, (start, stop), session_start=settings.start
    )
    report, dataset = run(small.root, tmp_path / "out")
    assert report.converted == 3
    assert {episode["rgb"].metadata.nominal_rate for episode in dataset} == {"60000/1001", "24/1"}


def test_nothing_to_convert(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no session of an exUMI hub"):
        run(tmp_path / "empty", tmp_path / "out")
    hub = tmp_path / "s" / "tactile_20250322_214647"
    hub.mkdir(parents=True)
    report, _ = run(tmp_path / "s", tmp_path / "out")
    assert "there is no reading of the hub" in report.failed[0].reason
    (hub / "angle_0.json").write_text('{"angles": [], "data": [], "timestamps": []}')
    report, _ = run(tmp_path / "s", tmp_path / "out")
    assert "there is no reading of the hub" in report.failed[0].reason


def test_without_calibrations(small: HubSession, tmp_path: Path) -> None:
    (small.root / "gripper_calibration.json").unlink()
    report, dataset = run(small.root, tmp_path / "out")
    said = "\n".join(report.notices)
    assert "no calibration of the gripper" in said
    assert "no latency clip" in said
    for episode in dataset:
        width = episode["width"]
        assert np.isnan(np.asarray(width.data)).all()
        assert (np.asarray(width.flags) & mask("invalid")).all()
        assert len(np.unique(width.array("raw"))) > 10
        codes = {note.code for note in episode.metadata.quality}
        assert {"width-not-calibrated", "pose-latency-assumed"} <= codes
    assert [p.message for p in validate(dataset.path).problems if p.severity == "error"] == []
    named = tmp_path / "other.json"
    named.write_text('{"metadata": {"unit": "cm"}, "calibration": [[1, 2]]}')
    with pytest.raises(UsageError, match="no calibration of a gripper"):
        run(small.root, tmp_path / "out2", gripper=str(named))


def change(path: Path, name: str, index: int, value: object) -> None:
    document = json.loads(path.read_text())
    document[name][index] = value
    path.write_text(json.dumps(document))


def test_readings_that_cannot_be(small: HubSession, tmp_path: Path) -> None:
    start = small.truth.spans_s[0][0] + 1.0
    path = small.hub / f"angle_{chunk_of(small, start)}.json"
    change(path, "angles", 100, [10_086])
    change(path, "angles", 101, [3000])
    change(path, "data", 102, [0.0] * 7)
    document = json.loads(path.read_text())
    stamps = document["timestamps"]
    stamps[110], stamps[111] = stamps[111], stamps[110]
    document["data"][104][0] = float("nan")
    path.write_text(json.dumps(document))
    report, dataset = run(small.root, tmp_path / "out")
    assert report.converted == 3
    assert "the hub's clock went back 1 time(s)" in report.notices
    episode = min(dataset, key=lambda one: str(one.metadata.source.key))
    host = round(stamps[100] * 1e9)
    row = int(np.flatnonzero(episode["width"].array("time_host") == host)[0])
    width, pose = episode["width"], episode["pose"]
    marks, poses = np.asarray(width.flags), np.asarray(pose.flags)
    assert marks[row] & mask("invalid")
    assert np.isnan(width.data[row])
    assert marks[row + 1] & mask("out_of_range")
    assert np.isfinite(width.data[row + 1])
    assert poses[row + 2] & mask("invalid")
    assert poses[row + 4] & mask("invalid")
    assert marks[row + 11] & mask("time_nudged")
    assert (np.diff(np.asarray(width.time)) > 0).all()
    assert "out-of-range" in {note.code for note in episode.metadata.quality}
    assert [p.message for p in validate(dataset.path).problems if p.severity == "error"] == []


def test_chunks_that_are_there_twice(
    small: HubSession, small_converted: Converted, tmp_path: Path
) -> None:
    _, before = small_converted
    last = max(int(path.stem.removeprefix("angle_")) for path in small.hub.glob("angle_*.json"))
    for kind in ("angle_1.json", "left_1.json", "left_1.mp4"):
        name = kind.replace("_1.", f"_{last + 1}.")
        shutil.copy(small.hub / kind, small.hub / name)
    shutil.copy(small.hub / "right_0.json", small.hub / "right_00.json")
    report, after = run(small.root, tmp_path / "after")
    assert any("2 chunk(s) that repeat another one" in text for text in report.notices)
    counts = [
        sorted((str(e.metadata.source.key), name, len(e[name])) for e in d for name in e)
        for d in (before, after)
    ]
    assert counts[0] == counts[1]


def test_two_cameras(small: HubSession, tmp_path: Path) -> None:
    """One looks on from the table: its clips are not of the hand, and take no time from it."""
    settings = small.settings
    start, stop = small.truth.spans_s[0]
    other = simulate_demonstrations(2, seed=settings.seed + 77)
    folder = small.root / "demos" / "demo_C3501326042700_2025.03.22_21.46.50.123456"
    folder.mkdir(parents=True)
    SimulatedGoPro(clock_s=settings.zone_s).film(
        folder / "raw_video.mp4", other, (start, stop), session_start=settings.start
    )
    report, _ = run(small.root, tmp_path / "out")
    assert report.converted == 3
    assert [failure.name for failure in report.failed] == [f"demos/{folder.name}/raw_video.mp4"]
    assert "its place in the hub's recording is not certain" in report.failed[0].reason


def test_what_their_pipeline_moved(
    small: HubSession, small_converted: Converted, tmp_path: Path
) -> None:
    """Its demos/ hold the videos, raw_videos/ links to them: the same episodes."""
    _, before = small_converted
    for number, clip in enumerate(sorted((small.root / "raw_videos").glob("*.MP4"))):
        folder = small.root / "demos" / f"demo_C123_2025.03.22_21.46.5{number}.000000"
        folder.mkdir(parents=True)
        (folder / "aligned_arcap_poses.json").write_text("{}")
        moved = folder / "raw_video.mp4"
        clip.rename(moved)
        clip.symlink_to(Path("..") / moved.relative_to(small.root))
    report, after = run(small.root, tmp_path / "after")
    assert {e.id for e in before} == {e.id for e in after}
    assert any("3 product(s) of exUMI's pipeline" in text for text in report.notices)


def test_time_zones() -> None:
    assert stated_zone_s("+08:00", 0.0) == 8 * HOUR
    assert stated_zone_s("UTC-3:30", 0.0) == -12_600
    assert stated_zone_s("utc", 0.0) == 0
    assert stated_zone_s("Europe/Berlin", 1_742_650_000.0) == HOUR  # winter
    assert stated_zone_s("Europe/Berlin", 1_750_000_000.0) == 2 * HOUR
    for wrong in ("Mars/Base", "+25:00", "8"):
        with pytest.raises(UsageError, match="Invalid timezone"):
            stated_zone_s(wrong, 0.0)
    noon = 1_742_644_800.0
    span = (noon, noon + 1800.0)
    assert infer_zone_s([(20.0 * HOUR + 600, 10.0)], span) == 8 * HOUR
    assert infer_zone_s([(17.5 * HOUR + 600, 10.0), (17.5 * HOUR + 1750, 40.0)], span) == 19_800
    assert infer_zone_s([(20.0 * HOUR - 900, 10.0), (20.0 * HOUR + 4000, 10.0)], span) is None
    assert infer_zone_s([(20.0 * HOUR + 600, 10.0)], (noon, noon + 3 * HOUR)) is None
    assert infer_zone_s([], span) is None


def test_a_stated_zone_that_is_wrong_is_told(small: HubSession, tmp_path: Path) -> None:
    report, dataset = run(small.root, tmp_path / "out", timezone="Europe/Berlin")
    assert any("is not that of the clips" in text for text in report.notices)
    assert len(dataset) == 3


def test_without_telemetry(small: HubSession, tmp_path: Path) -> None:
    settings = small.settings
    for name, start in small.clips.items():
        camera = SimulatedGoPro(
            rate=settings.rgb_rate, clock_s=settings.zone_s + settings.camera_ahead_s
        )
        camera.film(
            small.root / name,
            small.truth,
            (start, start + 5.0),
            session_start=settings.start,
            telemetry=False,
        )
    report, _ = run(small.root, tmp_path / "refused")
    assert report.converted == 0
    assert all("it has no gyroscope" in failure.reason for failure in report.failed)
    report, dataset = run(small.root, tmp_path / "out", place_by_clock="yes")
    assert report.converted == 3
    for episode in dataset:
        assert "doubtful-place" in {note.code for note in episode.metadata.quality}
        assert float(episode["rgb"].metadata.clock.offset_sigma_ns or 0) > 0.9e9


def test_a_file_that_claims_too_much(small: HubSession, tmp_path: Path) -> None:
    (small.hub / "angle_0.json").write_text("[" * 100_000)
    (small.hub / "left_0.json").write_text("[" + "1," * 2_100_000 + "1]")
    (small.hub / "right_0.json").write_text('["a"]')
    report, _ = run(small.root, tmp_path / "out")
    assert report.converted == 3
    said = "\n".join(report.notices)
    for name in ("angle_0.json", "left_0.json", "right_0.json"):
        assert f"{name} was left out" in said


def test_a_hub_whose_clock_was_not_set(small: HubSession, tmp_path: Path) -> None:
    for name, kinds in (("angle_0.json", "timestamps"), ("left_0.json", None)):
        document = json.loads((small.hub / name).read_text())
        stamps = document if kinds is None else document[kinds]
        stamps[:] = [stamp - 1.7e9 for stamp in stamps]
        (small.hub / name).write_text(json.dumps(document))
    report, _ = run(small.root, tmp_path / "out")
    assert report.converted == 3
    assert any("stamped hours away from all others" in text for text in report.notices)


def test_a_folder_of_sessions(small: HubSession, tmp_path: Path) -> None:
    both = tmp_path / "task"
    for name in ("batch_1", "batch_2"):
        shutil.copytree(small.root, both / name)
    shutil.rmtree(both / "batch_2" / small.hub.name)
    (both / "batch_2" / small.hub.name).mkdir()
    plan = plan_conversion(both, from_format="exumi-session")
    assert [key.split("/")[0] for key in plan.episodes] == ["batch_1"] * 3
    assert [failure.name for failure in plan.failed] == ["batch_2"]


def test_dry_run_writes_nothing(small: HubSession, tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    plan = plan_conversion(small.root, from_format="exumi-session")
    assert len(plan.episodes) == 3
    assert sorted(tmp_path.rglob("*")) == before


def test_what_cannot_be_read_to_its_end_or_named(small: HubSession, tmp_path: Path) -> None:
    """Pipes, devices, links in circles, names that no text can hold, a calibration that is none."""
    clips = sorted((small.root / "raw_videos").glob("*.MP4"))
    for name in ("angle_0.json", "left_1.mp4"):
        (small.hub / name).unlink()
        os.mkfifo(small.hub / name)
    (small.hub / "right_1.json").unlink()
    (small.hub / "right_1.json").symlink_to("/dev/zero")
    circle = small.root / "raw_videos" / "circle.MP4"
    circle.symlink_to(circle)
    (small.root / "raw_videos" / "again").symlink_to(small.root)
    odd = clips[0].with_name("two\nlines.MP4")
    clips[0].rename(odd)
    (small.root / "gripper_calibration.json").write_text("[" * 2_000_000)
    report, dataset = run(small.root, tmp_path / "out")
    reasons = {failure.name: failure.reason for failure in report.failed}
    assert sorted(reasons) == ["raw_videos/circle.MP4", "raw_videos/two\nlines.MP4"]
    assert "symbolic links" in reasons["raw_videos/circle.MP4"]
    assert "its name cannot be recorded" in reasons["raw_videos/two\nlines.MP4"]
    assert any("gripper_calibration.json is not used" in text for text in report.notices)
    assert len(dataset) == 2
    assert [p.message for p in validate(dataset.path).problems if p.severity == "error"] == []


@pytest.mark.parametrize("decode", ["no", "yes"])
def test_a_finger_of_which_nothing_can_be_read(
    small: HubSession, tmp_path: Path, decode: str
) -> None:
    for path in small.hub.glob("left_*.mp4"):
        path.write_bytes(path.read_bytes()[:1000])
    for path in (small.root / "raw_videos").glob("*.MP4"):
        if path != min((small.root / "raw_videos").glob("*.MP4")):
            path.unlink()
    report, dataset = run(small.root, tmp_path / "out", decode=decode)
    assert report.converted == 1
    (episode,) = dataset
    assert "tactile_left" not in episode
    notes = {note.code: note for note in episode.metadata.quality}
    assert notes["unreadable-chunk"].message.startswith("left_")
    assert {note.stream for note in episode.metadata.quality} <= {None, *episode}
    assert [p.message for p in validate(dataset.path).problems if p.severity == "error"] == []


def test_how_large_a_decoded_session_will_be(small: HubSession, tmp_path: Path) -> None:
    sizes = {}
    for decode in ("no", "yes"):
        options = ConvertOptions(settings={"decode": decode})
        plan = plan_conversion(small.root, from_format="exumi-session", options=options)
        sizes[decode] = plan.estimated_bytes
    run(small.root, tmp_path / "out", decode="yes")
    written = sum(path.stat().st_size for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert 2 * sizes["no"] < written < 2 * sizes["yes"] < 12 * written


def test_two_notes_of_one_episode_are_of_one_episode(
    small_converted: Converted, capsys: pytest.CaptureFixture[str]
) -> None:
    report, dataset = small_converted
    finish(report, output=Format.TEXT, quiet=True, keep_going=False)
    said = capsys.readouterr().out
    notes = [flag.name for flag in report.flagged if flag.code == "repeated-frames"]
    assert len(notes) > len(set(notes))  # both fingers
    assert f"info repeated-frames: {len(dataset)} episodes" in said
