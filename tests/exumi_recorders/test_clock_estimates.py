"""A device's clock against the hub's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_recorders.clock_estimates import (
    RoundTrip,
    estimate_offset,
    estimate_one_way_drift,
    lower_hull,
)

MS = 1_000_000
DAY_NS = 86_400_000_000_000


def trip(offset: int, there: int, back: int, sent: int = DAY_NS, answering: int = MS) -> RoundTrip:
    received = sent + offset + there
    answered = received + answering
    return RoundTrip(sent, received, answered, answered - offset + back)


@given(st.integers(-DAY_NS, DAY_NS), st.integers(1, 50 * MS), st.integers(1, 50 * MS))
def test_the_offset_is_off_by_half_a_trip_at_most(offset: int, there: int, back: int) -> None:
    found = estimate_offset([trip(offset, there, back)])
    assert found is not None
    assert found.round_trip_ns == there + back
    assert abs(found.offset_ns - offset) <= (there + back) / 2 + 1
    assert found.sigma_ns == pytest.approx((there + back) / 12**0.5)


def test_the_shortest_trip_counts() -> None:
    found = estimate_offset(
        [trip(5, 20 * MS, 2 * MS), trip(5, 2 * MS, 2 * MS), trip(5, MS, 9 * MS)]
    )
    assert found is not None
    assert (found.offset_ns, found.round_trip_ns) == (5, 4 * MS)


def test_no_trip_no_offset() -> None:
    assert estimate_offset([]) is None
    assert estimate_offset([RoundTrip(100, 0, 50, 120)]) is None, "back before it was answered"


@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=40))
def test_nothing_lies_below_the_hull(y: list[int]) -> None:
    x = np.cumsum(np.arange(1, len(y) + 1))
    hull = lower_hull(x, y)
    assert (hull[0], hull[-1]) == (0, len(y) - 1)
    assert (np.asarray(y) >= np.interp(x, x[hull], np.asarray(y)[hull]) - 1e-9).all()
    slopes = np.diff(np.asarray(y)[hull]) / np.diff(x[hull])
    assert (np.diff(slopes) > 0).all()


def arrivals(
    seed: int, drift_ppm: float, seconds: float, jitter_ms: float
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    device = DAY_NS + (np.arange(int(90 * seconds)) * 1e9 / 90).astype(np.int64)
    since = device - device[0]
    delay = 2 * MS + rng.gamma(2.0, jitter_ms * MS / 2, len(device))
    delay[rng.random(len(device)) < 0.05] += 20 * MS
    arrival = 17 + since + np.round(since * drift_ppm * 1e-6 + delay).astype(np.int64)
    return device, arrival


@pytest.mark.parametrize("drift_ppm", [-43.0, 0.0, 12.5])
def test_drift_of_a_minute_over_wireless(drift_ppm: float) -> None:
    errors, sigmas = [], []
    for seed in range(40):
        found = estimate_one_way_drift(*arrivals(seed, drift_ppm, 60, 2.0))
        errors.append(found.drift_ppm - drift_ppm)
        sigmas.append(found.drift_sigma_ppm)
        assert found.jitter_ns == pytest.approx(2 * MS, rel=0.35)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert abs(np.mean(errors)) < 1.0
    assert rms < 3.0
    assert 0.4 < np.median(sigmas) / rms < 2.5, "the stated sigma is of the errors' size"


def test_without_jitter_it_is_exact() -> None:
    device = DAY_NS + np.arange(900) * 11_111_111
    arrival = 5 * DAY_NS + (device - device[0]) * 1_000_020 // 1_000_000
    found = estimate_one_way_drift(device, arrival)
    assert found.drift_ppm == pytest.approx(20, abs=1e-3)
    assert found.offset_ns == pytest.approx(4 * DAY_NS, abs=10)
    late = arrival - arrival[0] - found.fastest_arrival_ns(device)
    assert np.abs(late).max() < 10


def test_what_cannot_be_judged_is_refused() -> None:
    with pytest.raises(ValueError, match="16 messages"):
        estimate_one_way_drift(np.arange(15), np.arange(15))
    with pytest.raises(ValueError, match="increasing"):
        estimate_one_way_drift(np.zeros(20, np.int64), np.arange(20))
