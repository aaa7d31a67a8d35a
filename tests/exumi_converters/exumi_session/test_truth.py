"""A simulated session against its truth: poses, widths, frames and times."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from exumi_data.episode import Episode
from exumi_data.geometry import interpolate_poses
from exumi_data.simulation.hub_session import HubSession
from exumi_validators import validate
from tests.exumi_converters.exumi_session.conftest import Converted
from tests.exumi_converters.exumi_session.truths import numbers_of, session_s, true_frames_s

SIDES = ("left", "right")


def test_one_episode_a_demonstration(whole: HubSession, converted: Converted) -> None:
    report, dataset = converted
    assert (report.converted, report.failed) == (2, ())
    keys = {str(episode.metadata.source.key) for episode in dataset}
    assert keys == {name for name in whole.clips if name.startswith("raw_videos/")}
    for episode in dataset:
        assert set(episode) == {"rgb", "pose", "width", "tactile_left", "tactile_right"}
        assert [note.code for note in episode.metadata.quality if note.severity != "info"] == []


def test_it_is_valid(converted: Converted) -> None:
    _, dataset = converted
    report = validate(dataset.path)
    assert [problem.message for problem in report.problems] == []


def test_poses_as_the_hub_sampled_them(whole: HubSession, converted: Converted) -> None:
    for episode in converted[1]:
        pose = episode["pose"]
        true = whole.truth.pose(session_s(episode, whole, np.asarray(pose.time)))
        found = np.asarray(pose.data)
        assert np.linalg.norm(found[:, :3] - true[:, :3], axis=1).max() < 1e-3
        turn = Rotation.from_quat(found[:, 3:]).inv() * Rotation.from_quat(true[:, 3:])
        assert np.percentile(np.degrees(turn.magnitude()), 95) < 0.2


def pose_errors(episode: Episode, whole: HubSession) -> tuple[np.ndarray, np.ndarray]:
    """Millimetres and degrees by which the poses are off at the camera's frames."""
    pose = episode["pose"]
    ticks = np.asarray(episode["rgb"].time)
    found, valid = interpolate_poses(pose.time, np.asarray(pose.data), ticks, 100_000_000)
    assert valid.all()
    true = whole.truth.pose(true_frames_s(episode, whole))
    away = 1e3 * np.linalg.norm(found[:, :3] - true[:, :3], axis=1)
    turn = Rotation.from_quat(found[:, 3:]).inv() * Rotation.from_quat(true[:, 3:])
    return away, np.degrees(turn.magnitude())


def test_poses_at_the_cameras_frames(whole: HubSession, converted: Converted) -> None:
    for episode in converted[1]:
        away_mm, turn_deg = pose_errors(episode, whole)
        assert np.sqrt(np.mean(away_mm**2)) < 0.5
        assert np.sqrt(np.mean(turn_deg**2)) < 0.1
        # What is more is where the hand jerks between two poses of 30 a second.
        assert np.percentile(away_mm, 95) < 1.0
        assert np.percentile(turn_deg, 95) < 0.2


def test_widths(whole: HubSession, converted: Converted) -> None:
    for episode in converted[1]:
        width = episode["width"]
        own = whole.truth.width_m(session_s(episode, whole, np.asarray(width.time)))
        assert np.abs(np.asarray(width.data) - own).max() < 2.5e-4
        at_frames = np.interp(episode["rgb"].time, width.time, np.asarray(width.data))
        seen = whole.truth.width_m(true_frames_s(episode, whole))
        assert np.percentile(np.abs(at_frames - seen), 99) < 5e-4


@pytest.mark.parametrize("side", SIDES)
def test_tactile_frames_are_the_hubs_own_one_by_one(
    whole: HubSession, converted: Converted, side: str
) -> None:
    shown = whole.shown[side]
    for episode in converted[1]:
        stream = episode[f"tactile_{side}"]
        numbers = numbers_of(episode, stream.name)
        first = int(np.flatnonzero(shown == numbers[0])[0])
        assert (numbers == shown[first : first + len(numbers)]).all()
        taken = session_s(episode, whole, np.asarray(stream.time))
        off_ms = 1e3 * (taken - whole.captured_s[side][numbers])
        assert np.abs(off_ms).max() < 8.0
        clock = stream.metadata.clock
        assert clock.latency_sigma_ns is not None
        assert np.abs(off_ms).max() < 1e-6 * 4.0 * clock.latency_sigma_ns


def test_times_of_the_cameras_frames(whole: HubSession, converted: Converted) -> None:
    for episode in converted[1]:
        taken = session_s(episode, whole, np.asarray(episode["rgb"].time))
        off_s = taken - true_frames_s(episode, whole)
        sigma = episode["rgb"].metadata.clock.offset_sigma_ns
        assert sigma is not None
        assert np.abs(off_s).max() < 8e-3
        assert np.abs(off_s).max() < 3e-9 * sigma


def test_what_the_session_says_of_its_clocks(whole: HubSession, converted: Converted) -> None:
    (zone, shown) = [text for text in converted[0].notices if "camera's clock" in text]
    assert "UTC+08:00" in zone
    assert "UTC+08:00, 1." in shown
    assert "ahead" in shown
