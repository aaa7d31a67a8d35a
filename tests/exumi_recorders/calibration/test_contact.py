"""Latency of touch and images against the encoder, by grasps."""

import numpy as np
import pytest

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_recorders.calibration.contact import (
    contact_item,
    encoder_stops,
    image_latency,
    touch_latency,
)
from tests.exumi_data.synchronisation.gripping import (
    activity,
    as_ns,
    counted,
    frame_times,
    width_m,
)

SAMPLES = np.arange(0, 40, 0.005)


def closing_m(time_s: np.ndarray, period_s: float = 4.0) -> np.ndarray:
    """A gripper that closes at 40 mm/s until something rigid stops it, and opens again."""
    phase = time_s % period_s
    down = 0.06 - 0.04 * np.clip(phase - 0.5, 0.0, 1.0)
    up = 0.02 + 0.04 * np.clip(phase - 2.5, 0.0, 1.0)
    return np.where(phase < 2.0, down, up)


@pytest.mark.parametrize("late_s", [-0.02, 0.047, 0.11])
def test_touch(late_s: float) -> None:
    frames = frame_times(40.0)
    width = counted(width_m(SAMPLES))
    found = touch_latency(as_ns(frames + late_s), activity(frames), as_ns(SAMPLES), width)
    assert found.events == 10
    assert abs(found.latency_s - late_s) < 3 * found.sigma_s < 0.02
    item = contact_item(found, width_sigma_s=1e-3)
    assert item.value == round(found.latency_s * 1e9)
    assert item.uncertainty is not None
    assert item.uncertainty > found.sigma_s * 1e9


def test_too_few_grasps() -> None:
    frames = frame_times(8.0)
    samples = SAMPLES[SAMPLES < 8.0]
    with pytest.raises(CalibrationRefusedError, match="2 of 2 touches"):
        touch_latency(as_ns(frames), activity(frames), as_ns(samples), width_m(samples))
    with pytest.raises(CalibrationRefusedError, match="0 of 0 touches"):
        touch_latency(as_ns(frames), np.zeros(len(frames)), as_ns(samples), width_m(samples))


def test_where_the_encoder_stops() -> None:
    found = encoder_stops(as_ns(SAMPLES), counted(closing_m(SAMPLES), step_m=5e-5)) * 1e-9
    assert len(found) == 10
    assert found % 4.0 == pytest.approx(np.full(10, 1.5), abs=0.03)
    assert len(encoder_stops(as_ns(SAMPLES[:4]), closing_m(SAMPLES[:4]))) == 0


def energy_of(frames: np.ndarray, seed: int = 0) -> np.ndarray:
    """What images of moving fingers differ by, with noise."""
    rng = np.random.default_rng(seed)
    way = np.abs(np.diff(closing_m(frames)))
    return 0.3 + 800 * way + 0.05 * rng.standard_normal(len(way))


def test_images() -> None:
    frames = frame_times(40.0)
    found = image_latency(
        as_ns(frames + 0.08), energy_of(frames), as_ns(SAMPLES), closing_m(SAMPLES)
    )
    assert found.latency_s == pytest.approx(0.08, abs=0.004)
    assert found.sigma_s < 5e-3
    assert "fingers" in (contact_item(found).procedure or "")


def test_images_that_do_not_tell() -> None:
    frames = frame_times(40.0)
    noise = np.random.default_rng(0).standard_normal(len(frames) - 1)
    with pytest.raises(CalibrationRefusedError, match=r"do not show|is known to"):
        image_latency(as_ns(frames), noise, as_ns(SAMPLES), closing_m(SAMPLES))
    with pytest.raises(CalibrationRefusedError, match="too few"):
        image_latency(as_ns(frames[:3]), noise[:2], as_ns(SAMPLES), closing_m(SAMPLES))


def test_images_that_come_unevenly() -> None:
    """One frame in ten lost, 20 fps, an encoder of 0.16 mm: the error keeps to what is stated."""
    off, sigma = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        late_s = float(rng.uniform(-0.1, 0.15))
        frames = frame_times(40.0, 20.0, seed)
        frames = frames[rng.random(len(frames)) > 0.1]
        width = width_m(SAMPLES + 0.3 * np.sin(0.37 * SAMPLES))
        way = np.abs(np.diff(width_m(frames + 0.3 * np.sin(0.37 * frames))))
        energy = 0.5 + 4000 * way + 0.05 * rng.standard_normal(len(way))
        found = image_latency(as_ns(frames + late_s), energy, as_ns(SAMPLES), counted(width, seed))
        off.append(found.latency_s - late_s)
        sigma.append(found.sigma_s)
    assert np.sqrt(np.mean(np.square(off))) < 1e-3
    assert 0.4 < np.sqrt(np.mean(np.square(np.array(off) / sigma))) < 1.6
