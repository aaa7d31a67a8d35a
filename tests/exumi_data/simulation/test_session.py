"""The streams of a play session: times, latencies, losses, and images that show the truth."""

import subprocess
import sys
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from exumi_data.simulation import (
    DEFAULT_LATENCY_NS,
    Finger,
    PlaySession,
    SimulatedStream,
    WidthEncoder,
    simulate_play,
)

SIZE = (120, 160)

UInt8Array = NDArray[np.uint8]
Pressed = tuple[NDArray[np.float64], UInt8Array, UInt8Array]


@pytest.fixture(scope="module")
def session() -> PlaySession:
    return simulate_play(seed=2, duration_s=10.0, tactile_size=SIZE, rgb_size=SIZE)


@pytest.fixture(scope="module")
def pressed(session: PlaySession) -> Pressed:
    """Every second frame of the left finger: true depths, the frames, and the reference."""
    stream = session.streams["tactile_left"]
    chosen = np.arange(0, len(stream), 2)
    depth = session.truth.contact_depth_m("left", stream.capture_time_ns[chosen] * 1e-9)
    frames = np.stack([stream.render(int(index)) for index in chosen])
    return depth, frames, reference_of(stream)


def reference_of(stream: SimulatedStream) -> UInt8Array:
    assert stream.reference is not None
    return stream.reference


def samples_of(stream: SimulatedStream) -> NDArray[Any]:
    assert stream.data is not None
    return stream.data


def counts_of(stream: SimulatedStream) -> NDArray[np.uint16]:
    assert stream.raw is not None
    return stream.raw


def activity(frame: UInt8Array, reference: UInt8Array) -> float:
    """exUMI's activity: the part of pixels whose grey differs clearly from the reference."""
    grey, flat = (
        cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in (frame, reference)
    )
    change = [
        cv2.resize(np.maximum(x, 0), (224, 224), interpolation=cv2.INTER_AREA)
        for x in (grey - flat, flat - grey)
    ]
    return float((np.maximum(*change) > 0.16 * 255 / 7).mean())


def test_streams_have_their_kinds_rates_shapes_and_types(session: PlaySession) -> None:
    expected = {
        "tactile_left": ("tactile", 30.0),
        "tactile_right": ("tactile", 30.0),
        "rgb": ("rgb", 30.0),
        "pose": ("pose", 90.0),
        "width": ("width", 200.0),
    }
    assert list(session.streams) == list(expected)
    for name, (kind, rate_hz) in expected.items():
        stream = session.streams[name]
        assert (stream.name, stream.kind, stream.rate_hz) == (name, kind, rate_hz)
        assert len(stream) == 10 * rate_hz
        assert stream.time_ns.dtype == np.int64
        assert (np.diff(stream.time_ns) > 0).all()
        assert stream.capture_time_ns[0] >= 0
        assert stream.capture_time_ns[-1] <= 10e9
        np.testing.assert_allclose(np.median(np.diff(stream.time_ns)), 1e9 / rate_hz, rtol=0.02)
        if stream.is_image:
            image = stream.render(3)
            assert image.shape == (*SIZE, 3)
            assert image.dtype == np.uint8
            np.testing.assert_array_equal(image, stream.render(3 - len(stream)))
    pose, width = samples_of(session.streams["pose"]), samples_of(session.streams["width"])
    raw = counts_of(session.streams["width"])
    assert [x.shape for x in (pose, width, raw)] == [(900, 7), (2000,), (2000,)]
    assert [x.dtype.name for x in (pose, width, raw)] == ["float64", "float32", "uint16"]
    assert reference_of(session.streams["tactile_left"]).shape == (*SIZE, 3)


def test_same_seed_same_session_other_seed_other_session(session: PlaySession) -> None:
    again = simulate_play(seed=2, duration_s=10.0, tactile_size=SIZE, rgb_size=SIZE)
    other = simulate_play(seed=3, duration_s=10.0, tactile_size=SIZE, rgb_size=SIZE)
    for name, stream in session.streams.items():
        np.testing.assert_array_equal(stream.time_ns, again.streams[name].time_ns)
        assert not np.array_equal(stream.time_ns, other.streams[name].time_ns)
        if stream.is_image:
            for index in (0, 150):
                image = stream.render(index)
                np.testing.assert_array_equal(image, again.streams[name].render(index))
                assert not np.array_equal(image, other.streams[name].render(index))
        else:
            data = samples_of(stream)
            np.testing.assert_array_equal(data, samples_of(again.streams[name]))
            assert not np.array_equal(data, samples_of(other.streams[name]))


