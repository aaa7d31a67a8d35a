"""Live streams give what recorded windows give, and actions lead back to where they came from."""

import tracemalloc
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import exumi_data
from exumi_data.demo.dataset import DemoSettings, write_play_dataset
from exumi_data.errors import UsageError
from exumi_data.store import jpeg
from exumi_loaders import LateStreamError, PolicyStream, PolicyWindows
from tests.exumi_loaders.conftest import smooth_poses, width_m

STREAMS = ("tactile", "rgb", "pose", "width")


def jittered(rate: float, duration: float, seed: int, start: float = 0.0) -> np.ndarray:
    """Irregular times, as real ones are."""
    rng = np.random.default_rng(seed)
    count = round(rate * duration)
    return np.asarray(start + (np.arange(count) + rng.uniform(0, 0.8, count)) / rate)


def play(recipe: Any, **changes: Any) -> Any:
    """A short episode whose camera and tracker are gone for a while."""
    rgb, pose = jittered(30, 2.0, 1), jittered(90, 2.0, 2, 0.01)
    values: dict[str, Any] = {
        "tactile_s": jittered(25, 2.0, 0, 0.03),
        "rgb_s": rgb[(rgb < 0.7) | (rgb > 1.2)],
        "pose_s": pose[(pose < 1.0) | (pose > 1.4)],
        "width_s": jittered(150, 2.0, 3),
        "encoded": True,
        "channels": 3,
    }
    return recipe(**{**values, **changes})


def samples(episode: exumi_data.Episode, name: str, *, as_jpeg: bool) -> Iterator[tuple[int, Any]]:
    stream = episode[name]
    for index, time in enumerate(stream.time.tolist()):
        if not stream.is_image:
            yield time, stream.data[index]
        elif as_jpeg:
            yield time, stream.encoded(index)
        else:
            yield time, stream.frames[index]


def live(windows: PolicyWindows, episode: exumi_data.Episode, **options: Any) -> PolicyStream:
    spec = windows.policy_spec
    wanted = [name for name in spec.tactile if spec.streams[name].reference]
    references = {name: np.asarray(episode[name].reference) for name in wanted}
    return PolicyStream(spec, episode, references=references, **options)


def replay(
    windows: PolicyWindows, number: int, seed: int, *, as_jpeg: bool, every: int = 1
) -> Iterator[tuple[int, int, PolicyStream, dict[str, torch.Tensor]]]:
    """Push an episode's samples as they would arrive; yield the observation at each tick.

    Each sample takes between nothing and the stream's whole latency to arrive.
    """
    rng = np.random.default_rng(seed)
    with windows.episodes[number] as episode:
        stream = live(windows, episode)
        arriving = []
        for name, spec in windows.policy_spec.streams.items():
            for time, sample in samples(episode, name, as_jpeg=as_jpeg):
                delay = int(rng.integers(0, spec.latency_ns, endpoint=True))
                arriving.append((time + delay, name, time, sample))
    arriving.sort(key=lambda arrival: arrival[0])
    position = 0
    for index in np.flatnonzero(windows._episode == number).tolist()[::every]:
        now = int(windows._time_ns(np.array([index]))[0])
        while position < len(arriving) and arriving[position][0] <= now:
            stream.push(*arriving[position][1:])
            position += 1
        yield index, now, stream, stream.observation(now)


def assert_same(live_one: dict[str, torch.Tensor], recorded: dict[str, torch.Tensor]) -> None:
    assert list(live_one) == list(recorded)
    for name, value in recorded.items():
        found = live_one[name]
        assert (found.shape, found.dtype) == (value.shape, value.dtype), name
        assert found.stride() == value.stride(), name
        assert found.numpy().tobytes() == value.numpy().tobytes(), name


