"""Combining estimates."""

import numpy as np
import pytest

from exumi_data.synchronisation import LatencyEstimate, combine


def one(offset_s: float, sigma_s: float = 0.002) -> LatencyEstimate:
    return LatencyEstimate(offset_s=offset_s, sigma_s=sigma_s, n_events=1, method="m")


def combined(*estimates: LatencyEstimate | None, floor_s: float = 0.0) -> LatencyEstimate:
    found = combine(estimates, floor_s=floor_s, method="all")
    assert found is not None
    return found


def test_equal_ones_average() -> None:
    found = combined(one(0.010), one(0.012), one(0.011), one(0.011))
    assert found.offset_s == pytest.approx(0.011)
    assert found.sigma_s == pytest.approx(0.001)
    assert (found.n_events, found.method) == (4, "all")


def test_better_ones_count_more() -> None:
    found = combined(one(0.0, 0.001), one(0.010, 0.010))
    assert found.offset_s == pytest.approx(0.010 / 101)


def test_what_all_share_is_not_averaged_out() -> None:
    found = combined(*[one(0.0)] * 400, floor_s=0.003)
    assert found.sigma_s == pytest.approx(0.003, rel=1e-2)


def test_scatter_makes_the_uncertainty_grow() -> None:
    offsets = np.random.default_rng(1).normal(0.0, 0.02, 50)
    found = combined(*(one(float(offset)) for offset in offsets))
    assert abs(found.offset_s) < 3 * found.sigma_s
    assert found.sigma_s > 5 * 0.002 / np.sqrt(50)


def test_a_wrong_one_does_little_harm() -> None:
    found = combined(one(0.001), one(-0.001), one(0.0), one(0.0005), one(0.5))
    assert abs(found.offset_s) < 0.002


def test_nothing_is_combined_to_nothing() -> None:
    assert combine([], floor_s=0.0, method="m") is None
    assert combine([None], floor_s=0.0, method="m") is None


def test_at_least_half_must_tell() -> None:
    assert combined(one(0.1), None).n_events == 1
    assert combine([one(0.1), None, None], floor_s=0.0, method="m") is None
