"""Angular speed, by poses and by a gyroscope."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from exumi_data.clips.gpmf import GyroTrack
from exumi_data.episode import Episode, open_episode
from exumi_data.model import EpisodeMetadata, Frames, Source, Task
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.shards import open_array
from exumi_data.synchronisation import motion
from exumi_data.synchronisation.motion import SPAN_S, Turning, of_gyro, of_pose_stream, of_poses


def turning_poses(time_ns: np.ndarray, rad_per_s: float) -> np.ndarray:
    angle = rad_per_s * time_ns * 1e-9
    axis = np.array([0.6, 0.0, 0.8])
    turns = Rotation.from_rotvec(angle[:, None] * axis).as_quat()
    return np.hstack([np.zeros((len(time_ns), 3)), turns])


def times(count: int, rate_hz: float = 90.0) -> np.ndarray:
    return np.asarray(np.rint(np.arange(count) * 1e9 / rate_hz), np.int64)


def test_an_even_turn_has_its_speed_whatever_the_signs() -> None:
    time_ns = times(200)
    poses = turning_poses(time_ns, 3.5)
    signs = np.where(np.random.default_rng(1).random(200) < 0.5, -1.0, 1.0)
    poses[:, 3:] *= signs[:, None]
    found = of_poses(time_ns, poses)
    assert found.rad_per_s == pytest.approx(3.5, abs=1e-9)
    assert len(found.time_ns) == 200 - 5
    assert found.time_ns[0] == time_ns[5] // 2


def test_nothing_is_said_across_a_gap() -> None:
    time_ns = times(200)
    kept = (np.arange(200) < 90) | (np.arange(200) > 110)
    found = of_poses(time_ns[kept], turning_poses(time_ns, 1.0)[kept])
    inside = (found.time_ns > time_ns[92]) & (found.time_ns < time_ns[108])
    assert not inside.any()
    assert found.rad_per_s == pytest.approx(1.0)


def test_a_jump_is_no_motion() -> None:
    time_ns = times(200)
    poses = turning_poses(time_ns, 1.0)
    poses[100:, 3:] = np.roll(poses[100:, 3:], 1, axis=1)
    found = of_poses(time_ns, poses)
    assert found.rad_per_s.max() < 20.0
    assert len(found.time_ns) == 200 - 5 - 5


def test_too_few_poses() -> None:
    for count in (0, 1, 3):
        assert len(of_poses(times(count), turning_poses(times(count), 1.0)).time_ns) == 0


def test_a_gyroscope_on_any_axes_says_the_same() -> None:
    time_s = 0.01 + np.arange(600) / 200.0
    mounted = Rotation.from_euler("xyz", [20, 40, 60], degrees=True)
    values = mounted.apply(np.tile([0.0, 2.5, 0.0], (600, 1)))
    found = of_gyro(GyroTrack(time_s, values, 0.0))
    assert found.rad_per_s == pytest.approx(2.5)
    assert found.time_ns[0] >= 1e9 * (time_s[0] + SPAN_S / 2)
    assert found.time_ns[-1] <= 1e9 * (time_s[-1] - SPAN_S / 2)


def test_both_say_the_same_of_a_motion_that_changes() -> None:
    fine_ns = times(4000, 400.0)
    rate = 2.0 + 1.5 * np.sin(2 * np.pi * 0.8 * fine_ns * 1e-9)
    angle = np.concatenate(([0.0], np.cumsum(rate[:-1] / 400.0)))
    poses = np.zeros((4000, 7))
    poses[:, 3:] = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]).as_quat()
    by_poses = of_poses(fine_ns, poses)
    by_gyro = of_gyro(GyroTrack(fine_ns * 1e-9, np.outer(rate, [1.0, 0.0, 0.0]), 0.0))
    there = np.interp(by_poses.time_ns, by_gyro.time_ns, by_gyro.rad_per_s)
    assert np.abs(there - by_poses.rad_per_s)[50:-50].max() < 0.03


def pose_episode(path: Path, time_ns: np.ndarray, poses: np.ndarray, flags: np.ndarray) -> Episode:
    metadata = EpisodeMetadata(
        id="01932c00-1f00-7000-8000-000000000001",
        task=Task(name="turn"),
        regime="play",
        licence="CC0-1.0",
        source=Source(type="recorded", tool="test", tool_version="1"),
    )
    with EpisodeWriter(path, metadata, durable=False) as writer:
        stream = writer.add_stream("pose", kind="pose", frames=Frames(parent="world", child="tcp"))
        stream.append(time_ns, poses, flags=flags)
    return open_episode(path)


def test_a_stream_read_in_blocks_is_the_stream_read_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    time_ns = times(1000)
    poses = turning_poses(time_ns, 1.0)
    poses[:, 3:] = turning_poses(time_ns * np.int64(3) // 2 + time_ns**2 // 10**10, 1.0)[:, 3:]
    flags = np.zeros(1000, np.uint32)
    flags[300:303] = 8
    poses[300:303] = np.nan
    with pose_episode(tmp_path / "e.zarr", time_ns, poses, flags) as episode:

        def read() -> Turning:
            return of_pose_stream(
                episode["pose"],
                lambda name, first, last: open_array(episode.store, f"streams/pose/{name}").rows(
                    first, last
                ),
            )

        whole = read()
        for block in (7, 64, 999):
            monkeypatch.setattr(motion, "_BLOCK", block)
            part = read()
            assert part.time_ns.tolist() == whole.time_ns.tolist()
            assert part.rad_per_s.tolist() == whole.rad_per_s.tolist()
    kept = flags == 0
    assert whole.time_ns.tolist() == of_poses(time_ns[kept], poses[kept]).time_ns.tolist()