def test_live_and_recorded_are_the_same_bytes(make_dataset: Any, recipe: Any) -> None:
    dataset = make_dataset(play(recipe))
    latency = st.fixed_dictionaries(
        dict.fromkeys(STREAMS, st.one_of(st.just(0.0), st.floats(0, 0.3)))
    )
    seen = {"stale": 0, "padded": 0, "fresh": 0}

    @settings(max_examples=20, deadline=None)
    @given(
        latency,
        st.integers(1, 3),
        st.integers(1, 2),
        st.sampled_from([Fraction(1, 20), Fraction(1001, 20000), Fraction(1, 30)]),
        st.sampled_from(["relative", "absolute"]),
        st.booleans(),
        st.booleans(),
        st.integers(0, 2**32),
    )
    def check(
        late: Any,
        steps: int,
        stride: int,
        tick: Fraction,
        action: Any,
        grey: Any,
        jpegs: Any,
        seed: int,
    ) -> None:
        windows = PolicyWindows(
            dataset,
            tick_s=tick,
            observation_steps=steps,
            observation_stride=stride,
            latency_s=late,
            stale_s=0.15,
            action=action,
            grey_tactile=grey and jpegs,
            cache=False,
        )
        replayed = replay(windows, 0, seed, as_jpeg=jpegs, every=2)
        for index, _, stream, observation in replayed:  # noqa: B007  # the last one is looked at
            recorded = windows.observation(windows[index])
            assert_same(observation, recorded)
            seen["stale"] += not recorded["rgb_valid"].all()
            seen["padded"] += bool(recorded["observation_padding"].any())
            seen["fresh"] += bool(recorded["rgb_valid"].all())
        assert {name: counts.late for name, counts in stream.counts.items()} == dict.fromkeys(
            STREAMS, 0
        )

    check()
    assert min(seen.values()) > 10, seen


def test_two_grippers_and_lossless_frames(make_dataset: Any, recipe: Any) -> None:
    grippers = {"left": 0.0, "right": 0.2}
    dataset = make_dataset(play(recipe, encoded=False, channels=1, grippers=grippers))
    windows = PolicyWindows(
        dataset, cache=False, latency_s={"pose_right": 0.04, "rgb": 0.1}, observation_steps=3
    )
    count = 0
    for index, _, _, observation in replay(windows, 0, 5, as_jpeg=False):
        assert "between" in observation
        assert_same(observation, windows.observation(windows[index]))
        count += 1
    assert count == len(windows) > 20


def test_a_simulated_session_replayed(tmp_path: Path) -> None:
    dataset = write_play_dataset(tmp_path / "demo", DemoSettings(seconds=5.0), workers=1)
    late = {"rgb": 0.12, "tactile_left": 0.04, "tactile_right": 0.06, "pose": 0.02, "width": 0.005}
    windows = PolicyWindows(dataset, cache=False, latency_s=late)
    checked = 0
    for index, now, stream, observation in replay(windows, 0, 3, as_jpeg=True, every=7):
        item = windows[index]
        assert_same(observation, windows.observation(item))
        if not item["valid"]:
            continue
        targets = stream.absolute_targets(item["action"], now)
        with dataset[0] as episode:
            time, poses = episode["pose"].time, episode["pose"].data
        for k, at in enumerate(targets.time_ns.tolist()):
            near = int(np.abs(time - at).argmin())  # the tracker runs at 72 Hz: within 7 ms
            assert np.linalg.norm(targets.pose["pose"][k, :3] - poses[near, :3]) < 0.01
        checked += 1
    assert checked > 2


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 4), st.sampled_from(["relative", "absolute"]))
def test_actions_lead_back(seed: int, steps: int, action: str) -> None:
    """What `motion_columns` makes of targets, `absolute_targets` makes of the action again."""
    from exumi_loaders.actions import motion_columns

    rng = np.random.default_rng(seed)
    spec, rig = a_spec(steps, action)
    base = random_poses(rng, 1)
    wanted = random_poses(rng, steps)
    widths = rng.uniform(0, 0.1, steps)
    stream = PolicyStream(spec, rig)
    stream.push("rgb", 0, np.zeros((4, 4, 3), np.uint8))
    stream.push("pose", 0, base[0])
    stream.push("width", 0, widths[0])
    stream.observation(1000)
    numbers = motion_columns(
        spec.layout.grippers,
        {"pose": wanted[None], "width": widths[None]},
        {"pose": base[None]} if action == "relative" else None,
    )[0]
    targets = stream.absolute_targets(torch.from_numpy(numbers), 1000)
    np.testing.assert_allclose(targets.pose["pose"][:, :3], wanted[:, :3], atol=2e-6)
    turn = Rotation.from_quat(targets.pose["pose"][:, 3:]) * Rotation.from_quat(wanted[:, 3:]).inv()
    assert turn.magnitude().max() < 2e-6
    np.testing.assert_allclose(targets.width["width"], widths, atol=1e-8)
    assert (np.diff(targets.time_ns) == 50_000_000).all()
    assert targets.time_ns[0] == 50_001_000


