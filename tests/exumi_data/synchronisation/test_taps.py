"""Latency of touch against a pose: a pad that is drawn while a hand presses it on a ball."""

import numpy as np
import pytest

from exumi_data.simulation.gel import Contact, GelPad
from exumi_data.simulation.gel_look import make_pad
from exumi_data.simulation.objects import height_map, object_by_name
from exumi_data.synchronisation import LatencyEstimate, estimate_tap_latency, find_touches
from exumi_data.tactile import ActivityMeter, to_grey
from tests.exumi_data.synchronisation.gripping import CONTACT_M, as_ns, frame_times, width_m

GEL_PART = 0.3
"""The object is soft: the gel takes a third of the way."""


def way_m(time_s: np.ndarray) -> np.ndarray:
    """Distance to the object: the hand comes, presses by 4 mm, and leaves."""
    return width_m(time_s, give=0.8, speed=1.5) - CONTACT_M


@pytest.fixture(scope="module")
def pad() -> GelPad:
    return make_pad((60, 80), dotted=False, seed=1)


def drawn(pad: GelPad, depths: np.ndarray) -> np.ndarray:
    heights = height_map(object_by_name("ball"), "left", pad.m_per_px)
    meter = ActivityMeter(pad.reference())
    frames = (pad.render(heights, Contact(d, 0, 0, 0), i) for i, d in enumerate(depths))
    return np.array([meter.measure(to_grey(frame)) for frame in frames])


def tapped(
    pad: GelPad, late_s: float, direction: tuple[float, float, float]
) -> LatencyEstimate | None:
    frames, samples = frame_times(12.0), np.arange(0, 12, 1 / 90)
    values = drawn(pad, GEL_PART * np.maximum(-way_m(frames), 0.0))
    noise = np.random.default_rng(2).normal(0.0, 1.5e-4, (len(samples), 3))
    place = way_m(samples)[:, None] * np.array(direction) + noise + 0.3
    taps = find_touches(as_ns(frames), values)
    return estimate_tap_latency(as_ns(frames + late_s), values, as_ns(samples), place, taps)


@pytest.mark.parametrize("late_s", [-0.08, 0.0, 0.02, 0.15])
@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8)])
def test_taps(pad: GelPad, late_s: float, direction: tuple[float, float, float]) -> None:
    found = tapped(pad, late_s, direction)
    assert found is not None
    assert found.n_events == 3
    assert abs(found.offset_s - late_s) < 3 * found.sigma_s < 0.03


def test_what_does_not_tell(pad: GelPad) -> None:
    assert tapped(pad, 0.0, (0.0, 0.0, 0.0)) is None, "the hand rests"
    none = np.zeros(0, np.int64)
    assert estimate_tap_latency(none, np.zeros(0), none, np.zeros((0, 3)), []) is None
