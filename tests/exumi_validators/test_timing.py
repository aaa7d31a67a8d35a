"""Rates, gaps, jitter, bursts, counters, overlap, steps, drift: what alarms, what must not."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_data.model import Clock, Gap
from exumi_data.simulation import simulate_play
from exumi_data.standard import flags, rules
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import DEFAULT_GAP_FACTOR, strictly_increasing
from exumi_validators import Problem, Report, validate
from exumi_validators.checks import clocks, coverage, timing
from exumi_validators.checks.coverage import missing_numbers
from tests.exumi_data.builders import CLOCK, metadata

Times = npt.NDArray[np.int64]

NOMINAL = Clock(source="none", stamp_point="nominal_rate")
DEVICE = Clock(source="device", stamp_point="device", raw_time="time_device")
MINE = {
    code for module in (timing, clocks, coverage) for check in vars(module).values()
    if hasattr(check, "rules") for code in check.rules
}  # fmt: skip
FAST = settings(max_examples=30, deadline=None)

rates = st.sampled_from([10.0, 15.0, 30.0, 59.94, 90.0, 200.0, 1000.0])
seeds = st.integers(0, 2**32 - 1)


def write(path: Path, streams: dict[str, dict[str, Any]]) -> Path:
    """An episode of streams of numbers; `time`, arrays and fields of the metadata by stream."""
    beside = ("time_host", "time_device", "sequence", "flags")
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        for name, given_ in streams.items():
            fields = {key: value for key, value in given_.items() if key not in ("time", *beside)}
            stream = writer.add_stream(
                name,
                kind="acme:number",
                extension_version="1",
                schema_url="https://acme.example/number.json",
                **{"clock": CLOCK, **fields},
            )
            arrays = {key: given_[key] for key in beside if key in given_}
            stream.append(given_["time"], np.zeros(len(given_["time"]), np.int16), **arrays)
    return path


def judge(time: Times, **fields: Any) -> Report:
    """The report on an episode of one stream."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "e.zarr", {"numbers": {"time": time, **fields}})
        report: Report = validate(path, levels=["hierarchy", "arrays"])
    assert report.coverage.unchecked == ()
    return report


def found(report: Report) -> list[tuple[str, int | None]]:
    return [(problem.code, problem.location.index) for problem in report.problems]


def only(report: Report) -> Problem:
    (problem,) = report.problems
    return problem


def skipped(report: Report) -> dict[str, str]:
    return {item.code: item.reason for item in report.coverage.skipped}


def regular(count: int, rate: float, *, jitter: float = 0.0, seed: int = 0) -> Times:
    """Times of a rate; each is off by a normal deviate, so that the intervals' jitter is `jitter`
    periods."""
    rng = np.random.default_rng(seed)
    place = np.arange(count) + rng.normal(0, 1, count).clip(-3, 3) * jitter / np.sqrt(2)
    return strictly_increasing(np.rint(place * 1e9 / rate).astype(np.int64))[0]


def flag(count: int, name: str, *places: int) -> npt.NDArray[np.int64]:
    """Flags of which one is set at some samples."""
    values = np.zeros(count, dtype=np.int64)
    values[list(places)] = flags()[name].mask
    return values


def test_the_gap_is_the_one_that_stats_count() -> None:
    assert rules()["TIME-006"].limits["medians"] == DEFAULT_GAP_FACTOR


def test_every_rule_of_the_section_is_judged_here() -> None:
    assert {code for code in rules() if rules()[code].anchor == f"quality.md#{code}"} >= MINE
    assert len(MINE) == 10


# ----------------------------------------------------------------------------- regular streams


@FAST
@given(
    rate=rates,
    count=st.integers(2, 1500),
    jitter=st.floats(0, 0.12),
    seed=seeds,
    stated=st.booleans(),
)
def test_a_regular_stream_never_alarms(
    rate: float, count: int, jitter: float, seed: int, stated: bool
) -> None:
    time = regular(count, rate, jitter=jitter, seed=seed)
    host = time + 5_000_000_000 + np.random.default_rng(seed).integers(0, 4_000_000, count)
    told = {"nominal_rate": {59.94: "60000/1001"}.get(rate, str(int(rate)))} if stated else {}
    assert found(judge(time, time_host=host, sequence=np.arange(count), **told)) == []


