"""The lag of one curve behind another one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_data.synchronisation import LatencyEstimate, search_lag
from tests.exumi_data.synchronisation.gripping import as_ns


class Motion:
    """A smooth motion that never repeats itself, as a function of time."""

    def __init__(self, seed: int, lowest_hz: float = 0.2, highest_hz: float = 2.0) -> None:
        rng = np.random.default_rng(seed)
        self.frequency = rng.uniform(lowest_hz, highest_hz, 12)
        self.phase = rng.uniform(0, 2 * np.pi, 12)

    def __call__(self, time_s: np.ndarray) -> np.ndarray:
        waves = np.sin(2 * np.pi * self.frequency * time_s[:, None] + self.phase)
        return np.asarray(waves.mean(axis=1))


def searched(
    late_s: float,
    *,
    seed: int = 0,
    gain: float = 1.0,
    offset: float = 0.0,
    trend: float = 0.0,
    missing: float = 0.0,
    noise: float = 0.0,
    max_lag_s: float = 0.5,
) -> LatencyEstimate | None:
    rng, motion = np.random.default_rng(seed), Motion(seed)
    frames, samples = np.arange(0, 12, 1 / 30), np.arange(-1, 13, 1 / 90)
    frames = frames[rng.random(len(frames)) >= missing]
    samples = samples[rng.random(len(samples)) >= missing]
    a = gain * motion(frames) + offset + trend * frames
    a += abs(gain) * noise * rng.standard_normal(len(a))
    b = motion(samples)
    return search_lag(as_ns(frames + late_s), a, as_ns(samples), b, max_lag_s=max_lag_s)


@settings(max_examples=40, deadline=None)
@given(
    late_s=st.floats(-0.3, 0.3),
    seed=st.integers(0, 10_000),
    gain=st.floats(1e-3, 1e3) | st.floats(-1e3, -1e-3),
    offset=st.floats(-10, 10),
    trend=st.floats(-1, 1),
    missing=st.floats(0.0, 0.3),
)
def test_any_delay_is_found(
    late_s: float, seed: int, gain: float, offset: float, trend: float, missing: float
) -> None:
    found = searched(
        late_s, seed=seed, gain=gain, offset=offset, trend=trend * gain, missing=missing
    )
    assert found is not None
    assert found.offset_s == pytest.approx(late_s, abs=1e-3)


def test_the_uncertainty_fits_the_errors() -> None:
    found = [searched(0.1, seed=seed, noise=0.1) for seed in range(40)]
    away = [(f.offset_s - 0.1) / f.sigma_s for f in found if f is not None]
    assert len(away) == 40
    assert 0.6 < np.sqrt(np.mean(np.square(away))) < 1.5


def test_a_lag_beyond_the_range_is_not_estimated() -> None:
    assert searched(0.3, max_lag_s=0.2) is None
    assert searched(0.3, max_lag_s=0.4) is not None


def test_what_repeats_itself_is_ambiguous() -> None:
    time_s = np.arange(0, 12, 1 / 60)
    wave = np.sin(2 * np.pi * 3.0 * time_s)
    assert search_lag(as_ns(time_s + 0.05), wave, as_ns(time_s), wave) is None
    found = search_lag(as_ns(time_s + 0.05), wave, as_ns(time_s), wave, max_lag_s=0.1)
    assert found is not None
    assert found.offset_s == pytest.approx(0.05, abs=1e-3)


def test_what_does_not_tell() -> None:
    time_s = np.arange(0, 4, 1 / 60)
    time, wave = as_ns(time_s), Motion(1)(time_s)
    noise = np.random.default_rng(0).standard_normal(len(time))
    assert search_lag(time, np.zeros(len(time)), time, wave) is None
    assert search_lag(time, wave, time, np.ones(len(time))) is None
    assert search_lag(time, noise, time, wave) is None
    assert search_lag(time[:5], wave[:5], time, wave) is None
    assert search_lag(time + 10_000_000_000, wave, time, wave) is None


def test_arguments() -> None:
    time, wave = np.arange(20), np.zeros(20)
    with pytest.raises(ValueError, match="one time for each value"):
        search_lag(time, wave[:5], time, wave)
    with pytest.raises(ValueError, match="must be positive"):
        search_lag(time, wave, time, wave, step_s=0.0)
    with pytest.raises(ValueError, match="must be positive"):
        search_lag(time, wave, time, wave, max_lag_s=0.001)
