"""Poses and widths: what a hand can do is never found, what it cannot is, at its place."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from exumi_data.model import CalibrationItem, Clock, Frames, Gap, RawData, Source
from exumi_data.simulation import simulate_play
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_validators import Problem, validate
from exumi_validators.motion import Break, Reach, Steps, find_breaks
from exumi_validators.series import Series, typical_step_s
from tests.exumi_data.builders import metadata

MEASURED = Clock(source="hub", stamp_point="kernel_rx")
SIMULATED = Clock(source="simulation", stamp_point="simulated")
LINEAR = Reach(5.0, 0.03, 100.0)
ANGULAR = Reach(35.0, np.radians(10.0), 1000.0)
Write = Callable[..., Path]


# ------------------------------------------------------------------------------------- the analysis


def hand(rate: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A vigorous smooth motion with a tracker's noise: times and poses.

    Speeds reach 2 m/s and 20 rad/s; stamps jitter, and some come in bursts.
    """
    rng = np.random.default_rng(seed)
    time = (np.arange(count) + rng.normal(0, 0.1, count).clip(-0.3, 0.3)) / rate
    hertz = rng.uniform(0.2, 4.0, (6, 1))
    most = np.array([[1.2]] * 3 + [[12.0]] * 3) * rng.uniform(0, 1, (6, 1))
    tracks = (
        most / (2 * np.pi * hertz) * np.sin(2 * np.pi * hertz * time + rng.uniform(0, 6, (6, 1)))
    )
    tracks[:3] += rng.normal(0, 2e-4, (3, count))
    tracks[3:] += rng.normal(0, 1e-3, (3, count))
    quaternions = Rotation.from_rotvec(tracks[3:].T).as_quat()
    return bursts(time, rng), np.hstack([tracks[:3].T, quaternions])


