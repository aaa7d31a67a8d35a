"""Defects of the pipeline that exUMI released, by number: each test would fail on its output.

1 differences of tactile frames wrap in uint8; 2 quaternions interpolated by component; 3 gaps
interpolated, ends clamped; 4 the camera's clock read in this machine's time zone, midnight; 5 one
latency for all streams; 6 a latency accepted unchecked; 7 tactile frames blended; 8 lossy stages,
raw not kept; 9 the first frame as reference; 10 failures swallowed, the shorter finger decides;
11 59.94 written as 59; 12 ground truth smoothed; 15 pickles; 16 repeated frames; 17 the wrap of the
encoder. 13, 14 and 18 are of training and of memory.
"""

import hashlib
import json
import shutil
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from exumi_data.geometry import interpolate_poses
from exumi_data.simulation.hub_session import HubSession, HubSettings, simulate_hub_session
from exumi_data.standard import flags
from exumi_data.tactile import ActivityMeter, to_grey
from tests.exumi_converters.exumi_session.conftest import Converted, run
from tests.exumi_converters.exumi_session.truths import numbers_of, session_s

SIDES = ("left", "right")


def change_angles(path: Path, **lists: object) -> None:
    document = json.loads(path.read_text())
    document.update(lists)
    path.write_text(json.dumps(document))


def mask(name: str) -> int:
    return int(flags()[name].mask)


def test_1_7_8_tactile_frames_are_kept_as_the_hub_wrote_them(
    whole: HubSession, converted: Converted
) -> None:
    written = {hashlib.sha256(path.read_bytes()).hexdigest() for path in whole.hub.glob("*.mp4")}
    for episode in converted[1]:
        for side in SIDES:
            images = episode[f"tactile_{side}"].metadata.images  # type: ignore[attr-defined]  # tactile
            assert {file.sha256 for file in images.files} <= written
        steps = episode.metadata.source.lossy or []
        assert {step.step for step in steps} == {"video-encode"}
        assert all("hub" in step.detail or "camera" in step.detail for step in steps)


def test_2_signs_of_quaternions_do_not_matter(small: HubSession, tmp_path: Path) -> None:
    for path in small.hub.glob("angle_*.json"):
        poses = np.array(json.loads(path.read_text())["data"])
        poses[::2, 3:] *= -1.0
        change_angles(path, data=poses.tolist())
    _, dataset = run(small.root, tmp_path / "out")
    for episode in dataset:
        pose = episode["pose"]
        data = np.asarray(pose.data)
        assert (np.sum(data[1:, 3:] * data[:-1, 3:], axis=1) > 0.9).all()
        between = np.asarray(pose.time)[:-1] + np.diff(pose.time) // 2
        found, _ = interpolate_poses(pose.time, data, between, 100_000_000)
        assert np.allclose(np.linalg.norm(found[:, 3:], axis=1), 1.0)
        age_ns = round(1e9 * small.settings.pose_latency_s) - pose.metadata.clock.latency_ns
        true = small.truth.pose(session_s(episode, small, between - age_ns))
        assert np.abs(np.sum(found[:, 3:] * true[:, 3:], axis=1)).min() > 0.999