def test_tactile_frames_differ_from_the_reference_only_in_contact(pressed: Pressed) -> None:
    depth, frames, reference = pressed
    difference = np.abs(frames.astype(np.int16) - reference).mean(axis=(1, 2, 3))
    noise = difference[depth == 0]
    assert np.ptp(noise) < 0.1
    assert (difference[depth > 0.05e-3] > noise.max() + 0.1).all()
    assert (depth > 0.05e-3).sum() > 40


def test_activity_follows_the_depth(pressed: Pressed) -> None:
    depth, frames, reference = pressed
    active = np.array([activity(frame, reference) for frame in frames])
    assert (active[depth == 0] == 0).all()
    assert (active[depth > 0.2e-3] > 1e-3).all()
    change = np.abs(frames.astype(np.int16) - reference).mean(axis=(1, 2, 3))
    half = len(depth) // 2  # one grasp in each half, of objects of different shape
    for part in (slice(0, half), slice(half, None)):
        assert np.corrcoef(active[part], depth[part])[0, 1] > 0.9
        assert np.corrcoef(change[part], depth[part])[0, 1] > 0.98


def test_declared_latency_shifts_stamps_and_nothing_else(session: PlaySession) -> None:
    late = simulate_play(
        seed=2,
        duration_s=10.0,
        tactile_size=SIZE,
        rgb_size=SIZE,
        latency_ns={"tactile_left": 200_000_000, "pose": 0},
    )
    for name, stream in session.streams.items():
        shift_ns = late.streams[name].latency_ns - DEFAULT_LATENCY_NS[name]
        np.testing.assert_array_equal(late.streams[name].time_ns - stream.time_ns, shift_ns)
    image = late.streams["tactile_left"].render(150)
    np.testing.assert_array_equal(image, session.streams["tactile_left"].render(150))


@pytest.mark.parametrize("finger", ["left", "right"])
def test_contact_seen_in_images_lags_by_the_declared_latency(
    session: PlaySession, finger: Finger
) -> None:
    stream = session.streams[f"tactile_{finger}"]
    reference = reference_of(stream)
    for grasp in session.grasps:
        near = np.flatnonzero(np.abs(stream.capture_time_ns * 1e-9 - grasp.t_contact_s) < 0.3)
        level = np.array(
            [np.abs(stream.render(int(i)).astype(int) - reference).mean() for i in near]
        )
        first = near[np.flatnonzero(level > level[0] + 0.06)[0]]
        seen_s = (stream.time_ns[first] - stream.latency_ns) * 1e-9
        # The first frame taken after contact, or the one after it.
        assert 0.0 <= seen_s - grasp.t_contact_s < 2.5 / stream.rate_hz
        assert stream.time_ns[first] * 1e-9 - grasp.t_contact_s > stream.latency_ns * 1e-9


def test_pose_and_width_are_the_truth_of_their_capture_time(session: PlaySession) -> None:
    pose, width = session.streams["pose"], session.streams["width"]
    pose_data, width_data = samples_of(pose), samples_of(width)
    true_pose = session.truth.pose(pose.capture_time_ns * 1e-9)
    error = np.linalg.norm(pose_data[:, :3] - true_pose[:, :3], axis=1)
    assert np.sqrt((error**2).mean()) < 0.4e-3
    np.testing.assert_allclose(np.linalg.norm(pose_data[:, 3:], axis=1), 1.0, atol=1e-9)
    assert ((pose_data[1:, 3:] * pose_data[:-1, 3:]).sum(axis=1) > 0.99).all()

    true_width = session.truth.width_m(width.capture_time_ns * 1e-9)
    assert np.abs(width_data - true_width).max() < 0.4e-3
    # Read at the stamps, latency forgotten, both are clearly wrong.
    late_pose = session.truth.pose(pose.time_ns * 1e-9)
    late = np.linalg.norm(pose_data[:, :3] - late_pose[:, :3], axis=1)
    assert np.sqrt((late**2).mean()) > 3 * np.sqrt((error**2).mean())