def bursts(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The stamps that samples get when a few of them wait for the one after them."""
    stamps = time.copy()
    for first in rng.integers(0, len(time), 3):
        last = min(first + 4, len(time) - 1)
        stamps[first : last + 1] = time[last] + 1e-9 * np.arange(last + 1 - first)
    return np.maximum.accumulate(stamps)


def breaks(time: np.ndarray, poses: np.ndarray) -> list[Break]:
    joined = np.ones(len(time) - 1, dtype=bool)
    time_ns = np.round(time * 1e9).astype(np.int64)
    usable = np.ones(len(time), dtype=bool)
    series = Series(0, time_ns, (poses,), usable, joined, slice(0, len(joined)))
    steps = Steps.of(poses, series.step_s(typical_step_s(series)), joined)
    return find_breaks(poses, steps, LINEAR, ANGULAR, most=1000)


@settings(max_examples=150, deadline=None)
@given(rate=st.floats(30, 500), count=st.integers(10, 400), seed=st.integers(0, 2**32))
def test_a_hand_is_never_found(rate: float, count: int, seed: int) -> None:
    assert breaks(*hand(rate, count, seed)) == []


@settings(max_examples=150, deadline=None)
@given(
    rate=st.floats(60, 500),
    seed=st.integers(0, 2**32),
    at=st.integers(3, 196),
    direction=st.integers(0, 2),
    turned=st.booleans(),
    away=st.integers(0, 2),
)
def test_a_jump_is_found_where_it_is(
    rate: float, seed: int, at: int, direction: int, turned: bool, away: int
) -> None:
    time, poses = hand(rate, 200, seed)
    longest = float(np.diff(time).max())
    end = at + away if away else len(poses)
    if turned:
        by = np.radians(10) + 1000 * longest**2 + 2 * 21 * longest
        if by > 2.5:
            return
        turn = Rotation.from_rotvec(by * np.eye(3)[direction])
        poses[at:end, 3:] = (turn * Rotation.from_quat(poses[at:end, 3:])).as_quat()
    else:
        poses[at:end, direction] += 0.03 + 100 * longest**2 + 2 * 2.1 * longest
    found = breaks(time, poses)
    assert [item.index for item in found] == [at]
    assert (found[0].kind == "jump") == (away == 0)


def line(count: int = 40, speed: float = 0.05, rate: float = 100.0) -> tuple[Any, Any]:
    """A straight motion: times and poses."""
    poses = np.zeros((count, 7))
    poses[:, 0], poses[:, 6] = np.arange(count) * speed / rate, 1
    return np.arange(count) / rate, poses


@pytest.mark.parametrize(("speed", "found"), [(4.9, []), (5.1, [1])])
def test_how_fast_a_hand_is(speed: float, found: list[int]) -> None:
    assert [item.index for item in breaks(*line(speed=speed))] == found


@pytest.mark.parametrize(("speed", "found"), [(34.0, []), (36.0, [1])])
def test_how_fast_a_hand_turns(speed: float, found: list[int]) -> None:
    time, poses = line()
    poses[:, 3:] = Rotation.from_rotvec(np.outer(time * speed, [0, 0, 1])).as_quat()
    assert [item.index for item in breaks(time, poses)] == found


@pytest.mark.parametrize(
    ("rate", "step", "found"),
    [(100, 0.029, []), (100, 0.031, [20]), (30, 0.110, []), (30, 0.113, [20])],
)
def test_how_far_a_step_may_go(rate: float, step: float, found: list[int]) -> None:
    time, poses = line(rate=rate, speed=0.0)
    poses[20:, 1] += step
    assert [item.index for item in breaks(time, poses)] == found


def test_a_blow_is_no_break() -> None:
    time, poses = line(rate=90, speed=4.0)
    poses[20:] = poses[20]
    assert breaks(time, poses) == []


def test_a_runaway_track_is_one_place() -> None:
    time, poses = line()
    poses[20:26, 2] += 0.2 * np.arange(6)
    poses[26:, 2] = poses[25, 2]
    assert [(item.kind, item.index) for item in breaks(time, poses)] == [("fast", 21)]


# ------------------------------------------------------------------------------------------ streams


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write an episode of poses and widths, or of one of them."""

    def episode(
        time: np.ndarray,
        poses: np.ndarray | None = None,
        widths: np.ndarray | None = None,
        *,
        clock: Clock = MEASURED,
        range_m: object = None,
        raw: np.ndarray | None = None,
        modulus: int | None = 4096,
        flags: np.ndarray | None = None,
        gaps: list[Gap] | None = None,
        source: str = "simulated",
    ) -> Path:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.zarr"
        item = CalibrationItem(value={"range_m": range_m}, method="gauge")
        time_ns = np.round(time * 1e9).astype(np.int64)
        beside = {} if flags is None else {"flags": flags}
        described = RawData(unit="count", transform="encoder", modulus=modulus)
        changes: dict[str, Any] = {} if raw is None else {"calibration": {"encoder": item}}
        changes["source"] = Source(type=source, tool="tests", tool_version="1")  # type: ignore[arg-type]  # one of the allowed
        with EpisodeWriter(path, metadata(**changes), durable=False) as writer:
            if poses is not None:
                frames = Frames(parent="world", child="tcp")
                pose = writer.add_stream("pose", kind="pose", clock=clock, frames=frames, gaps=gaps)
                pose.append(time_ns, poses, **beside)
            if widths is not None:
                fields = {} if raw is None else {"raw": described}
                width = writer.add_stream("width", kind="width", clock=clock, gaps=gaps, **fields)
                rows = beside if raw is None else {**beside, "raw": raw}
                width.append(time_ns, widths, **rows)
        return path

    return episode


def found(path: Path) -> list[Problem]:
    report = validate(path, levels=["arrays"])
    assert report.coverage.unchecked == ()
    return list(report.problems)


def places(path: Path) -> list[tuple[str, int | None]]:
    """Where rules of motion are broken; rules of times are not what is tested here."""
    return [
        (problem.code, problem.location.index)
        for problem in found(path)
        if problem.code.startswith(("POSE-", "WIDTH-"))
    ]


def skipped(path: Path) -> dict[str, str]:
    return {item.code: item.reason for item in validate(path, levels=["arrays"]).coverage.skipped}


def test_what_is_said(write: Write) -> None:
    time, poses = line()
    poses[10] += (1, 0, 0, 0, 0, 0, 0)
    poses[30:, 1] += 0.5
    fast, jump = found(write(time, poses))
    message = "the pose moves 100 m/s at sample 10, a hand less than 5 m/s (places: 1)"
    assert (fast.code, fast.message) == ("POSE-003", message)
    message = "the track moves by 0.5 m and 0 degrees at once at sample 30 and goes on from there"
    assert (jump.code, jump.message) == ("POSE-004", f"{message} (places: 1)")


@pytest.mark.parametrize("still", [0, 19, 21])
def test_another_unit_is_called_so(write: Write, still: int) -> None:
    """Millimetres: more than half of the steps are too long, if the hand does not rest as often."""
    time, poses = line(count=41)
    poses[:, 0] *= 1000
    poses[: still + 1, 0] = 0.0
    (problem,) = found(write(time, poses))
    assert problem.code == "POSE-003"
    shown = f"({40 - still} of 40 steps, as in another unit than metres)"
    assert problem.message.endswith(shown if still < 20 else "(places: 1)")


def test_places_are_counted(write: Write) -> None:
    time, poses = line(count=100)
    for index in (20, 40, 60):
        poses[index:, 1] += 0.1
    (jump,) = found(write(time, poses))
    assert jump.message.endswith("(places: 3)")
    assert jump.location.index == 20


def test_poses_that_the_device_called_invalid_are_not_judged(write: Write) -> None:
    time, poses = line()
    poses[10:13, 0] += 1
    poses[20:, 0] += 1
    flags = np.zeros(len(time), np.uint32)
    flags[10:13], flags[20] = 8, 4
    assert places(write(time, poses, flags=flags)) == []


def test_steps_over_a_gap_are_not_judged(write: Write) -> None:
    time, poses = line()
    poses[20:, 0] += 1
    assert places(write(time, poses, gaps=[Gap(after=19)])) == []


def test_it_does_not_matter_where_a_block_ends(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    time, poses = line(count=300)
    poses[50:, 0] += 1
    poses[97:99, 1] += 1
    poses[140:220] = poses[140]
    path = write(time, poses)
    whole = places(path)
    assert sorted(whole) == [("POSE-003", 97), ("POSE-004", 50), ("POSE-005", 140)]
    for rows in (17, 20, 31, 40, 48, 49, 50, 51, 52, 96, 97, 98, 99, 110, 141, 220, 221):
        monkeypatch.setattr("exumi_validators.context._rows", lambda _, rows=rows: rows)
        assert places(path) == whole, rows


def frozen(count: int = 200, begin: int = 60, end: int = 130, speed: float = 0.1) -> Any:
    """A slow motion at 100 Hz whose track hangs for a while."""
    time, poses = line(count=count, speed=speed)
    poses[begin:end] = poses[begin]
    return time, poses


def test_tracking_that_hangs_is_found_once(write: Write) -> None:
    (problem,) = found(write(*frozen()))
    assert (problem.code, problem.location.index) == ("POSE-005", 60)
    assert problem.found == "0.69"


@pytest.mark.parametrize(("end", "count"), [(110, 0), (111, 1)])
def test_how_long_a_pose_may_be_the_same(write: Write, end: int, count: int) -> None:
    assert len(places(write(*frozen(end=end, speed=0.01)))) == count


def test_a_few_samples_are_not_enough(write: Write) -> None:
    time, poses = frozen(begin=60, end=69)
    assert places(write(time * 20, poses)) == []


def test_tracking_that_never_comes_back(write: Write) -> None:
    time, poses = frozen(end=200, speed=0.5)
    assert places(write(time, poses)) == [("POSE-005", 60)]


def test_a_simulated_hand_may_halt(write: Write) -> None:
    time, poses = frozen(end=200, speed=0.5)
    path = write(time, poses, clock=SIMULATED)
    assert places(path) == []
    assert skipped(path)["POSE-005"] == "the pose stands still, and does not tell why"


def test_a_tracker_has_noise_in_whatever_it_measures(write: Write) -> None:
    time, poses = line(count=900)
    poses[:] = poses[0]  # for nine seconds
    slow = time
    assert places(write(slow, poses)) == []
    assert [code for code, _ in places(write(slow, poses, source="recorded"))] == ["POSE-005"]
    assert places(write(slow, poses, source="recorded", clock=SIMULATED)) == []


def test_a_robot_that_rests_is_not_frozen(write: Write) -> None:
    rise = np.linspace(0, 1, 100)
    smooth = rise**3 * (10 - 15 * rise + 6 * rise**2)
    time, poses = line(count=400)
    poses[:, 0] = np.concatenate([smooth, np.ones(200), 1 + smooth]) * 0.3
    path = write(time, poses)
    assert places(path) == []
    assert "POSE-005" in skipped(path)


def test_a_pose_that_never_changes_tells_nothing(write: Write) -> None:
    path = write(*line(speed=0.0, count=200))
    assert places(path) == []
    assert skipped(path)["POSE-005"] == "the pose never changes"


def test_times_that_were_not_measured_tell_nothing_of_freezing(write: Write) -> None:
    time, poses = frozen()
    clock = Clock(source="none", stamp_point="nominal_rate")
    path = write(time, poses, clock=clock)
    assert skipped(path)["POSE-005"] == "times were not measured"


@pytest.mark.parametrize(("count", "judged"), [(9, False), (10, True)])
def test_a_few_poses_are_not_judged(write: Write, count: int, judged: bool) -> None:
    time, poses = line(count=count)
    poses[5:, 0] += 1
    path = write(time, poses)
    assert places(path) == ([("POSE-004", 5)] if judged else [])
    assert ("POSE-004" in skipped(path)) is not judged


def test_simulated_sessions_have_no_findings(write: Write) -> None:
    for seed in range(5):
        session = simulate_play(seed=seed, duration_s=8.0, drop=0.05)
        pose, width = session.streams["pose"], session.streams["width"]
        assert pose.data is not None
        assert width.raw is not None
        path = write(pose.capture_time_ns / 1e9, pose.data)
        assert places(path) == []
        assert "POSE-005" not in skipped(path)
        path = write(width.capture_time_ns / 1e9, None, width.data, raw=width.raw)
        assert np.abs(np.diff(width.raw.astype(int))).max() > 2048, "the counts do wrap"
        assert places(path) == []


# ------------------------------------------------------------------------------------------- widths


def opening(count: int = 60, speed: float = 0.1, rate: float = 200.0) -> tuple[Any, Any]:
    time = np.arange(count) / rate
    return time, time * speed


@pytest.mark.parametrize(("step", "count"), [(0.0148, 0), (0.0152, 1)])
def test_how_fast_a_gripper_is(write: Write, step: float, count: int) -> None:
    time, widths = opening(speed=0.0)
    widths[30:] += step
    path = write(time, None, widths)
    assert places(path) == [("WIDTH-005", 30)] * count
    assert skipped(path)["WIDTH-003"] == "there are no counts"


def test_a_reading_out_and_back_is_one_place(write: Write) -> None:
    time, widths = opening()
    widths[[20, 40]] = 0.5
    (problem,) = found(write(time, None, widths))
    assert problem.location.index == 20
    assert "(places: 2)" in problem.message


def test_stamps_in_a_burst_are_no_speed(write: Write) -> None:
    time, widths = opening(speed=1.0)
    time[20:25] = time[25] - 1e-9 * np.arange(5, 0, -1)
    assert places(write(time, None, widths)) == []


@pytest.mark.parametrize("modulus", [4096, None])
def test_a_width_that_follows_the_wrap(write: Write, modulus: int | None) -> None:
    raw = (4000 + 10 * np.arange(60)) % 4096
    time, _ = opening()
    path = write(time, None, raw / 6000, raw=raw.astype(np.uint16), modulus=modulus)
    assert places(path) == [("WIDTH-003", 10)]


def test_a_fast_width_beside_calm_counts_is_no_wrap(write: Write) -> None:
    time, widths = opening()
    widths[30:] += 0.05
    path = write(time, None, widths, raw=np.arange(60, dtype=np.uint16))
    assert places(path) == [("WIDTH-005", 30)]


@pytest.mark.parametrize(("highest", "count"), [(0.0294, 0), (0.0293, 1)])
def test_where_a_calibration_holds(write: Write, highest: float, count: int) -> None:
    time, widths = opening()  # to 29.5 mm
    raw = np.arange(60, dtype=np.uint16)
    path = write(time, None, widths, raw=raw, range_m=[0.0, highest])
    assert places(path) == [("WIDTH-004", 59)] * count


def test_widths_that_are_flagged_may_lie_outside(write: Write) -> None:
    time, widths = opening()
    flags = np.where(widths > 0.02, 16, 0).astype(np.uint32)
    raw = np.arange(60, dtype=np.uint16)
    assert places(write(time, None, widths, raw=raw, range_m=[0, 0.02], flags=flags)) == []


@pytest.mark.parametrize("range_m", [None, [0], ["a", "b"], [1, 0], 5, [0, 10**400], [False, True]])
def test_a_calibration_without_a_range(write: Write, range_m: object) -> None:
    time, widths = opening()
    path = write(time, None, widths, raw=np.arange(60, dtype=np.uint16), range_m=range_m)
    assert places(path) == []
    assert skipped(path)["WIDTH-004"] == "the calibration states no `range_m`"


def test_streams_of_samples_that_are_all_invalid(write: Write) -> None:
    time, widths = opening()
    _, poses = line(count=60)
    path = write(time, poses, widths, flags=np.full(60, 8, np.uint32))
    assert places(path) == []
    assert {"POSE-003", "POSE-004", "POSE-005", "WIDTH-005"} <= set(skipped(path))


def test_numbers_beyond_all_measure(write: Write) -> None:
    rng = np.random.default_rng(0)
    time, poses = line(count=60)
    poses[:, :3] = rng.normal(0, 1e300, (60, 3))
    codes = [code for code, _ in places(write(time, poses, rng.normal(0, 1e30, 60)))]
    assert codes == ["POSE-003", "WIDTH-001", "WIDTH-005"]
