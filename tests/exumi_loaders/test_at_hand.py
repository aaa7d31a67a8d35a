"""What is at hand: the definition, against a loop."""

from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_loaders.at_hand import at_hand, first_instant_ns, observation_times_ns

TIMES = st.lists(st.integers(-50, 50), max_size=12, unique=True).map(sorted)


@settings(max_examples=200, deadline=None)
@given(TIMES, st.lists(st.integers(-60, 80), min_size=1), st.integers(0, 20), st.integers(0, 20))
def test_the_newest_that_has_arrived(
    times: list[int], wanted: list[int], latency: int, stale: int
) -> None:
    if not times:
        return
    index, fresh = at_hand(np.array(times), np.array(wanted), latency, stale)
    for at, i, is_fresh in zip(wanted, index.tolist(), fresh.tolist(), strict=True):
        arrived = [t for t in times if t + latency <= at]
        assert i == len(arrived) - 1
        assert is_fresh == bool(arrived and at - latency - arrived[-1] <= stale)


def test_limits_are_met_exactly() -> None:
    index, fresh = at_hand(np.array([100, 200]), np.array([109, 110, 140, 141, 210]), 10, 30)
    assert index.tolist() == [-1, 0, 0, 0, 1]
    assert fresh.tolist() == [False, True, True, False, True]


def test_nothing_is_observed_before_all_streams_are_at_hand() -> None:
    assert first_instant_ns({"rgb": 5, "pose": 20}, {"rgb": 100, "pose": 0}) == 105
    times, padding = observation_times_ns(
        np.array([105, 200]), (-2, -1, 0), Fraction(40, 10**9), 105
    )
    assert times.tolist() == [[105, 105, 105], [120, 160, 200]]
    assert padding.tolist() == [[True, True, False], [False, False, False]]