def test_3_gaps_stay_gaps(small: HubSession, tmp_path: Path) -> None:
    start, stop = small.truth.spans_s[1]
    number = int(0.5 * (start + stop) // 5.0)
    path = small.hub / f"angle_{number}.json"
    document = json.loads(path.read_text())
    stall = slice(40, 85)  # a second and a half in which the hub was busy
    for values in document.values():
        del values[stall]
    path.write_text(json.dumps(document))
    (small.hub / f"left_{number}.mp4").unlink()
    _, dataset = run(small.root, tmp_path / "out")
    reasons = set()
    for episode in dataset:
        for name in ("pose", "width", "tactile_left"):
            stream = episode[name]
            for gap in stream.metadata.gaps or []:
                edges = np.asarray(stream.time)[[gap.after, gap.after + 1]]
                assert edges[1] - edges[0] > 1_400_000_000
                assert np.asarray(stream.flags)[gap.after + 1] & mask("gap_before")
                reasons.add((name, gap.reason))
                if name == "pose":
                    ticks = np.arange(edges[0], edges[1], 33_000_000)[1:-1]
                    _, valid = interpolate_poses(
                        stream.time, np.asarray(stream.data), ticks, 250_000_000
                    )
                    assert not valid.any()
    assert reasons >= {
        ("pose", "no sample came"),
        ("width", "no sample came"),
        ("tactile_left", "a file of the hub is missing or cannot be read"),
    }


def test_3_ends_are_not_clamped(small: HubSession, tmp_path: Path) -> None:
    last = max(int(path.stem.removeprefix("angle_")) for path in small.hub.glob("angle_*.json"))
    ends = small.truth.spans_s[-1][1]
    for number in range(last + 1):
        if 5.0 * (number + 1) > ends - 1.5:
            (small.hub / f"angle_{number}.json").unlink(missing_ok=True)
    report, dataset = run(small.root, tmp_path / "out")
    short = [
        episode
        for episode in dataset
        if any(note.code == "session-short" for note in episode.metadata.quality)
    ]
    for episode in short:
        pose = episode["pose"]
        later = np.asarray(episode["rgb"].time)[-1:]
        assert later[0] > pose.time[-1]
        _, valid = interpolate_poses(pose.time, np.asarray(pose.data), later, 250_000_000)
        assert not valid.any()
    assert len(short) + len(report.failed) == 1


def _contents(root: Path) -> dict[str, str]:
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted((root / "episodes").rglob("*"))
        if path.is_file()
    }


