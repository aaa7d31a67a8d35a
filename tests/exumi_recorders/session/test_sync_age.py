"""What a session is told of its calibration."""

from datetime import UTC, datetime, timedelta

import pytest

from exumi_data.model import CalibrationItem
from exumi_recorders.session.plan import Calibrated
from exumi_recorders.session.running import sync_age_s


def item(age: timedelta | None) -> CalibrationItem:
    time = None if age is None else f"{datetime.now(UTC) - age:%Y-%m-%dT%H:%M:%SZ}"
    return CalibrationItem(value=1, unit="ns", time=time)


def test_the_age_is_that_of_the_oldest_latency() -> None:
    items = {
        "latency/pose": item(timedelta(hours=30)),
        "latency/tactile_left": item(timedelta(hours=2)),
        "latency/rgb": item(None),
        "width_map": item(timedelta(days=90)),
    }
    assert sync_age_s(Calibrated(items)) == pytest.approx(30 * 3600, abs=5)


def test_without_a_latency_there_is_no_age() -> None:
    assert sync_age_s(Calibrated({"width_map": item(timedelta(days=1))})) is None
