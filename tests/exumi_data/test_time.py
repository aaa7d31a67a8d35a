"""Clock arithmetic against exact rationals, and resampling against plain searches."""

import time
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.time import (
    Gap,
    apply_clock,
    bracket_indices,
    format_rate,
    format_utc,
    nearest_indices,
    nominal_times,
    parse_rate,
    parse_utc,
    rate_statistics,
    strictly_increasing,
)

ns = st.integers(-(2**40), 2**40)
any_ns = st.integers(-(2**62) + 1, 2**62 - 1)
increasing = st.lists(ns, min_size=1, max_size=30, unique=True).map(sorted)


# ------------------------------------------------------------------------------------------- rates


@pytest.mark.parametrize(
    ("text", "rate"),
    [("60000/1001", Fraction(60000, 1001)), ("25/1", Fraction(25)), ("25", Fraction(25))],
)
def test_rates_are_rational(text: str, rate: Fraction) -> None:
    assert parse_rate(text) == rate
    assert parse_rate(format_rate(rate)) == rate


def test_rates_are_written_with_a_denominator() -> None:
    assert format_rate(Fraction(60000, 1001)) == "60000/1001"
    assert format_rate(Fraction(25)) == "25/1"


@pytest.mark.parametrize(
    "text", ["", "0", "0/1", "25/0", "-25", "29.97", "25/", " 25", "٢٥", "1e3"]
)
def test_other_rates_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="rational number"):
        parse_rate(text)


def test_rates_that_are_not_positive_cannot_be_written() -> None:
    with pytest.raises(ValueError, match="positive"):
        format_rate(Fraction(0))


# ----------------------------------------------------------------------------------- nominal times


@given(
    n=st.integers(0, 200),
    rate=st.fractions(min_value=Fraction(1, 1000), max_value=100_000, max_denominator=10_000),
)
def test_nominal_times_are_the_rounded_rationals(n: int, rate: Fraction) -> None:
    times = nominal_times(n, rate)
    assert times.dtype == np.int64
    assert times.tolist() == [round(i * 10**9 / rate) for i in range(n)]


def test_nominal_times_stay_exact_over_an_hour_of_ntsc() -> None:
    n = 60 * 60 * 60
    times = nominal_times(n, Fraction(60000, 1001))
    assert times[-1] == round(Fraction((n - 1) * 10**9 * 1001, 60000))
    assert set(np.diff(times).tolist()) == {16_683_333, 16_683_334}


@pytest.mark.parametrize(
    ("n", "rate"),
    [(-1, Fraction(25)), (1, Fraction(0)), (2**40, Fraction(1)), (2, Fraction(2**70))],
)
def test_nominal_times_refuse_what_does_not_fit(n: int, rate: Fraction) -> None:
    with pytest.raises(ValueError, match=r"invalid|do not fit"):
        nominal_times(n, rate)


# ------------------------------------------------------------------------------------------- clock


@given(
    raw=st.lists(st.integers(0, 2**61), min_size=1, max_size=20),
    t_ref=st.integers(0, 2**61),
    drift_ppm=st.floats(-20_000, 20_000),
    offset_ns=ns,
    latency_ns=ns,
)
def test_clock_is_the_exact_formula_rounded(
    raw: list[int], t_ref: int, drift_ppm: float, offset_ns: int, latency_ns: int
) -> None:
    got = apply_clock(
        raw, t_ref=t_ref, drift_ppm=drift_ppm, offset_ns=offset_ns, latency_ns=latency_ns
    )
    rate = 1 + Fraction(drift_ppm) / 10**6
    for reading, value in zip(raw, got.tolist(), strict=True):
        exact = (reading - t_ref) * rate + offset_ns - latency_ns
        assert abs(exact - value) <= Fraction(1, 2) + Fraction(1, 10**6)


@given(raw=st.lists(any_ns, min_size=1, max_size=20))
def test_a_clock_without_corrections_changes_nothing(raw: list[int]) -> None:
    got = apply_clock(raw, t_ref=0, drift_ppm=0.0, offset_ns=0, latency_ns=0)
    assert got.tolist() == raw


def test_a_nanosecond_is_not_lost_at_the_end_of_the_range() -> None:
    raw = np.array([2**62 - 2, 2**62 - 1])
    got = apply_clock(raw, t_ref=0, drift_ppm=-1e-9, offset_ns=0, latency_ns=0)
    assert got[1] - got[0] == 1