@FAST
@given(rate=rates, loss=st.floats(0, 0.35), seed=seeds)
def test_lost_samples_that_are_declared_never_alarm(rate: float, loss: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kept = np.flatnonzero(rng.random(600) >= loss)
    time = regular(600, rate, jitter=0.1, seed=seed)[kept]
    lost = np.diff(kept) - 1
    gaps = [Gap(after=int(i), lost=int(lost[i])) for i in np.flatnonzero(lost)]
    told = {59.94: "60000/1001"}.get(rate, str(int(rate)))
    assert found(judge(time, gaps=gaps, sequence=kept, nominal_rate=told)) == []


@FAST
@given(
    kind=st.sampled_from(
        ["poisson", "lognormal", "clusters", "uniform", "taps", "pairs", "triples"]
    ),
    count=st.integers(2, 400),
    seed=seeds,
)
def test_events_never_alarm(kind: str, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    index, pauses = np.arange(count), rng.exponential(1, count)
    intervals = {
        "poisson": pauses,
        "lognormal": rng.lognormal(0, 1.5, count),
        "clusters": np.where(pauses < 0.3, 20 * pauses, 0.1) * rng.uniform(0.3, 3, count),
        "uniform": rng.uniform(0, 2, count),
        "taps": rng.uniform(0.5, 1.5, count),
        "pairs": np.where(index % 2, 0.01, pauses),
        "triples": np.where(index % 3, 0.01, pauses),
    }[kind]
    time = np.cumsum(np.rint(intervals * 1e8).astype(np.int64) + 1)
    assert found(judge(time)) == []


@pytest.mark.parametrize(("rate", "unit_ns"), [(60, 1e6), (120, 1e6), (700, 1e6), (59.94, 1e7)])
def test_coarse_stamps_have_the_right_rate(rate: float, unit_ns: float) -> None:
    time = (np.rint(np.arange(900) * 1e9 / rate / unit_ns) * unit_ns).astype(np.int64)
    assert found(judge(time, nominal_rate="60000/1001" if rate == 59.94 else str(rate))) == []


@pytest.mark.parametrize("drop", [0.0, 0.3])
@pytest.mark.parametrize("seed", [3, 8])
def test_simulated_sessions_do_not_alarm(tmp_path: Path, seed: int, drop: float) -> None:
    session = simulate_play(seed=seed, duration_s=20, drop=drop)
    streams = {}
    for name, stream in session.streams.items():
        lost = np.diff(stream.sequence) - 1
        streams[name] = {
            "time": stream.capture_time_ns,
            "time_host": stream.time_ns + 10**12,
            "sequence": stream.sequence,
            "gaps": [Gap(after=int(i), lost=int(lost[i])) for i in np.flatnonzero(lost)],
            "nominal_rate": f"{stream.rate_hz:.0f}",
        }
    report = validate(write(tmp_path / "e.zarr", streams), levels=["hierarchy", "arrays"])
    assert found(report) == []
    # 20 s are too short to know a drift of 100 ppm
    assert set(skipped(report)) - {"SYNC-001", "SYNC-002"} == {"CLOCK-006"}


def test_few_samples_are_not_judged() -> None:
    report = judge(np.array([0, 1, 50, 51, 900], dtype=np.int64), nominal_rate="10")
    assert found(report) == []
    assert set(skipped(report)) == {"TIME-005", "TIME-006", "TIME-007", "TIME-008"}
    assert set(skipped(report).values()) == {"too few samples"}


def test_events_are_said_to_be_not_checked() -> None:
    time = np.cumsum(np.random.default_rng(1).exponential(1e8, 200)).astype(np.int64)
    assert skipped(judge(time)) == dict.fromkeys(
        ("TIME-006", "TIME-007", "TIME-008"), "samples come irregularly"
    )


# ------------------------------------------------------------------------------------- rates


@pytest.mark.parametrize(
    ("rate", "alarm"), [(98.5, False), (97.5, True), (103, True), (101.0, False)]
)
def test_the_stated_rate(rate: float, alarm: bool) -> None:
    report = judge(regular(1000, rate, jitter=0.05), nominal_rate="100")
    assert found(report) == ([("TIME-005", None)] if alarm else [])
    if alarm:
        problem = only(report)
        assert problem.expected == "100"
        assert float(problem.found or 0) == pytest.approx(rate, rel=0.005)


def test_gaps_are_taken_out_of_the_rate() -> None:
    kept = np.delete(np.arange(1000), [*range(100, 300), *range(400, 900, 7)])
    gaps = [Gap(after=99)]
    assert found(judge(regular(1000, 100)[kept], nominal_rate="100", gaps=gaps)) == []


def test_a_nominal_rate_is_never_measured() -> None:
    time = np.arange(50, dtype=np.int64) * 200_000_000
    report = judge(time, nominal_rate="10", clock=NOMINAL, gaps=[Gap(after=i) for i in range(49)])
    assert "TIME-005" not in {*skipped(report), *(code for code, _ in found(report))}


# ------------------------------------------------------------------------- jitter and bursts


@pytest.mark.parametrize(("jitter", "alarm"), [(0.17, False), (0.24, True), (0.4, True)])
def test_jitter(jitter: float, alarm: bool) -> None:
    report = judge(regular(3000, 50, jitter=jitter), nominal_rate="50")
    assert found(report) == ([("TIME-007", None)] if alarm else [])
    assert ("TIME-006" in skipped(report)) == alarm


@FAST
@given(rate=rates, count=st.integers(40, 900), place=st.floats(0, 1), seed=seeds)
def test_a_sample_that_came_twice_is_found(
    rate: float, count: int, place: float, seed: int
) -> None:
    time = regular(count, rate, jitter=0.1, seed=seed)
    at = 1 + round(place * (count - 2))
    twice = np.insert(time, at, time[at - 1] + 20_000)
    assert found(judge(twice)) == [("TIME-008", at)]
    assert found(judge(twice, flags=flag(count + 1, "time_nudged", at))) == []


def test_a_few_in_a_long_stream_are_none() -> None:
    time = regular(5000, 100, jitter=0.05)
    twice = np.insert(time, [700, 1500], time[[699, 1499]] + 1)
    assert found(judge(twice)) == []


@pytest.mark.parametrize("size", [2, 3, 4, 8, 16])
def test_bursts_are_found_and_nothing_else_is_said_of_them(size: int) -> None:
    packets = regular(120, 100 / size, jitter=0.02).repeat(size)
    time = packets + np.tile(np.arange(size, dtype=np.int64) * 40_000, 120)
    for told in ({}, {"nominal_rate": "100"}):
        report = judge(time, **told)
        assert found(report) == [("TIME-008", 1)]
        assert f"({120 * (size - 1):,} in all)" in only(report).message
        assert skipped(report)["TIME-006"] == "samples come in bursts"


# -------------------------------------------------------------------------------------- gaps


@FAST
@given(
    rate=rates,
    count=st.integers(60, 900),
    place=st.floats(0, 1),
    lost=st.integers(3, 30),
    seed=seeds,
)
def test_a_silent_gap_is_found(rate: float, count: int, place: float, lost: int, seed: int) -> None:
    at = 1 + round(place * (count - 2))
    kept = np.concatenate((np.arange(at), np.arange(at, count) + lost))
    time = regular(count + lost, rate, jitter=0.1, seed=seed)[kept]
    report = judge(time, sequence=kept)
    assert found(report) == [("SEQ-002", at), ("TIME-006", at)]
    assert found(judge(time, sequence=kept, gaps=[Gap(after=at - 1, lost=lost)])) == []
    assert found(judge(time, sequence=kept, flags=flag(count, "gap_before", at))) == []
    wrong = judge(time, gaps=[Gap(after=at - 1, lost=2 * lost + 2)])
    assert found(wrong) == [("GAP-002", 0)]
    assert only(wrong).location.pointer == "/attributes/exumi/streams/numbers/gaps/0/lost"


def test_nominal_times_have_gaps_too() -> None:
    kept = np.delete(np.arange(60, dtype=np.int64), [20, 21])
    told = {"nominal_rate": "10", "clock": NOMINAL}
    assert found(judge(kept * 100_000_000, **told)) == [("TIME-006", 20)]
    assert found(judge(kept * 100_000_000, **told, gaps=[Gap(after=19, lost=2)])) == []
    assert found(judge(kept * 100_000_000, **told, gaps=[Gap(after=19, lost=3)])) == [
        ("GAP-002", 0)
    ]


@pytest.mark.parametrize(("off_ns", "alarm"), [(2, False), (-2, False), (3, True), (-3, True)])
def test_nominal_times_lie_on_their_grid_to_2_ns(off_ns: int, alarm: bool) -> None:
    time = np.arange(40, dtype=np.int64) * 100_000_000
    time[30] += off_ns
    report = judge(time, nominal_rate="10", clock=NOMINAL)
    assert found(report) == ([("TIME-004", 30)] if alarm else [])


def test_gaps_are_found_in_long_streams_once() -> None:
    kept = np.delete(np.arange(1_200_000, dtype=np.int64), [*range(524_285, 524_295), 1_100_000])
    kept = np.delete(kept, slice(1_090_000, 1_090_005))
    report = judge(kept * 1_000_000)
    assert found(report) == [("TIME-006", 524_285)]
    assert "(2 in all)" in only(report).message


# ------------------------------------------------------------------------------------ counters


def counter(*values: int) -> npt.NDArray[np.uint64]:
    return np.array(values, dtype=np.uint64)


def test_numbers_that_come_late_are_not_missing() -> None:
    missing = missing_numbers(counter(1, 2, 3, 5, 4, 6, 7, 8, 10, 11))
    assert missing is not None
    assert np.flatnonzero(missing).tolist() == [7]


def test_a_counter_may_count_by_more_than_one() -> None:
    missing = missing_numbers(counter(0, 4, 8, 12, 20, 24, 28))
    assert missing is not None
    assert np.flatnonzero(missing).tolist() == [3]


def test_a_counter_that_sensors_share_is_not_judged() -> None:
    shared = np.cumsum(np.tile([1, 2, 3, 4], 30)).astype(np.uint64)
    assert missing_numbers(shared) is None
    assert "SEQ-002" in skipped(judge(regular(120, 50), sequence=shared))


def test_counters_up_to_the_last_number() -> None:
    top = 2**64 - 1
    missing = missing_numbers(counter(0, 1, 2, 3, 4, 5, top - 1, top))
    assert missing is not None
    assert np.flatnonzero(missing).tolist() == [5]


# -------------------------------------------------------------------------- presence and overlap


def overlap(path: Path, *streams: Times) -> Report:
    write(path, {f"s{i}": {"time": time} for i, time in enumerate(streams)})
    report: Report = validate(path, levels=["hierarchy", "arrays"])
    return report


@pytest.mark.parametrize(("later_s", "alarm"), [(0, False), (4.9, False), (5.1, True), (60, True)])
def test_streams_overlap(tmp_path: Path, later_s: float, alarm: bool) -> None:
    one = regular(101, 10)
    report = overlap(tmp_path / "e.zarr", one, one + round(later_s * 1e9), one)
    assert found(report) == ([("TIME-009", None)] if alarm else [])
    if alarm:
        assert only(report).location.path == "streams/s1/time"
        assert "`s0`" in only(report).message


def test_a_short_stream_lies_within_a_long_one(tmp_path: Path) -> None:
    one = regular(101, 10)
    assert found(overlap(tmp_path / "a.zarr", one, one[40:44], one[70:71])) == []
    outside = overlap(tmp_path / "b.zarr", one, one[-1:] + 1, one[:4] - 1_000_000_000)
    assert [p.location.path for p in outside.problems] == ["streams/s2/time"]


def test_an_empty_stream(tmp_path: Path) -> None:
    report = overlap(tmp_path / "e.zarr", regular(30, 10), np.zeros(0, np.int64))
    assert found(report) == [("STRM-004", None)]
    assert only(report).location.path == "streams/s1/time"


# -------------------------------------------------------------------------------------- clocks


@FAST
@given(
    rate=rates,
    seconds=st.floats(4, 15),
    place=st.floats(0, 1),
    size_ms=st.sampled_from([-900.0, -60.0, 30.0, 200.0, 5000.0]),
    seed=seeds,
)
def test_a_step_is_found(
    rate: float, seconds: float, place: float, size_ms: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    count = int(seconds * rate)
    host = regular(count, rate, jitter=0.02, seed=seed) + 77_000_000_000
    edge = max(10, int(rate)) + 1
    at = edge + round(place * (count - 2 * edge))
    wall = host + rng.integers(0, round(3e8 / max(rate, 100.0)), count)
    wall[at:] += round(size_ms * 1e6)
    # as a recorder keeps a wall clock that was set back
    index = np.arange(count)
    time = np.maximum.accumulate(wall - index) + index
    nudged = flag(count, "time_nudged", *np.flatnonzero(time != wall).tolist())
    report = judge(time - 77_000_000_000, time_host=host, flags=nudged)
    steps = [p for p in report.problems if p.code == "CLOCK-005"]
    settled = at + int((time != wall).sum())
    if count - settled >= edge:
        assert [p.location.index for p in steps] == [settled]
        size = float((steps[0].found or "").removesuffix(" ms"))
        assert size == pytest.approx(size_ms, rel=0.01, abs=6)
        assert skipped(report)["CLOCK-006"] == "the clock steps"


def late(time: Times, start: int, length: int, by_ns: int) -> Times:
    """Arrivals of which some are late, as after a program stood still: each less than the last."""
    arrived = time.copy()
    stop = min(start + length, len(time))
    arrived[start:stop] += np.linspace(by_ns, 0, stop - start).astype(np.int64)
    return arrived


@FAST
@given(start=st.integers(0, 899), stall_s=st.sampled_from([0.02, 0.2, 0.5]), seed=seeds)
def test_late_stamps_are_no_steps(start: int, stall_s: float, seed: int) -> None:
    device = regular(900, 100, jitter=0.05, seed=seed)
    host = late(device, start, max(1, round(stall_s * 100)), round(stall_s * 1e9))
    clock = Clock(source="device", stamp_point="device", raw_time="time_device")
    report = judge(device, time_device=device, time_host=host, clock=clock, time_device_unit="ns")
    assert found(report) == []


@pytest.mark.parametrize(("step_ms", "alarm"), [(18, False), (22, True), (-22, True)])
def test_the_size_of_a_step(step_ms: int, alarm: bool) -> None:
    time = regular(500, 50)
    host = time.copy()
    host[300:] -= step_ms * 1_000_000
    report = judge(time, time_host=host)
    assert found(report) == ([("CLOCK-005", 300)] if alarm else [])
    if alarm:
        assert f"{step_ms:+.1f} ms" in only(report).message


@pytest.mark.parametrize(
    ("ppm", "seconds", "fields", "alarm"),
    [
        (90, 3600, {}, False),
        (110, 3600, {}, True),
        (-110, 3600, {}, True),
        (300, 30, {}, False),
        (900, 60, {}, True),
        (400, 3600, {"drift_sigma_ppm": 150.0}, False),
        (600, 3600, {"drift_sigma_ppm": 150.0}, True),
    ],
)
def test_drift(ppm: float, seconds: int, fields: dict[str, float], alarm: bool) -> None:
    device = regular(seconds * 20, 20, jitter=0.02)
    slow = np.rint(device * (1 + ppm * 1e-6)).astype(np.int64)
    noise = np.random.default_rng(3).integers(0, 3_000_000, len(device))
    clock = DEVICE.model_copy(update=fields)
    report = judge(
        device, time_device=device, time_host=slow + noise, clock=clock, time_device_unit="ns"
    )
    assert found(report) == ([("CLOCK-006", None)] if alarm else [])
    if alarm:
        assert float(only(report).found or 0) == pytest.approx(-ppm, abs=2 if seconds > 60 else 30)


def test_a_drift_that_cannot_be_known_yet() -> None:
    time = regular(200, 20)
    report = judge(time, time_host=np.rint(time * 1.01).astype(np.int64))
    assert found(report) == []
    assert skipped(report)["CLOCK-006"] == "too short to know the drift"


@pytest.mark.parametrize(("factor", "alarm"), [(1.0, False), (1.015, False), (1000.0, True)])
def test_the_unit_of_a_device(factor: float, alarm: bool) -> None:
    time = regular(200, 50, jitter=0.05)
    device = np.rint(time * factor / 1000).astype(np.int64)
    report = judge(time, time_device=device, time_device_unit="us")
    assert found(report) == ([("CLOCK-006", None)] if alarm else [])


def test_a_device_that_restarts_is_not_judged() -> None:
    time = regular(400, 50)
    device = np.where(np.arange(400) < 200, time + 10**12, time)
    report = judge(time, time_device=device, time_device_unit="ns")
    assert found(report) == []
    assert skipped(report)["CLOCK-005"] == "the device's clock restarts"


def test_a_device_may_be_restarted_in_a_gap() -> None:
    time = regular(600, 50)
    device = np.where(np.arange(600) < 300, time, time + 10**10)
    beside = {"time_device": device, "time_device_unit": "ns"}
    assert found(judge(time, **beside)) == [("CLOCK-005", 300)]
    assert "CLOCK-005" not in dict(found(judge(time, **beside, gaps=[Gap(after=299)])))


def test_what_time_was_computed_from_is_not_another_clock() -> None:
    time = regular(400, 50)
    clock = Clock(source="x", stamp_point="device", raw_time="time_host", drift_ppm=5000.0)
    raw = np.rint(time / (1 + 5e-3)).astype(np.int64)
    report = judge(time, time_host=raw, clock=clock)
    assert not {code for code, _ in found(report)} & {"CLOCK-005", "CLOCK-006"}


def test_a_step_in_a_long_stream_is_found_once() -> None:
    time = np.arange(1_200_000, dtype=np.int64) * 1_000_000
    host = time.copy()
    host[530_000:] += 50_000_000
    report = judge(time, time_host=host)
    assert found(report) == [("CLOCK-005", 530_000)]
    assert "(1 in all)" in only(report).message
