"""Simulated presses: what is harder or rougher leaves the stronger imprint, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from exumi_data.simulation.press import TouchedPart, make_parts, simulate_press

PART = TouchedPart("a", hardness=6, roughness=1, radius_m=0.02, grain_m=0.8e-3, seed=1)


def imprint(part: TouchedPart) -> float:
    """Mean difference to the pad without contact, over some presses, at the deepest."""
    presses = [simulate_press(part, seed=seed, frames=5) for seed in range(6)]
    return float(np.mean([np.abs(p.frames[2] - p.reference.astype(float)).mean() for p in presses]))


def test_what_is_harder_leaves_the_stronger_imprint() -> None:
    marks = [imprint(replace(PART, hardness=hardness)) for hardness in (0.0, 4.0, 10.0)]
    assert marks[0] < marks[1] < marks[2]


def test_what_is_rougher_leaves_the_finer_imprint() -> None:
    def detail(part: TouchedPart) -> float:
        press = simulate_press(part, seed=0, frames=5)
        changed = press.frames[2].astype(float) - press.reference
        return float(np.abs(np.diff(changed, axis=1)).mean())

    details = [detail(replace(PART, roughness=roughness)) for roughness in (0.0, 5.0, 8.0)]
    assert details[0] < details[1] < details[2]


def test_a_press_begins_and_ends_without_contact_and_is_the_same_again() -> None:
    press = simulate_press(PART, seed=3)
    assert press.frames.shape == (14, 96, 128, 3)
    assert press.frames.dtype == press.reference.dtype == np.uint8
    assert (np.diff(press.time_ns) == 40_000_000).all()
    away = np.abs(press.frames - press.reference.astype(float)).mean(axis=(1, 2, 3))
    assert away[[0, -1]].max() < 2  # noise
    assert 5 <= away.argmax() <= 8
    again, other = simulate_press(PART, seed=3), simulate_press(PART, seed=4)
    np.testing.assert_array_equal(press.frames, again.frames)
    assert (press.frames[6] != other.frames[6]).mean() > 0.5
    with pytest.raises(ValueError, match="at least 3"):
        simulate_press(PART, seed=0, frames=2)


def test_parts_differ_in_each_property_on_its_own() -> None:
    parts = make_parts(40, seed=0)
    assert parts == make_parts(40, seed=0) != make_parts(40, seed=1)
    hardness, roughness = np.array([(p.hardness, p.roughness) for p in parts]).T
    for values in (hardness, roughness):
        np.testing.assert_allclose(np.diff(np.sort(values)), 0.25, atol=0.011)
    assert abs(np.corrcoef(hardness, roughness)[0, 1]) < 0.35
    assert len({part.name for part in parts}) == 40
