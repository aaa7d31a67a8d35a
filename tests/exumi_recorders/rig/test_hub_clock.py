"""The hub's clock: dates that cannot be, and whether a time server keeps it."""

from datetime import UTC, datetime

from exumi_data.model.description import CalibrationItem
from exumi_recorders.rig.hub_clock import ClockState, clock_gates, read_clock_state

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)


def verdicts(
    now: datetime = NOW, state: ClockState | None = None, *calibrated: str
) -> tuple[str, str]:
    items = [CalibrationItem(value=0, time=time) for time in calibrated]
    date, sync = clock_gates(now, state, [*items, CalibrationItem(value=1)])
    return date.verdict, sync.verdict


def test_a_board_without_a_clock_begins_in_1970() -> None:
    assert verdicts(datetime(1970, 1, 1, tzinfo=UTC))[0] == "fail"
    assert verdicts(datetime(2024, 12, 31, 23, 59, tzinfo=UTC))[0] == "fail"
    assert verdicts(datetime(2025, 1, 1, tzinfo=UTC))[0] == "pass"


def test_no_calibration_is_of_tomorrow() -> None:
    assert verdicts(NOW, None, "2026-03-01T12:10:00Z")[0] == "pass"
    assert verdicts(NOW, None, "2026-03-01T12:10:01Z")[0] == "fail"
    assert verdicts(NOW, None, "0001-01-01T00:00:00Z", "2026-02-30T00:00:00Z")[0] == "pass"


def test_synchronisation() -> None:
    assert verdicts(NOW, None)[1] == "skipped"
    assert verdicts(NOW, ClockState(is_synchronised=True, most_error_s=0.01))[1] == "pass"
    assert verdicts(NOW, ClockState(is_synchronised=False, most_error_s=16.0))[1] == "warn"


def test_the_kernel_is_asked() -> None:
    state = read_clock_state()
    assert state is None or 0 <= state.most_error_s < 100
