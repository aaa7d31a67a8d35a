"""The latency of poses by a sweep: found at any rate, refused where the data does not tell."""

import math
import re
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.simulation.sweep import SweepSettings, simulate_sweep
from exumi_data.synchronisation.sweep import (
    MarkerTrack,
    PoseTrack,
    SweepResult,
    estimate_sweep,
    latency_item,
)
from exumi_data.synchronisation.timing import CameraTiming, Range
from exumi_recorders.calibration.plot import draw_sweep, png

NONE = Range(0.0, 0.0)
PERFECT = CameraTiming(NONE, NONE)


def swept(seed: int = 0, **settings: float) -> SweepResult:
    return estimate_sweep(
        *simulate_sweep(SweepSettings(**settings), seed),  # type: ignore[arg-type]  # floats only
        camera=PERFECT,
        headset_lag_s=NONE,
    )


@pytest.mark.parametrize("rate_hz", [0.3, 0.5, 1.0, 1.75, 2.0])
def test_the_delay_is_found_at_every_rate(rate_hz: float) -> None:
    errors, sigmas = [], []
    for seed, delay_s in enumerate((-0.3, 0.0, 0.17)):
        found = swept(seed, rate_hz=rate_hz, delay_s=delay_s)
        assert found.refusals == ()
        errors.append(found.latency_s - delay_s)
        sigmas.append(found.sigma_s)
    assert float(np.sqrt(np.mean(np.square(errors)))) < 1e-3
    assert np.abs(np.array(errors) / np.array(sigmas)).max() < 3.5


def test_what_is_not_known_is_in_the_uncertainty() -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        settings = SweepSettings(
            delay_s=0.05,
            exposure_s=float(rng.uniform(1e-3, 16e-3)),
            readout_s=float(rng.uniform(8e-3, 16e-3)),
            headset_lag_s=float(rng.uniform(0, 20e-3)),
        )
        tracks = simulate_sweep(settings, seed)
        true = settings.delay_s + settings.headset_lag_s
        unknown = estimate_sweep(*tracks)
        assert abs(unknown.latency_s - true) < 2 * math.hypot(unknown.camera_s, unknown.noise_s)
        assert unknown.headset_s == pytest.approx(20e-3 / math.sqrt(6))
        assert unknown.sigma_s > 8e-3
        camera = CameraTiming(
            Range(settings.exposure_s, settings.exposure_s),
            Range(settings.readout_s, settings.readout_s),
        )
        known = estimate_sweep(*tracks, camera=camera, headset_lag_s=NONE)
        assert abs(known.latency_s - true) < 4 * known.sigma_s < 1e-3


def test_a_camera_that_stands_still() -> None:
    marker, pose = simulate_sweep(SweepSettings(delay_s=0.08), 3)
    # The marker moves with the hand: what it sees is the hand's position, turned.
    turn = cv2.Rodrigues(np.array([0.3, -0.2, 1.0]))[0]
    sampled = [np.interp(marker.time_ns, pose.time_ns - 80_000_000, p) for p in pose.poses.T[:3]]
    seen = np.stack(sampled, axis=1) @ turn.T + [0.0, 0.0, 1.0]
    found = estimate_sweep(
        replace(marker, position_m=seen), pose, camera=PERFECT, headset_lag_s=NONE
    )
    assert found.latency_s == pytest.approx(0.08, abs=5e-4)


Spoilt = Callable[[MarkerTrack, PoseTrack], tuple[MarkerTrack, PoseTrack]]


