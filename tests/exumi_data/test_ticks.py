"""Ticks of the common timeline, and the tolerances around them."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.ticks import DEFAULT_TICK_S, image_tolerance_ns, max_gap_ns, tick_times_ns


@given(
    st.lists(st.integers(0, 10**8), min_size=1, max_size=20),
    st.fractions(min_value=Fraction(1, 1000), max_value=10, max_denominator=60_000),
)
def test_ticks_are_exact_however_long_the_episode(numbers: list[int], tick_s: Fraction) -> None:
    times = tick_times_ns(np.array(numbers), tick_s)
    for number, time in zip(numbers, times, strict=True):
        assert abs(Fraction(int(time)) - number * tick_s * 10**9) <= Fraction(1, 2)


def test_the_default_tick_is_three_frames_of_5994_fps() -> None:
    assert tick_times_ns(np.array([0, 1, 20_000]), DEFAULT_TICK_S).tolist() == [
        0,
        50_050_000,
        1_001_000_000_000,
    ]


def test_tolerances_follow_slow_streams() -> None:
    fast, slow = np.arange(10) * 5_000_000, np.arange(10) * 100_000_000
    assert image_tolerance_ns(fast, DEFAULT_TICK_S) == 50_050_000
    assert image_tolerance_ns(slow, DEFAULT_TICK_S) == 60_000_000
    assert max_gap_ns(fast) == 100_000_000
    assert max_gap_ns(slow) == 250_000_000
    assert image_tolerance_ns(fast[:1], Fraction(1, 10)) == 100_000_000
    assert max_gap_ns(fast[:0]) == 100_000_000


@given(st.lists(st.integers(1, 10**12), min_size=1, max_size=9))
def test_slow_is_told_by_the_median_period(periods: list[int]) -> None:
    time = np.cumsum([0, *periods])
    assert max_gap_ns(time) == round(max(1e8, 2.5 * float(np.median(periods))))
