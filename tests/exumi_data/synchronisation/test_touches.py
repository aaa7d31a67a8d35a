"""Latency of touch against the width."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_data.simulation import simulate_play
from exumi_data.synchronisation import LatencyEstimate, estimate_touch_latency
from exumi_data.tactile import ActivityMeter, to_grey
from tests.exumi_data.synchronisation.gripping import (
    activity,
    as_ns,
    counted,
    frame_times,
    width_m,
)


def grasped(
    late_s: float, *, seconds: float = 8.0, give: float = 0.6, speed: float = 1.0, seed: int = 0
) -> LatencyEstimate | None:
    frames, samples = frame_times(seconds, seed=seed), np.arange(0, seconds, 0.005)
    width = counted(width_m(samples, give, speed), seed)
    return estimate_touch_latency(
        as_ns(frames + late_s), activity(frames, give, speed), as_ns(samples), width
    )


@settings(max_examples=25, deadline=None)
@given(
    late_s=st.floats(-0.3, 0.3),
    give=st.floats(0.2, 1.0),
    speed=st.floats(0.8, 2.0),
    seed=st.integers(0, 1000),
)
def test_the_delay_is_found(late_s: float, give: float, speed: float, seed: int) -> None:
    found = grasped(late_s, give=give, speed=speed, seed=seed)
    assert found is not None
    assert abs(found.offset_s - late_s) < 3 * found.sigma_s
    assert found.sigma_s < 0.02


def test_delays_up_to_a_second() -> None:
    for late_s in (-0.9, 0.9):
        found = grasped(late_s)
        assert found is not None
        assert found.offset_s == pytest.approx(late_s, abs=0.01)


def test_more_grasps_tell_more() -> None:
    one, many = grasped(0.0, seconds=4.0), grasped(0.0, seconds=24.0)
    assert one is not None
    assert many is not None
    assert (one.n_events, many.n_events) == (1, 6)
    assert many.sigma_s < one.sigma_s


@pytest.mark.parametrize("seed", [3, 4])
def test_rendered_frames(seed: int) -> None:
    session = simulate_play(seed=seed, duration_s=5.0, tactile_size=(60, 80))
    width = session.streams["width"]
    assert width.data is not None
    for name in ("tactile_left", "tactile_right"):
        stream = session.streams[name]
        assert stream.reference is not None
        meter = ActivityMeter(stream.reference)
        values = np.array([meter.measure(to_grey(stream.render(i))) for i in range(len(stream))])
        found = estimate_touch_latency(stream.time_ns, values, width.time_ns, width.data)
        assert found is not None
        true_s = (stream.latency_ns - width.latency_ns) * 1e-9
        assert abs(found.offset_s - true_s) < 3 * found.sigma_s < 0.02


def test_what_does_not_tell() -> None:
    frames, samples = frame_times(8.0), np.arange(0, 8, 0.005)
    shown, opening = activity(frames), width_m(samples)
    still = np.full(len(samples), 0.03)
    for values, width in (
        (np.zeros(len(frames)), opening),
        (np.full(len(frames), 0.2), opening),
        (shown, still),
        (shown, counted(still)),
        (shown, 0.06 - opening),
    ):
        assert estimate_touch_latency(as_ns(frames), values, as_ns(samples), width) is None
    empty = np.array([])
    assert estimate_touch_latency(as_ns(empty), empty, as_ns(samples), opening) is None
    assert estimate_touch_latency(as_ns(frames), shown, as_ns(empty), empty) is None
    assert estimate_touch_latency(as_ns(frames), shown, as_ns(samples + 99), opening) is None


def test_a_width_that_stands_still_while_touch_grows_does_not_tell() -> None:
    frames, samples = frame_times(8.0), np.arange(0, 8, 0.005)
    # The fingers stop dead; what presses on is the motor's force.
    stopped = np.maximum(width_m(samples), 0.0299)
    found = estimate_touch_latency(as_ns(frames), activity(frames), as_ns(samples), stopped)
    assert found is None or abs(found.offset_s) < 3 * found.sigma_s


def test_a_stale_width_is_not_believed_much() -> None:
    frames, samples = frame_times(16.0), np.arange(0, 16, 0.01)
    held = np.repeat(width_m(samples[::15]), 15)[: len(samples)]
    found = estimate_touch_latency(as_ns(frames), activity(frames), as_ns(samples), held)
    assert found is None or abs(found.offset_s) < 3 * found.sigma_s
