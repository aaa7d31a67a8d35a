"""The sliding correlation against the plain one, lag by lag."""

import numpy as np
import pytest

from exumi_data.synchronisation.correlation import Sampled, SlidingCorrelation, sampled

STEP = 20_000_000


def curve(values: np.ndarray, known: np.ndarray, start: int = 0) -> Sampled:
    return Sampled(start, STEP, np.where(known, values, 0.0), known.astype(np.float64))


def test_every_lag_is_pearsons() -> None:
    rng = np.random.default_rng(3)
    long, short = 100.0 + rng.normal(size=300), 3.0 + rng.normal(size=40)
    known_long, known_short = rng.random(300) > 0.1, rng.random(40) > 0.1
    lag_ns, found = SlidingCorrelation(curve(long, known_long, 5 * STEP), 60).against(
        curve(short, known_short, -2 * STEP), overlap=0.5
    )
    assert len(found) == 300 + 40 - 1
    for lag, correlation in zip(lag_ns // STEP, found, strict=True):
        at = np.arange(40) - 2 + lag - 5
        inside = (at >= 0) & (at < 300)
        both = inside & known_short & known_long[np.clip(at, 0, 299)]
        if both.sum() < 0.5 * known_short.sum():
            assert correlation == -1.0
        else:
            expected = np.corrcoef(long[at[both]], short[both])[0, 1]
            assert correlation == pytest.approx(expected, abs=1e-9)


def test_a_part_of_the_curve_is_found_exactly() -> None:
    rng = np.random.default_rng(4)
    long = np.cumsum(rng.normal(size=5000))
    part = 0.3 * long[1234:1500] + 7.0
    every = np.ones(5000, dtype=bool)
    lag_ns, found = SlidingCorrelation(curve(long, every), 266).against(
        curve(part, every[:266]), overlap=0.9
    )
    assert lag_ns[found.argmax()] == 1234 * STEP
    assert found.max() == pytest.approx(1.0)


def test_what_does_not_move_is_like_nothing() -> None:
    every = np.ones(500, dtype=bool)
    sliding = SlidingCorrelation(curve(np.random.default_rng(5).normal(size=500), every), 50)
    assert (sliding.against(curve(np.full(50, 2.0), every[:50]), overlap=0.5)[1] == -1.0).all()


def test_a_grid_says_nothing_of_gaps() -> None:
    time_ns = np.concatenate([np.arange(0, 10**9, 10**7), np.arange(2 * 10**9, 3 * 10**9, 10**7)])
    values = np.sin(3e-9 * time_ns)
    found = sampled(time_ns, values, step_ns=STEP, max_gap_ns=5 * 10**7)
    at = found.start_ns + STEP * np.arange(len(found.values))
    known = found.known.astype(bool)
    assert not known[(at > 995_000_000) & (at < 1_995_000_000)].any()
    assert known[(at < 980_000_000) | (at > 2_000_000_000)].all()
    assert np.abs(found.values[known] - np.sin(3e-9 * at[known])).max() < 1e-3
