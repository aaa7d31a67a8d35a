"""Calibrations: named, of the time of the recording, and known somehow."""

from pathlib import Path

import numpy as np
import pytest

from exumi_data.model import CalibrationItem, RawData
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_validators import validate
from tests.exumi_data.builders import CLOCK, edit_metadata, metadata

START = "2026-05-04T10:20:30.123456789Z"


def write(path: Path, item: CalibrationItem, start: str | None = START) -> Path:
    """An episode of a width with counts, led to by a calibration."""
    values = metadata(start=start, calibration={"encoder": item})
    with EpisodeWriter(path, values, durable=False) as writer:
        raw = RawData(unit="count", transform="encoder")
        width = writer.add_stream("width", kind="width", clock=CLOCK, raw=raw)
        width.append(np.arange(3), np.zeros(3), raw=np.zeros(3, np.uint16))
    return path


def codes(path: Path) -> list[str]:
    report = validate(path)
    assert report.coverage.unchecked == ()
    return [problem.code for problem in report.problems]


def test_a_transform_that_is_not_named(tmp_path: Path) -> None:
    path = write(tmp_path / "e.zarr", CalibrationItem(value=1, method="gauge"))
    assert codes(path) == []
    edit_metadata(path, lambda exumi: exumi["streams"]["width"]["raw"].pop("transform"))
    assert codes(path) == ["CAL-002"]


@pytest.mark.parametrize(
    ("time", "found"),
    [
        ("2026-05-04T23:59:60Z", []),
        ("2026-05-05T23:00:00Z", []),
        ("2026-05-06T00:00:00Z", ["CAL-003"]),
        ("2026-04-04T00:00:00Z", []),
        ("2026-04-03T23:59:59Z", ["CAL-003"]),
        ("0001-01-01T00:00:00Z", ["CAL-003"]),
    ],
)
def test_how_old_a_calibration_may_be(tmp_path: Path, time: str, found: list[str]) -> None:
    item = CalibrationItem(value=1, method="gauge", time=time)
    assert codes(write(tmp_path / "e.zarr", item)) == found


@pytest.mark.parametrize(
    ("time", "start", "reason"),
    [
        (None, START, "the calibration's date is not known"),
        (START, None, "the recording's date is not known"),
        ("2026-02-30T00:00:00Z", START, "the calibration's date is not known"),
    ],
)
def test_dates_that_are_not_known(
    tmp_path: Path, time: str | None, start: str | None, reason: str
) -> None:
    item = CalibrationItem(value=1, method="gauge", time=time)
    report = validate(write(tmp_path / "e.zarr", item, start))
    assert "CAL-003" not in report.codes()
    assert reason in [skipped.reason for skipped in report.coverage.skipped]


@pytest.mark.parametrize(
    ("item", "found"),
    [
        (CalibrationItem(value=1), ["CAL-004"]),
        (CalibrationItem(value=1, method=""), ["CAL-004"]),
        (CalibrationItem(value=1, method="gauge blocks"), []),
        (CalibrationItem(value=1, procedure="width.md"), []),
        (CalibrationItem(value=1, uncertainty=0.0), []),
        (CalibrationItem(value=1, residual=0.1), []),
    ],
)
def test_how_a_calibration_is_known(
    tmp_path: Path, item: CalibrationItem, found: list[str]
) -> None:
    assert codes(write(tmp_path / "e.zarr", item)) == found