def random_poses(rng: np.random.Generator, count: int) -> np.ndarray:
    quaternions = Rotation.random(count, random_state=int(rng.integers(2**31))).as_quat()
    return np.concatenate((rng.uniform(-1, 1, (count, 3)), quaternions), axis=1)


def a_spec(steps: int = 4, action: str = "relative", **changes: Any) -> Any:
    """A spec and the metadata of its rig, without a dataset."""
    from exumi_data.model import EpisodeMetadata
    from exumi_loaders import PolicySpec

    clock = {"source": "test", "stamp_point": "simulated"}
    images = {"encoding": "array", "height": 4, "width": 4, "channels": 3}
    low = {"latency_ns": 0, "stale_ns": 50_000_000}
    frames = {"parent": "world", "child": "tcp"}
    rig = {
        "id": "00000000-0000-4000-8000-000000000000",
        "task": {"name": "test"},
        "regime": "demonstration",
        "licence": "CC0-1.0",
        "source": {"type": "simulated", "tool": "test", "tool_version": "1"},
        "streams": {
            "rgb": {"kind": "rgb", "clock": clock, "arrays": ["time", "data"], "images": images},
            "pose": {"kind": "pose", "clock": clock, "arrays": ["time", "data"], "frames": frames},
            "width": {"kind": "width", "clock": clock, "arrays": ["time", "data"]},
        },
    }
    spec = PolicySpec.model_validate(
        {
            "tick_s": "1/20",
            "observation_steps": (-1, 0),
            "action_steps": tuple(range(1, steps + 1)),
            "action": action,
            "proprioception": True,
            "tactile": (),
            "rgb": ("rgb",),
            "pose": ("pose",),
            "width": ("width",),
            "streams": {
                "rgb": {"kind": "rgb", "height": 4, "width": 4, "channels": 3, **low},
                "pose": {"kind": "pose", "parents": ("world",), "child": "tcp", **low},
                "width": {"kind": "width", **low},
            },
            "dataset": "0" * 64,
            **changes,
        }
    )
    return spec, EpisodeMetadata.model_validate(rig)


def a_stream(**options: Any) -> PolicyStream:
    spec, rig = a_spec()
    return PolicyStream(spec, rig, **options)


def push_all(stream: PolicyStream, time_ns: int, value: int = 0) -> None:
    stream.push("rgb", time_ns, np.full((4, 4, 3), value, np.uint8))
    stream.push("pose", time_ns, smooth_poses([time_ns / 1e9])[0])
    stream.push("width", time_ns, width_m([time_ns / 1e9])[0])


