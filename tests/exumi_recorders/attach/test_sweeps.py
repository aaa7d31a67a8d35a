"""Clips without a gyroscope are placed by the sweep that they show."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exumi_data.cli.app import app
from exumi_data.clips.markers import MarkerSettings
from exumi_data.clips.sweeps import find_sweep
from exumi_data.episode import open_episode
from exumi_data.errors import UsageError
from exumi_data.simulation.sweep import SweepSettings, simulate_sweep
from exumi_data.simulation.sweep_recording import CAMERA, write_sweep_clip
from exumi_data.synchronisation.placing import Placement
from exumi_data.synchronisation.sweep import MarkerTrack, PoseTrack
from exumi_data.synchronisation.sweep_search import METHOD, place_sweep
from exumi_recorders.attach import AttachOptions, AttachReport, attach
from exumi_recorders.calibration.files import Calibration, write_calibration
from exumi_recorders.placed_clips import placed_by
from exumi_validators import validate
from tests.exumi_recorders.attach.sweeping import (
    SweptSession,
    sweep_settings,
    write_swept_session,
)

QUICK = AttachOptions(durable=False)


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> SweptSession:
    return write_swept_session(tmp_path_factory.mktemp("swept"))


@pytest.fixture(scope="module")
def attached(
    swept: SweptSession, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, AttachReport]:
    root = tmp_path_factory.mktemp("demos") / "demos"
    return root, attach(swept.clips, swept.session, root, options=QUICK)


def test_clips_are_placed_by_their_sweeps(
    swept: SweptSession, attached: tuple[Path, AttachReport]
) -> None:
    root, report = attached
    found = {clip.name: clip for clip in report.clips}
    for name, start_s in swept.starts_s.items():
        clip = found[name]
        assert clip.status == "attached", clip.reason
        assert clip.start_s is not None
        assert clip.sigma_s is not None
        # Exposure and readout are not known, and nearly all of the uncertainty.
        assert abs(clip.start_s - start_s) < 2 * clip.sigma_s < 7e-3
    assert found[swept.foreign].status == "refused"
    assert "sweep" in found[swept.foreign].reason
    errors = [p for p in validate(root, workers=1).problems if p.severity == "error"]
    assert [(p.rule, p.path) for p in errors] == []


def test_the_episode_says_how_it_was_placed(
    swept: SweptSession, attached: tuple[Path, AttachReport]
) -> None:
    root, report = attached
    with open_episode(next(root.rglob(f"{report.clips[0].episode}.zarr"))) as episode:
        assert (episode.metadata.source.settings or {})["method"] == METHOD
        clock = episode["rgb"].metadata.clock
        assert (clock.method or "").startswith(f"{METHOD}: where a marker is in its frames")
        assert "gyroscope" not in (clock.method or "")
        assert placed_by(clock) == "pose"
        assert clock.offset_sigma_ns == pytest.approx(1e9 * (report.clips[0].sigma_s or 0), abs=1)
        assert episode["rgb"].container() == (swept.clips / report.clips[0].name).read_bytes()


def test_how_the_camera_sees_has_to_be_known(swept: SweptSession, tmp_path: Path) -> None:
    other = tmp_path / "rig.json"
    write_calibration(other, Calibration())
    with pytest.raises(UsageError, match="has no intrinsics/rgb"):
        attach(
            swept.clips, swept.session, tmp_path / "d", options=replace(QUICK, calibration=other)
        )
    unknown = replace(QUICK, stream="wrist", dry_run=True)
    report = attach(swept.clips, swept.session, tmp_path / "d", options=unknown)
    assert {clip.status for clip in report.clips} == {"refused"}
    assert all("no intrinsics/wrist says how" in clip.reason for clip in report.clips)


def test_the_command_takes_the_camera_from_a_file(
    swept: SweptSession, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, lens = tmp_path / "rig.json", tmp_path / "lens.json"
    matrix = [[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]]
    lens.write_text(json.dumps({"K": matrix}))

    def run(*words: object) -> int:
        with pytest.raises(SystemExit) as ended:
            app(list(map(str, words)))
        return int(ended.value.code or 0)

    size = ("--size", f"{CAMERA.width}x{CAMERA.height}")
    assert run("calibrate", "camera", lens, "--stream", "wrist", *size, "--out", rig) == 0
    name = next(iter(swept.starts_s))
    arguments = ("attach", swept.clips / name, swept.session, "--out", tmp_path / "d", "--dry-run")
    assert run(*arguments, "--stream", "wrist", "--calibration", rig, "--marker", 5) == 1
    assert "no sweep before marker 5, which was found in 0 of" in capsys.readouterr().err
    assert run(*arguments, "--stream", "wrist", "--calibration", rig) == 0
    assert "1 placed of 1 clips" in capsys.readouterr().out


def test_only_the_sweep_of_a_clip_is_taken(tmp_path: Path) -> None:
    path = write_sweep_clip(
        tmp_path / "a.mp4", sweep_settings(seconds=15.0, missing=0.1, frames_per_s=15.0), seed=1
    )
    track = find_sweep(path, CAMERA, MarkerSettings())
    assert isinstance(track, MarkerTrack)
    span_s = float(track.time_ns[-1] - track.time_ns[0]) * 1e-9
    assert 11.5 < span_s <= 12.0
    assert len(track.time_ns) <= track.frames <= 12.0 * 15.0 + 1
    wrong = CAMERA.model_copy(update={"height": 100})
    assert "its frames do not help" in str(find_sweep(path, wrong, MarkerSettings()))
    path.write_bytes(path.read_bytes()[:500])
    assert "its frames do not help" in str(find_sweep(path, CAMERA, MarkerSettings()))


class Poses:
    """Poses of a session that are in memory."""

    def __init__(self, track: PoseTrack) -> None:
        self.track = track

    @property
    def span_ns(self) -> tuple[int, int]:
        return int(self.track.time_ns[0]), int(self.track.time_ns[-1])

    def between(self, start_ns: int, stop_ns: int) -> PoseTrack:
        first, last = np.searchsorted(self.track.time_ns, [start_ns, stop_ns])
        return PoseTrack(self.track.time_ns[first:last], self.track.poses[first:last])


def joined(tracks: list[PoseTrack]) -> Poses:
    """One after the other, each 20 s after the one before."""
    times = [track.time_ns + 20_000_000_000 * i for i, track in enumerate(tracks)]
    return Poses(PoseTrack(np.concatenate(times), np.concatenate([t.poses for t in tracks])))


def test_what_happened_twice_is_placed_nowhere() -> None:
    marker, pose = simulate_sweep(SweepSettings(), 4)
    other = simulate_sweep(SweepSettings(), 5)[1]
    once = place_sweep(joined([other, pose, other]), marker)
    assert isinstance(once, Placement)
    # Exposure and readout of this camera are none, and taken to be some.
    assert once.offset_ns == pytest.approx(20e9, abs=3 * 1e9 * 4.2e-3)
    assert "several places" in str(place_sweep(joined([pose, other, pose]), marker))


def test_a_session_that_is_too_short_or_does_not_move() -> None:
    marker, pose = simulate_sweep(SweepSettings(), 4)
    said = "nothing in the session moves"
    short = Poses(PoseTrack(pose.time_ns[:300], pose.poses[:300]))
    assert said in str(place_sweep(short, marker))
    still = Poses(PoseTrack(pose.time_ns, np.repeat(pose.poses[:1], len(pose.poses), axis=0)))
    assert said in str(place_sweep(still, marker))
    assert said in str(place_sweep(Poses(PoseTrack(pose.time_ns[:1], pose.poses[:1])), marker))