def frozen(marker: MarkerTrack, pose: PoseTrack) -> tuple[MarkerTrack, PoseTrack]:
    poses = pose.poses.copy()
    poses[len(poses) // 3 :] = poses[len(poses) // 3]
    return marker, PoseTrack(pose.time_ns, poses)


def still(marker: MarkerTrack, pose: PoseTrack) -> tuple[MarkerTrack, PoseTrack]:
    return replace(marker, position_m=0.01 * marker.position_m), pose


def few(marker: MarkerTrack, pose: PoseTrack) -> tuple[MarkerTrack, PoseTrack]:
    part = slice(None, None, 3)
    return MarkerTrack(
        marker.time_ns[part], marker.position_m[part], marker.row[part], marker.frames
    ), pose


def short(marker: MarkerTrack, pose: PoseTrack) -> tuple[MarkerTrack, PoseTrack]:
    part = slice(100, 300)
    return MarkerTrack(marker.time_ns[part], marker.position_m[part], marker.row[part], 200), pose


def apart(marker: MarkerTrack, pose: PoseTrack) -> tuple[MarkerTrack, PoseTrack]:
    return marker, PoseTrack(pose.time_ns + 60_000_000_000, pose.poses)


def stepped(marker: MarkerTrack, pose: PoseTrack) -> tuple[MarkerTrack, PoseTrack]:
    late = np.arange(len(marker.time_ns)) >= len(marker.time_ns) // 2
    return replace(marker, time_ns=marker.time_ns + 20_000_000 * late), pose


def unrelated(marker: MarkerTrack, pose: PoseTrack) -> tuple[MarkerTrack, PoseTrack]:
    return marker, simulate_sweep(SweepSettings(rate_hz=1.1), 99)[1]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (frozen, "explain|end of what was tried|moved by"),
        (still, r"the marker moved by \d mm only"),
        (few, "found in 20. of 719 frames"),
        (short, "seen for 4.* s"),
        (apart, "do not overlap"),
        (stepped, "second half of the sweep gives"),
        (unrelated, "explain|end of what was tried"),
    ],
)
def test_wrong_data_is_refused(spoil: Spoilt, said: str) -> None:
    tracks = spoil(*simulate_sweep(SweepSettings(), 5))
    try:
        refusals = estimate_sweep(*tracks).refusals
    except CalibrationRefusedError as error:
        refusals = (str(error),)
    assert refusals
    assert any(re.search(said, reason) for reason in refusals)


def test_what_repeats_itself_is_refused() -> None:
    found = swept(rate_hz=2.0, regular=True)
    assert any("the sweep repeats itself" in reason for reason in found.refusals)
    with pytest.raises(CalibrationRefusedError, match="repeats itself"):
        latency_item([found])


def test_a_delay_beyond_the_range_is_refused() -> None:
    tracks = simulate_sweep(SweepSettings(rate_hz=0.3, delay_s=0.7), 1)
    with pytest.raises(CalibrationRefusedError, match="at the end of what was tried"):
        estimate_sweep(*tracks)


def test_start_and_end_of_a_session() -> None:
    first, last = swept(1, delay_s=0.100), swept(2, delay_s=0.104)
    item = latency_item([first, last], apart_s=1000.0)
    assert item.value == pytest.approx(102e6, abs=0.3e6)
    assert item.uncertainty == pytest.approx(2e6, abs=0.3e6)
    assert item.unit == "ns"
    change_ms = 1e3 * (last.latency_s - first.latency_s)
    said = f"from the first to the last {change_ms:+.2f} ms, {change_ms:+.2f} ppm"
    assert said in (item.procedure or "")


def shown_apart_px(result: SweepResult, latency_ns: int) -> float:
    """How far marker and poses are apart in the second panel, pixels up or down."""
    image = draw_sweep(result, latency_ns)
    panel = image[332:582, 64:1136]
    blue = np.argwhere((panel == (178, 114, 0)).all(axis=2))
    orange = np.argwhere((panel == (0, 94, 213)).all(axis=2))
    apart = [
        abs(y - np.median(orange[orange[:, 1] == x, 0]))
        for y, x in blue[::7]
        if (orange[:, 1] == x).any()
    ]
    return float(np.mean(apart))


def test_the_picture_is_of_the_value_that_is_used() -> None:
    result = swept(3, rate_hz=1.2, delay_s=0.12)
    item = latency_item([result])
    assert shown_apart_px(result, item.value) < 6.0
    assert shown_apart_px(result, item.value + 60_000_000) > 15.0
    file = png(draw_sweep(result, item.value))
    read = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR)
    assert read is not None
    assert read.shape[1] == 1200


def test_ranges() -> None:
    with pytest.raises(ValueError, match="a range from"):
        Range(2.0, 1.0)
    camera = CameraTiming(Range(0.004, 0.004), Range(0.01, 0.01), stamped="end")
    assert camera.event_ns(np.array([0]), np.array([0.25])).tolist() == [-9_500_000]
    assert camera.sigma_s(0.25) == 0.0
    begin = replace(camera, stamped="start", readout_s=Range(0.0, math.sqrt(12)))
    assert begin.sigma_s(0.5) == pytest.approx(0.5)
