"""Streams against each other: what is found, what is not estimable."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.model import ArrayImages, Clock, Embodiment, Frames
from exumi_data.store.access import FolderStore
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_validators import Report, context, curves, validate
from exumi_validators.context import EpisodeContext
from exumi_validators.listing import list_folder
from tests.exumi_data.builders import CLOCK, metadata
from tests.exumi_data.synchronisation.gripping import (
    CONTACT_M,
    activity,
    as_ns,
    frame_times,
    width_m,
)

SECONDS = 8.0
IMAGES = ArrayImages(encoding="array", height=4, width=4, channels=1)
GRASPED, NOMINAL = "no grasp that tells", "times are nominal"
Add = Callable[[EpisodeWriter], None]


def tactile(
    name: str = "tactile",
    late_s: float = 0.0,
    values: np.ndarray | None = None,
    clock: Clock = CLOCK,
    stored: bool = True,
    seconds: float = SECONDS,
    times: Callable[[np.ndarray], np.ndarray] = np.copy,
    **beside: Any,
) -> Add:
    """Add a tactile stream that is late, or has times of its own."""

    def add(writer: EpisodeWriter) -> None:
        time_s = frame_times(seconds)
        rate = "30" if clock.stamp_point == "nominal_rate" else None
        if rate:
            time_s = np.arange(len(time_s)) / 30
        out = writer.add_stream(name, kind="tactile", clock=clock, images=IMAGES, nominal_rate=rate)
        shape = (len(time_s), 4, 4, 1)
        frames = np.random.default_rng(0).integers(0, 9, shape, dtype=np.uint8)
        extra = {key: value(time_s) for key, value in beside.items()}
        out.append(as_ns(times(time_s) + late_s), frames, **extra)
        out.set_reference(frames[0], method="captured")
        shown = activity(time_s) if values is None else values[: len(time_s)]
        if stored:
            writer.add_derived(
                name,
                "activity",
                shown.astype(np.float32),
                algorithm="exumi-activity/1",
                parameters={"threshold": 5.8, "size": 4, "active_above": 1e-3},
            )

    return add


def width(name: str = "width", values: np.ndarray | None = None, clock: Clock = CLOCK) -> Add:
    """Add the width of the gripper that grasps."""

    def add(writer: EpisodeWriter) -> None:
        time_s = np.arange(0, SECONDS, 0.01)
        rate = "100" if clock.stamp_point == "nominal_rate" else None
        out = writer.add_stream(name, kind="width", clock=clock, nominal_rate=rate)
        out.append(as_ns(time_s), width_m(time_s) if values is None else values)

    return add


def pose(late_s: float = 0.0) -> Add:
    """Add the pose of a hand that presses and leaves as the gripper would."""

    def add(writer: EpisodeWriter) -> None:
        time_s = np.arange(0, SECONDS, 1 / 90)
        data = np.zeros((len(time_s), 7))
        data[:, 1], data[:, 6] = width_m(time_s), 1.0
        frames = Frames(parent="world", child="tcp")
        writer.add_stream("pose", kind="pose", clock=CLOCK, frames=frames).append(
            as_ns(time_s + late_s), data
        )

    return add


@pytest.fixture
def judged(tmp_path: Path) -> Callable[..., Report]:
    """Write an episode of these streams and judge its arrays."""

    def judge(*streams: Add, **changes: Any) -> Report:
        path = tmp_path / "episode.zarr"
        with EpisodeWriter(path, metadata(**changes), durable=False) as writer:
            for add in streams:
                add(writer)
        report: Report = validate(path, levels=("arrays",))
        assert report.coverage.unchecked == ()
        return report

    return judge


def found(report: Report) -> list[tuple[str, str | None]]:
    return [
        (problem.code, problem.location.pointer)
        for problem in report.problems
        if problem.code.startswith("SYNC")
    ]


def skipped(report: Report) -> list[tuple[str, str]]:
    rules = [item for item in report.coverage.skipped if item.code.startswith("SYNC")]
    reasons = {
        code: [(item.reason, item.path) for item in rules if item.code == code]
        for code in ("SYNC-001", "SYNC-002")
    }
    assert reasons["SYNC-001"] == reasons["SYNC-002"], "both need the same"
    return [(reason.removeprefix("not estimable: "), path) for reason, path in reasons["SYNC-001"]]


def clock_of(name: str) -> str:
    return f"/attributes/exumi/streams/{name}/clock"


@pytest.mark.parametrize(
    ("late_ms", "code"),
    [
        (0, None),
        (3, None),
        (-3, None),
        (20, "SYNC-002"),
        (-20, "SYNC-002"),
        (45, "SYNC-002"),
        (56, "SYNC-001"),
        (-56, "SYNC-001"),
        (600, "SYNC-001"),
    ],
)
def test_what_remains(judged: Callable[..., Report], late_ms: int, code: str | None) -> None:
    report = judged(width(), tactile(late_s=late_ms * 1e-3))
    assert found(report) == ([(code, clock_of("tactile"))] if code else [])
    assert skipped(report) == []


def test_both_streams_and_the_uncertainty_are_named(judged: Callable[..., Report]) -> None:
    report = judged(width(), tactile("finger", late_s=-0.2))
    (problem,) = (problem for problem in report.problems if problem.code == "SYNC-001")
    assert problem.found is not None
    late, plus_minus, sigma, unit, sign = problem.found.split()
    assert abs(float(late) - 200) < 3 * float(sigma)
    assert (plus_minus, unit, sign) == ("±", "ms", "early")
    assert problem.message.startswith("by 2 grasps, finger is")
    assert problem.message.endswith("relative to width, beyond its declared latency of 0.0 ms")


@pytest.mark.parametrize(("declared_ms", "code"), [(42, None), (0, "SYNC-002")])
def test_the_declared_latency_counts(
    judged: Callable[..., Report], declared_ms: int, code: str | None
) -> None:
    late_s = 0.042
    clock = Clock(
        source="simulation",
        stamp_point="simulated",
        latency_ns=declared_ms * 1_000_000,
        raw_time="time_host",
    )
    stream = tactile(
        late_s=late_s - declared_ms * 1e-3,
        clock=clock,
        time_host=lambda time_s: as_ns(time_s + late_s),
    )
    report = judged(width(), stream)
    assert found(report) == ([(code, clock_of("tactile"))] if code else [])
    assert {problem.code for problem in report.problems} <= {"SYNC-002"}


def test_each_finger_is_judged(judged: Callable[..., Report]) -> None:
    report = judged(width(), tactile("tactile_left"), tactile("tactile_right", late_s=0.1))
    assert found(report) == [("SYNC-001", clock_of("tactile_right"))]


def test_of_several_grippers_names_tell_which(judged: Callable[..., Report]) -> None:
    other = width_m(np.arange(0, SECONDS, 0.01) + 0.5)
    report = judged(
        width("width_left"),
        width("width_right", other),
        tactile("tactile_left"),
        tactile("tactile_right"),
        tactile("tactile_head"),
    )
    assert found(report) == [("SYNC-001", clock_of("tactile_right"))]
    assert skipped(report) == [("no width of the same gripper", "streams/tactile_head")]


def test_invalid_samples_are_left_out(judged: Callable[..., Report]) -> None:
    def jammed(time_s: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(time_s)) % 9 == 0, 8, 0)

    values = activity(frame_times(SECONDS))
    values[::9] = 0.5
    assert found(judged(width(), tactile(values=values, flags=jammed))) == []


@pytest.mark.parametrize(
    ("streams", "reason"),
    [
        ([tactile("tactile_head"), tactile()], "no width of the same gripper"),
        ([width("width_left"), width("width_right"), tactile()], "no width of the same gripper"),
        ([width(), tactile(stored=False)], "no stored activity, which exumi prepare stores"),
        ([width(), tactile(values=np.zeros(999))], GRASPED),
        ([width(values=np.full(800, 0.05)), tactile()], GRASPED),
        ([width(clock=Clock(source="none", stamp_point="nominal_rate")), tactile()], NOMINAL),
        ([width(), tactile(clock=Clock(source="none", stamp_point="nominal_rate"))], NOMINAL),
    ],
)
def test_not_estimable(judged: Callable[..., Report], streams: list[Add], reason: str) -> None:
    report = judged(*streams)
    assert found(report) == []
    assert (reason, "streams/tactile") in skipped(report) or skipped(report) == [
        (reason, "streams/tactile_head")  # the first of several
    ]


def test_a_stream_alone_has_nothing_to_be_in_step_with(judged: Callable[..., Report]) -> None:
    assert skipped(judged(tactile())) == []


def test_without_touch_there_is_nothing_to_compare(judged: Callable[..., Report]) -> None:
    assert skipped(judged(width(), pose())) == [("no tactile stream", "zarr.json")]


PROBE = Embodiment(name="probe", gripper="none")
RESTING = width(values=np.full(800, CONTACT_M))


@pytest.mark.parametrize(
    ("late_ms", "code"),
    # Of a hand no less than three times 5 ms are known.
    [(0, None), (14, None), (-30, "SYNC-002"), (30, "SYNC-002"), (100, "SYNC-001")],
)
@pytest.mark.parametrize(
    ("streams", "changes"), [([], {"embodiment": PROBE}), ([RESTING], {})], ids=["probe", "resting"]
)
def test_taps(
    judged: Callable[..., Report],
    late_ms: int,
    code: str | None,
    streams: list[Add],
    changes: dict[str, Any],
) -> None:
    report = judged(*streams, tactile(), pose(late_ms * 1e-3), **changes)
    assert found(report) == ([(code, clock_of("pose"))] if code else [])


@pytest.mark.parametrize("changes", [{}, {"embodiment": Embodiment(name="hand")}])
def test_a_hand_that_may_grasp_is_not_judged_by_taps(
    judged: Callable[..., Report], changes: dict[str, Any]
) -> None:
    report = judged(tactile(), pose(0.1), **changes)
    assert found(report) == []
    assert ("no tap that tells", "streams/pose") in skipped(report)


def test_touch_that_is_out_of_step_judges_no_pose(judged: Callable[..., Report]) -> None:
    report = judged(width(), tactile(late_s=0.1), pose())
    assert found(report) == [("SYNC-001", clock_of("tactile"))]
    assert skipped(report) == [("no tap that tells", "streams/pose")]


@pytest.mark.parametrize("block_bytes", [1 << 10, 1 << 22])
def test_as_many_samples_are_taken_however_they_are_read(
    good: Path, monkeypatch: pytest.MonkeyPatch, block_bytes: int
) -> None:
    monkeypatch.setattr(curves, "_MOST_SAMPLES", 3)
    monkeypatch.setattr(context, "_BLOCK_BYTES", block_bytes)
    store = FolderStore(good)
    curve = curves.curve_of(
        EpisodeContext(store, list_folder(str(good))), "width", "streams/width/data"
    )
    store.close()
    assert not isinstance(curve, str)
    assert len(curve.time_ns) == len(curve.values) == 3


# ------------------------------------------------------------------------------- which one is late

LONG_S = 16.0


def played(
    *, touch_s: float = 0.0, width_s: float = 0.0, pose_s: float = 0.0, fingers: int = 1
) -> list[Add]:
    """Two grasps by a still hand, then two taps by a still gripper; each stream late by so much."""
    grasping, half = np.arange(0, LONG_S, 0.01), LONG_S / 2

    def add_width(writer: EpisodeWriter) -> None:
        opening = np.where(grasping < half, width_m(grasping), width_m(np.zeros(1))[0])
        writer.add_stream("width", kind="width", clock=CLOCK).append(
            as_ns(grasping + width_s), opening
        )

    def add_pose(writer: EpisodeWriter) -> None:
        time_s = np.arange(0, LONG_S, 1 / 90)
        data = np.zeros((len(time_s), 7))
        data[:, 1] = np.where(time_s < half, width_m(np.zeros(1))[0], width_m(time_s))
        data[:, 6] = 1.0
        frames = Frames(parent="world", child="tcp")
        writer.add_stream("pose", kind="pose", clock=CLOCK, frames=frames).append(
            as_ns(time_s + pose_s), data
        )

    names = ["tactile_left", "tactile_right"][:fingers]
    return [add_width, add_pose, *(tactile(n, touch_s, seconds=LONG_S) for n in names)]


@pytest.mark.parametrize(
    ("late", "expected"),
    [
        ({}, []),
        ({"width_s": 0.08}, [("SYNC-001", "width")]),
        ({"width_s": -0.08, "fingers": 2}, [("SYNC-001", "width")]),
        ({"width_s": 0.03}, [("SYNC-002", "width")]),
        # Touch and pose against each other are out of step too: it is touch.
        ({"touch_s": 0.08}, [("SYNC-001", "tactile_left")]),
        ({"touch_s": 0.08, "width_s": 0.08}, [("SYNC-001", "pose")]),
        ({"pose_s": 0.08}, [("SYNC-001", "pose")]),
        # Nothing agrees with anything.
        ({"width_s": 0.08, "pose_s": -0.08}, [("SYNC-001", "tactile_left")]),
        # The pose is in step with touch, and hardly out of step with the width.
        ({"width_s": 0.012}, [("SYNC-002", "tactile_left")]),
    ],
)
def test_two_against_one(
    judged: Callable[..., Report], late: dict[str, Any], expected: list[tuple[str, str]]
) -> None:
    report = judged(*played(**late))
    assert found(report) == [(code, clock_of(name)) for code, name in expected]


def test_who_agrees_is_named(judged: Callable[..., Report]) -> None:
    (problem,) = judged(*played(width_s=0.2, fingers=2)).problems
    assert problem.message.startswith("by 2 grasps, width is 20")
    assert "ms late relative to tactile_left, tactile_right and pose, beyond" in problem.message


def test_one_finger_that_agrees_with_the_width_clears_it(judged: Callable[..., Report]) -> None:
    streams = played(fingers=2)
    streams[-1] = tactile("tactile_right", 0.08, seconds=LONG_S)
    assert found(judged(*streams)) == [("SYNC-001", clock_of("tactile_right"))]


# ------------------------------------------------------------------------------- clocks that step


def stepping(by_s: float, *, host: bool, at_s: float = 4.0) -> Add:
    """Add a tactile stream whose clock is set in the middle of the episode."""

    def set_clock(time_s: np.ndarray) -> np.ndarray:
        return np.where(time_s >= at_s, time_s + by_s, time_s)

    beside: dict[str, Any] = {"time_host": as_ns} if host else {}
    return tactile(times=set_clock, **beside)


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        (stepping(0.2, host=False), ["TIME-006"]),
        (stepping(0.2, host=True), ["CLOCK-005", "TIME-006"]),
        # Before the first event: it cannot be told from a latency.
        (stepping(0.2, host=False, at_s=0.3), ["SYNC-001", "TIME-006"]),
    ],
)
def test_a_clock_that_steps_has_no_latency(
    judged: Callable[..., Report], stream: Add, expected: list[str]
) -> None:
    report = judged(width(), stream)
    assert sorted({problem.code for problem in report.problems}) == expected
    stepped = ("its clock steps", "streams/tactile")
    assert (stepped in skipped(report)) == ("SYNC" not in "".join(expected))


def test_a_gap_without_a_step_hides_no_latency(judged: Callable[..., Report]) -> None:
    def lose(time_s: np.ndarray) -> np.ndarray:
        return np.where(time_s >= 4.0, time_s + 0.2, time_s)

    values = activity(lose(frame_times(SECONDS)))
    report = judged(width(), tactile(late_s=0.1, values=values, times=lose))
    assert sorted({problem.code for problem in report.problems}) == ["SYNC-001", "TIME-006"]