def test_other_rigs_are_refused(make_dataset: Any, recipe: Any) -> None:
    known = {"tcp": [0, 0, 0.1], "intrinsics/rgb": [1]}
    dataset = make_dataset(play(recipe, calibration=known), name="trained")
    windows = PolicyWindows(dataset, cache=False)

    def rig(**changes: Any) -> exumi_data.Episode:
        changes = {"calibration": known, **changes}
        other: exumi_data.Dataset = make_dataset(play(recipe, **changes), name=f"rig{len(made)}")
        return other[0]

    made: list[str] = []
    cases: list[tuple[dict[str, Any], str]] = [
        ({"side": 16}, "frames .* of tactile: the rig has \\(16, 16, 3\\)"),
        ({"child": "flange"}, "child frame .* of pose: the rig has 'flange'"),
        ({"calibration": {**known, "tcp": [0, 0, 0.2]}}, "calibration of pose"),
        ({"calibration": {"tcp": [0, 0, 0.1]}}, "calibration of rgb .none is stated"),
        ({"pose_s": None}, "needs a pose stream 'pose'"),
    ]
    for changes, message in cases:
        with rig(**changes) as other, pytest.raises(UsageError, match=message):
            live(windows, other)
        made.append(message)
    with rig(calibration={"tcp": [0, 0, 0.2], "intrinsics/rgb": [1]}) as other:
        live(windows, other, accept=("pose",))
    with rig(parents={"pose": "table"}) as other:
        made.append("absolute")
        live(windows, other)  # what is relative has no parent
        absolute = PolicyWindows(dataset, cache=False, action="absolute")
        with pytest.raises(UsageError, match="parent frame of pose: the rig has 'table'"):
            live(absolute, other)
    with dataset[0] as same, pytest.raises(UsageError, match="expected of tactile"):
        PolicyStream(windows.policy_spec, same)