def test_4_this_machines_time_zone_has_no_part(
    small: HubSession,
    small_converted: Converted,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TZ", "America/St_Johns")
    time.tzset()
    try:
        run(small.root, tmp_path / "out")
    finally:
        monkeypatch.undo()
        time.tzset()
    assert _contents(tmp_path / "out") == _contents(Path(small_converted[1].path))


def test_4_midnight_passes(tmp_path: Path) -> None:
    settings = HubSettings(
        seconds=4.0,
        sweep_s=0.0,
        tactile_size=(72, 96),
        start=datetime(2025, 3, 22, 15, 59, 52, tzinfo=UTC),
    )
    session = simulate_hub_session(tmp_path / "s", settings, demonstrations=3)
    report, dataset = run(session.root, tmp_path / "out")
    assert report.converted == 3
    for episode in dataset:
        taken = session_s(episode, session, np.asarray(episode["rgb"].time))[0]
        late = 1e-9 * episode["pose"].metadata.clock.latency_ns - settings.pose_latency_s
        assert abs(taken + late - session.clips[str(episode.metadata.source.key)]) < 0.01


def test_5_each_stream_has_a_latency_of_its_own(whole: HubSession, converted: Converted) -> None:
    settings = whole.settings
    true = {
        "pose": settings.pose_latency_s,
        "width": 0.0,
        **{f"tactile_{s}": late for s, late in zip(SIDES, settings.tactile_latency_s, strict=True)},
    }
    for episode in converted[1]:
        for name, late in true.items():
            clock = episode[name].metadata.clock
            assert abs(1e-9 * clock.latency_ns - late) < 8e-3, name
            assert clock.method


def test_6_a_sweep_that_does_not_tell_is_not_used(whole: HubSession, tmp_path: Path) -> None:
    root = tmp_path / "session"
    shutil.copytree(whole.root, root)
    calibration = next((root / "latency_calibration").glob("*.MP4"))
    # Frames of a demonstration: no marker in them.
    shutil.copy(next((root / "raw_videos").glob("*.MP4")), calibration)
    report, dataset = run(root, tmp_path / "out")
    assert any("does not calibrate: no sweep before marker 4" in text for text in report.notices)
    for episode in dataset:
        assert "pose-latency-assumed" in {note.code for note in episode.metadata.quality}
        assert episode["pose"].metadata.clock.latency_sigma_ns == 30e6


def test_9_the_reference_is_of_quiet_frames(small: HubSession, tmp_path: Path) -> None:
    side, captured = "left", small.captured_s["left"]
    depth = small.truth.depth_m("left", captured)
    starts = np.searchsorted(captured, np.arange(5.0, small.truth.duration_s, 5.0))
    touching = [k + 1 for k, at in enumerate(starts) if at < len(depth) and depth[at] > 5e-4]
    assert touching, "no chunk begins in contact: choose another seed"
    for number in range(touching[0]):
        (small.hub / f"left_{number}.mp4").unlink()
    _, dataset = run(small.root, tmp_path / "out")
    checked = 0
    for episode in dataset:
        stream = episode[f"tactile_{side}"]
        numbers = numbers_of(episode, stream.name)
        if depth[numbers[0]] < 5e-4:
            continue
        about = stream.metadata.reference  # type: ignore[attr-defined]  # tactile
        assert about.contact_free
        assert 0 not in about.frames
        assert (depth[numbers[about.frames]] == 0.0).all()
        meter = ActivityMeter(np.asarray(stream.reference))
        assert meter.measure(to_grey(stream.frames[0])) > 0.01
        checked += 1
    assert checked


def test_10_one_finger_does_not_shorten_the_other(small: HubSession, tmp_path: Path) -> None:
    ends = small.truth.spans_s[1][1]
    for path in small.hub.glob("right_*"):
        if 5.0 * int(path.stem.removeprefix("right_")) > ends - 6.0:
            path.unlink()
    report, dataset = run(small.root, tmp_path / "out")
    assert report.converted == 3
    by_key = sorted(dataset, key=lambda episode: str(episode.metadata.source.key))
    assert "tactile_right" not in by_key[-1]
    assert "no-frames" in {note.code for note in by_key[-1].metadata.quality}
    assert all(len(episode["tactile_left"]) > 100 for episode in by_key)


def test_11_rates_are_what_they_are(converted: Converted) -> None:
    for episode in converted[1]:
        stream = episode["rgb"]
        assert stream.metadata.nominal_rate == "60000/1001"
        seconds = np.asarray(stream.time - stream.time[0]) * 1e-9
        assert np.allclose(seconds, np.arange(len(seconds)) * 1001 / 60_000, atol=2e-5)


def test_12_17_numbers_are_those_that_were_recorded(
    small_original: HubSession, small_converted: Converted
) -> None:
    small, (_, dataset) = small_original, small_converted
    stamps, poses, counts = [], [], []
    for number in range(len(list(small.hub.glob("angle_*.json")))):
        document = json.loads((small.hub / f"angle_{number}.json").read_text())
        stamps += document["timestamps"]
        poses += document["data"]
        counts += [count for (count,) in document["angles"]]
    at = np.rint(np.array(stamps) * 1e9).astype(np.int64)
    wrapped = 0
    for episode in dataset:
        width, pose = episode["width"], episode["pose"]
        rows = np.searchsorted(at, width.array("time_host"))
        assert (at[rows] == width.array("time_host")).all()
        raw = np.array(counts)[rows]
        assert (np.asarray(width.array("raw")) == raw).all()
        found, recorded = np.asarray(pose.data), np.array(poses)[rows]
        assert np.array_equal(found[:, :3], recorded[:, :3])
        assert np.abs(np.sum(found[:, 3:] * recorded[:, 3:], axis=1)).min() > 1 - 1e-12
        # The encoder's count runs over its end within the gripper's travel.
        wrapped += int((np.abs(np.diff(raw.astype(int))) > 2048).any())
        true = small.truth.width_m(session_s(episode, small, np.asarray(width.time)))
        assert np.abs(np.asarray(width.data) - true).max() < 5e-4
        assert "width_map" in episode.metadata.calibration
    assert wrapped


def test_15_pickles_are_never_loaded(small: HubSession, tmp_path: Path) -> None:
    marker = tmp_path / "loaded"
    evil = f"cos\nsystem\n(S'touch {marker}'\ntR.".encode()
    (small.root / "dataset_plan.pkl").write_bytes(evil)
    (small.root / "raw_videos" / "tag_detection.pkl").write_bytes(evil)
    report, _ = run(small.root, tmp_path / "out")
    assert report.converted == 3
    assert any("2 pickle(s)" in text and "never loaded" in text for text in report.notices)
    assert not marker.exists()


def test_16_repeated_frames_are_told(small_converted: Converted) -> None:
    _, dataset = small_converted
    found = 0
    for episode in dataset:
        for side in SIDES:
            stream = episode[f"tactile_{side}"]
            again = np.flatnonzero(np.diff(stream.array("time_host")) == 0) + 1
            marks = np.asarray(stream.flags)
            assert (marks[again] & mask("time_nudged") != 0).all()
            notes = [n for n in episode.metadata.quality if n.stream == stream.name]
            told = [note.message for note in notes if note.code == "repeated-frames"]
            assert bool(len(again)) == bool(told)
            assert not told or told[0].startswith(f"{len(again)} of ")
            found += len(again)
    assert found