def test_signs_of_the_terms() -> None:
    got = apply_clock([2_000_000], t_ref=1_000_000, drift_ppm=50, offset_ns=7, latency_ns=3)
    assert got.tolist() == [1_000_000 + 50 + 7 - 3]


@pytest.mark.parametrize(
    ("raw", "t_ref", "drift_ppm", "offset_ns"),
    [
        ([2**62], 0, 0.0, 0),
        ([2**62 - 1], 0, 100.0, 0),
        ([2**61], 0, 0.0, 2**61),
        ([2**61], -(2**61) - 5, 0.0, 0),
        ([0], 2**63, 0.0, 0),
        ([0], 0, 0.0, 2**70),
        ([0], 0, float("nan"), 0),
        ([0], 0, float("inf"), 0),
    ],
)
def test_clock_overflow_is_an_error(
    raw: list[int], t_ref: int, drift_ppm: float, offset_ns: int
) -> None:
    with pytest.raises(ValueError, match=r"range|within|invalid drift"):
        apply_clock(raw, t_ref=t_ref, drift_ppm=drift_ppm, offset_ns=offset_ns, latency_ns=0)


def test_raw_times_must_be_integers() -> None:
    with pytest.raises(ValueError, match="integers"):
        apply_clock([0.5], t_ref=0, drift_ppm=0.0, offset_ns=0, latency_ns=0)
    with pytest.raises(ValueError, match="one-dimensional"):
        apply_clock([[1]], t_ref=0, drift_ppm=0.0, offset_ns=0, latency_ns=0)


def test_no_raw_times_give_no_times() -> None:
    assert apply_clock([], t_ref=0, drift_ppm=0.0, offset_ns=0, latency_ns=0).shape == (0,)


# ------------------------------------------------------------------------------------------- order


@given(st.lists(any_ns, max_size=40))
def test_order_is_strict_and_only_what_must_move_moves(arrived: list[int]) -> None:
    got, nudged = strictly_increasing(arrived)
    assert (np.diff(got) > 0).all()
    assert (got >= np.array(arrived, dtype=np.int64)).all()
    expected: list[int] = []
    for stamp in arrived:
        expected.append(max([stamp, *(previous + 1 for previous in expected[-1:])]))
    assert got.tolist() == expected
    assert nudged.tolist() == [a != b for a, b in zip(expected, arrived, strict=True)]


@given(increasing)
def test_order_leaves_increasing_times_alone(times: list[int]) -> None:
    got, nudged = strictly_increasing(times)
    assert got.tolist() == times
    assert not nudged.any()


def test_ties_and_reversals_keep_their_order_of_arrival() -> None:
    got, nudged = strictly_increasing([10, 10, 5, 20])
    assert got.tolist() == [10, 11, 12, 20]
    assert nudged.tolist() == [False, True, True, False]


# ----------------------------------------------------------------------------------------- nearest


@given(times=increasing, ticks=st.lists(ns, max_size=30), tolerance=st.integers(0, 2**41))
def test_nearest_is_the_plain_search(times: list[int], ticks: list[int], tolerance: int) -> None:
    got = nearest_indices(times, ticks, tolerance)
    assert got.dtype == np.int32
    for tick, index in zip(ticks, got.tolist(), strict=True):
        best = min(range(len(times)), key=lambda i: abs(times[i] - tick))  # first = earliest
        assert index == (best if abs(times[best] - tick) <= tolerance else -1)


def test_nearest_edges() -> None:
    assert nearest_indices([0, 10], [5, -3, 13, 14], 3).tolist() == [-1, 0, 1, -1]
    assert nearest_indices([0, 10], [5], 5).tolist() == [0]  # a tie goes to the earlier
    assert nearest_indices([], [5], 5).tolist() == [-1]
    assert nearest_indices([0], [], 5).shape == (0,)
    with pytest.raises(ValueError, match="tolerance"):
        nearest_indices([0], [0], -1)


def test_nearest_survives_the_whole_range() -> None:
    limit = 2**62 - 1
    assert nearest_indices([-limit, limit], [limit, -limit, 0], limit).tolist() == [1, 0, 0]
    with pytest.raises(ValueError, match="within"):
        nearest_indices([0], [2**62], 1)


# ---------------------------------------------------------------------------------------- brackets