def test_encoder_wraps_within_the_travel_and_the_wrap_can_be_undone(session: PlaySession) -> None:
    width, encoder = session.streams["width"], session.encoder
    raw, data = counts_of(width), samples_of(width)
    jumps = np.abs(np.diff(raw.astype(int)))
    assert raw.max() < 4096
    assert (jumps > 2048).any()
    np.testing.assert_array_equal(encoder.width_m(raw), data)

    travel_m = np.linspace(-0.005, 0.11, 1001)
    back_m = WidthEncoder().width_m(WidthEncoder().counts(travel_m))
    np.testing.assert_allclose(back_m, travel_m, atol=0.5 / encoder.counts_per_m + 1e-7)
    # Unwrapping sample by sample, as a recorder does, gives the same widths.
    steps = (np.diff(raw.astype(int)) + 2048) % 4096 - 2048
    unwrapped = np.concatenate([[0], np.cumsum(steps)]) / encoder.counts_per_m + data[0]
    np.testing.assert_allclose(unwrapped, data, atol=1e-6)


def test_lost_samples_leave_gaps_in_times_and_sequence(session: PlaySession) -> None:
    lossy = simulate_play(seed=2, duration_s=10.0, tactile_size=SIZE, rgb_size=SIZE, drop=0.2)
    for name in ("tactile_left", "tactile_right", "rgb", "pose"):
        stream, whole = lossy.streams[name], session.streams[name]
        period_ns = 1e9 / stream.rate_hz
        assert 0.05 < 1 - len(stream) / len(whole) < 0.35
        gaps = np.diff(stream.sequence) > 1
        assert gaps.any()
        np.testing.assert_array_equal(np.diff(stream.time_ns) > 1.6 * period_ns, gaps)
        np.testing.assert_array_equal(stream.time_ns, whole.time_ns[stream.sequence])
        assert (np.diff(whole.sequence) == 1).all()
    assert len(lossy.streams["width"]) == len(session.streams["width"])
    image = lossy.streams["tactile_left"]
    assert image.render(len(image) - 1).shape == (*SIZE, 3)


def test_wrist_camera_shows_what_is_held_between_the_fingers() -> None:
    ball = simulate_play(seed=4, duration_s=5.0, objects=["ball"], tactile_size=(48, 64))
    stream, truth, shown = ball.streams["rgb"], ball.truth, 0
    for index in range(0, len(stream), 10):
        t_s = stream.capture_time_ns[index] * 1e-9
        if not truth.in_contact(t_s)[0]:
            continue
        y_m, z_m, _ = truth.contact_pose("left", t_s)[0]
        place = np.linalg.inv(ball.gripper_camera) @ [0.0, y_m, z_m, 1.0]
        column, row, _ = ball.camera_matrix @ (place[:3] / place[2])
        red, green, blue = stream.render(index).astype(int).transpose(2, 0, 1)
        yellow = (red > 100) & (green > 0.8 * red) & (blue < 0.55 * red)
        _, labels, stats, centres = cv2.connectedComponentsWithStats(yellow.astype(np.uint8))
        here = labels[round(row), round(column)]
        assert here > 0
        assert stats[here, cv2.CC_STAT_AREA] > 1000
        np.testing.assert_allclose(centres[here], [column, row], atol=5.0)
        shown += 1
    assert shown > 5


def test_objects_can_be_chosen_and_come_in_turn() -> None:
    session = simulate_play(
        duration_s=15.0, objects=["key", "ball"], tactile_size=(48, 64), rgb_size=(48, 64)
    )
    assert [grasp.object_name for grasp in session.grasps] == ["key", "ball", "key"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed"),
        ({"duration_s": 1.0}, "at least 3 seconds"),
        ({"duration_s": float("nan")}, "at least 3 seconds"),
        ({"objects": ["anvil"]}, "bolt, ball, cap, key, strawberry"),
        ({"objects": []}, "at least one"),
        ({"tactile_size": (8, 320)}, "tactile_size"),
        ({"rgb_size": (240, 8)}, "rgb_size"),
        ({"drop": 1.0}, "drop"),
        ({"latency_ns": {"audio": 1}}, "tactile_left, tactile_right, rgb, pose, width"),
        ({"latency_ns": {"pose": -1}}, "not be negative"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        simulate_play(**arguments)


def test_images_of_other_streams_and_beyond_the_end_are_refused(session: PlaySession) -> None:
    with pytest.raises(TypeError, match="has no images"):
        session.streams["pose"].render(0)
    with pytest.raises(IndexError, match="has 300 images"):
        session.streams["rgb"].render(300)


def test_import_is_light() -> None:
    code = "import sys, exumi_data.simulation; print({'cv2', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