def test_missing_streams_are_one_error() -> None:
    stream = a_stream()
    stream.push("rgb", 0, np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(LateStreamError, match="no sample at hand of pose, width"):
        stream.observation(10)
    push_all(stream, 100)
    with pytest.raises(LateStreamError, match="no sample at hand of pose, width"):
        stream.observation(99)  # captured later than the time that is asked for
    assert stream.observation(100)["proprioception_valid"].all()


def test_stale_streams_are_flagged_or_one_error() -> None:
    for mode in ("flag", "raise"):
        stream = a_stream(on_stale=mode)
        push_all(stream, 0, 9)
        stream.push("width", 60_000_000, 0.02)
        stream.observation(50_000_000)  # the limit itself
        if mode == "raise":
            with pytest.raises(LateStreamError, match=r"rgb is 50 ms old .limit 50 ms., pose is"):
                stream.observation(50_000_001)
            continue
        late = stream.observation(50_000_001)
        assert late["rgb_valid"].tolist() == [True, False]
        assert late["proprioception_valid"].tolist() == [False, False]
        assert (late["rgb"][0] == 9).all()
        assert (late["rgb"][1] == 0).all()
        with pytest.raises(LateStreamError, match="pose was stale at 50000001"):
            stream.absolute_targets(np.zeros((4, 10)) + 0.1, 50_000_001)


def test_late_samples_are_counted_and_used_from_then_on() -> None:
    stream = a_stream()
    push_all(stream, 0, 1)
    assert (stream.observation(40_000_000)["rgb"][1] == 1).all()
    push_all(stream, 20_000_000, 2)
    assert {name: counts.late for name, counts in stream.counts.items()} == {
        "rgb": 1,
        "pose": 1,
        "width": 1,
    }
    push_all(stream, 41_000_000, 3)
    observation = stream.observation(80_000_000)
    assert (observation["rgb"][0] == 2).all()
    assert (observation["rgb"][1] == 3).all()
    assert stream.counts["rgb"].late == 1


def test_damaged_frames_are_black_and_counted_once() -> None:
    whole = jpeg.encode(np.random.default_rng(0).integers(0, 255, (4, 4, 3), dtype=np.uint8), 95)
    for damaged in (whole[: whole.index(b"\xff\xda") + 4], whole[:100], b"no picture", b""):
        stream = a_stream()
        push_all(stream, 0, 1)
        stream.push("rgb", 5, damaged)
        for now in (10, 20):
            observation = stream.observation(now)
            assert not observation["rgb_valid"][1]
            assert (observation["rgb"][1] == 0).all()
        assert stream.counts["rgb"].damaged == 1
        push_all(stream, 30, 3)
        assert stream.observation(40)["rgb_valid"][1]


@pytest.mark.parametrize(
    ("stream", "sample", "message"),
    [
        ("rgb", np.zeros((4, 5, 3), np.uint8), "trained on"),
        ("rgb", np.zeros((4, 4, 1), np.uint8), "trained on"),
        ("rgb", np.zeros((4, 4, 3)), "expected uint8"),
        ("rgb", jpeg.encode(np.zeros((8, 8, 3), np.uint8), 90), "trained on"),
        ("rgb", jpeg.encode(np.zeros((4, 4, 1), np.uint8), 90), "trained on"),
        ("pose", np.zeros(7), "no pose"),
        ("pose", np.array([0, 0, np.nan, 0, 0, 0, 1]), "no pose"),
        ("pose", np.zeros(6), "shape"),
        ("width", np.inf, "no width"),
        ("wrist", 1.0, "no stream 'wrist'"),
    ],
)
def test_what_is_no_sample_is_refused(stream: str, sample: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        a_stream().push(stream, 0, sample)


@pytest.mark.parametrize(
    ("action", "at", "message"),
    [
        (np.zeros((3, 10)), 100, "expected .4, 10."),
        (np.full((4, 10), np.nan), 100, "not finite"),
        (np.zeros((4, 10)), 100, "rotation"),
        (np.ones((4, 10)), 101, "no observation at 101"),
    ],
)
def test_wrong_actions_are_refused(action: np.ndarray, at: int, message: str) -> None:
    stream = a_stream()
    push_all(stream, 0)
    stream.observation(100)
    with pytest.raises(UsageError, match=message):
        stream.absolute_targets(action, at)


def test_samples_are_copied() -> None:
    stream, frame = a_stream(), np.full((4, 4, 3), 5, np.uint8)
    push_all(stream, 0)
    stream.push("rgb", 1, frame)
    frame[:] = 6
    first = stream.observation(10)["rgb"]
    assert (first[1] == 5).all()
    push_all(stream, 20, 7)
    stream.observation(30)
    assert (first[1] == 5).all()


def test_memory_is_bounded_with_and_without_observations() -> None:
    stream = a_stream(most_bytes=1000)  # 20 frames of 48 bytes
    for index in range(200):
        push_all(stream, index * 10_000_000, index % 256)
    assert stream.counts["rgb"].dropped == 180
    assert (stream.observation(1_990_000_000)["rgb"][1] == 199).all()
    stream = a_stream(slack_s=0.1)
    tracemalloc.start()
    sizes = []
    for index in range(3000):
        push_all(stream, index * 1_000_000, index % 256)
        if index % 10 == 0:
            stream.observation(index * 1_000_000)
        if index in (1000, 2990):
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert sizes[1] < sizes[0] + 100_000  # 6000 samples between the two would take ten times that
    assert max(len(buffer) for buffer in stream._buffers.values()) < 300
    with pytest.raises(UsageError, match="forgotten"):
        stream.observation(1_000_000_000)
    # A wild time far ahead takes nothing along.
    stream.push("rgb", 2**60, np.zeros((4, 4, 3), np.uint8))
    assert (stream.observation(2_999_000_000)["rgb"][1] == 2999 % 256).all()


def test_another_episode() -> None:
    stream = a_stream()
    push_all(stream, 10**12)
    stream.observation(10**12)
    stream.reset()
    push_all(stream, 0)
    observation = stream.observation(0)
    assert observation["observation_padding"].tolist() == [True, False]
    assert stream.counts["rgb"].late == 0