@given(times=increasing, ticks=st.lists(ns, max_size=30), max_gap=st.integers(0, 2**41))
def test_brackets_hold_the_tick(times: list[int], ticks: list[int], max_gap: int) -> None:
    lo, weight, valid = bracket_indices(times, ticks, max_gap)
    assert lo.dtype == np.int32
    assert weight.dtype == np.float64
    assert ((weight >= 0) & (weight < 1)).all()
    for tick, i, w, good in zip(ticks, lo.tolist(), weight.tolist(), valid.tolist(), strict=True):
        between = [k for k in range(len(times) - 1) if times[k] < tick < times[k + 1]]
        if tick in times:
            assert (good, i, w) == (True, times.index(tick), 0.0)
        elif between and times[between[0] + 1] - times[between[0]] <= max_gap:
            assert good
            assert i == between[0]
            assert times[i] + w * (times[i + 1] - times[i]) == pytest.approx(tick, abs=0.01)
        else:
            assert not good
            assert w == 0.0
            assert abs(times[i] - tick) == min(abs(t - tick) for t in times)


def test_an_exact_hit_beside_a_gap_is_valid() -> None:
    lo, weight, valid = bracket_indices([0, 10, 1000], [10, 11, 999, 1000, 1001], 50)
    assert valid.tolist() == [True, False, False, True, False]
    assert lo.tolist() == [1, 1, 2, 2, 2]
    assert weight.tolist() == [0.0] * 5


def test_brackets_need_samples_and_a_gap() -> None:
    with pytest.raises(ValueError, match="without samples"):
        bracket_indices([], [0], 1)
    with pytest.raises(ValueError, match="maximum gap"):
        bracket_indices([0], [0], -1)


# -------------------------------------------------------------------------------------- statistics


def test_statistics_of_a_regular_stream() -> None:
    stats = rate_statistics(nominal_times(101, Fraction(50)))
    assert stats.n == 101
    assert stats.duration_s == 2.0
    assert stats.rate_hz == 50.0
    assert stats.period_median_s == stats.period_max_s == 0.02
    assert stats.jitter_s == 0.0
    assert stats.gaps == ()


def test_gaps_are_found_and_do_not_lower_the_rate() -> None:
    times = nominal_times(100, Fraction(100))
    kept = np.delete(times, [10, 40, 41, 42])
    stats = rate_statistics(kept)
    assert stats.rate_hz == 100.0
    assert stats.gaps == (Gap(index=38, length_s=0.04),)  # one lost sample alone is no gap
    assert stats.gap_count == 1
    assert rate_statistics(kept, gap_factor=1.5).gap_count == 2


@given(st.integers(0, 2**32 - 1))
def test_jitter_estimates_the_standard_deviation_of_the_periods(seed: int) -> None:
    rng = np.random.default_rng(seed)
    periods = rng.normal(10e6, 0.2e6, 4000).astype(np.int64)
    periods[250::500] += 1_000_000_000
    stats = rate_statistics(np.cumsum(periods))
    assert stats.jitter_s == pytest.approx(0.2e-3, rel=0.1)
    assert stats.gap_count == 8


@pytest.mark.parametrize("times", [[], [5]])
def test_too_few_samples_have_no_rate(times: list[int]) -> None:
    stats = rate_statistics(times)
    assert (stats.n, stats.duration_s) == (len(times), 0.0)
    assert stats.rate_hz is None
    assert stats.period_median_s is stats.period_max_s is stats.jitter_s is None


def test_statistics_refuse_times_out_of_order() -> None:
    with pytest.raises(ValueError, match="not strictly increasing at sample 2"):
        rate_statistics([0, 10, 10])
    with pytest.raises(ValueError, match="gap factor"):
        rate_statistics([0, 10], gap_factor=1.0)


def test_the_module_does_not_hide_the_standard_library() -> None:
    assert time.monotonic_ns() > 0


@given(st.integers(-(2**61), 2**61))
def test_utc_survives_to_the_nanosecond(utc_ns: int) -> None:
    assert parse_utc(format_utc(utc_ns)) == utc_ns


def test_utc_is_read_as_it_is_written_by_others() -> None:
    assert parse_utc("1970-01-01T00:00:01.5Z") == 1_500_000_000
    assert parse_utc("2016-12-31T23:59:60Z") == parse_utc("2017-01-01T00:00:00Z")
    for wrong in ("", "2026-03-01", "2026-03-01T10:20:30", "2026-03-01T10:20:30+01:00"):
        with pytest.raises(ValueError, match="no UTC timestamp"):
            parse_utc(wrong)
