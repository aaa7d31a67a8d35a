"""A rig without a width map is not recorded with, unless it is said."""

import pytest

from exumi_data.calibration_items import now
from exumi_data.errors import UsageError
from exumi_data.model.description import CalibrationItem
from exumi_recorders.rig.loading import parse_rig
from exumi_recorders.session.plan import Calibrated
from exumi_recorders.session.readiness import check_calibration

MAP = CalibrationItem(value={"raw_to_data": {"raw": [0, 100], "data": [0.0, 0.05]}})
RIG = parse_rig(
    {
        "format": "exumi-rig",
        "version": "1.0",
        "rig": {"name": "x", "licence": "CC0-1.0"},
        "devices": {
            "headset": {"driver": "quest", "streams": {"pose": "pose"}},
            "encoder": {"driver": "as5600", "streams": {"width": "width"}},
        },
    }
)


def judged(items: dict[str, CalibrationItem], *, uncalibrated: bool = False) -> str | None:
    return check_calibration(RIG, Calibrated(items), uncalibrated=uncalibrated)


def test_without_a_map_it_is_refused() -> None:
    with pytest.raises(UsageError, match=r"width_map of width.*exumi calibrate gripper") as caught:
        judged({})
    assert "--uncalibrated" in str(caught.value)
    broken = MAP.model_copy(update={"value": {"raw_to_data": {"raw": [3], "data": [0.0]}}})
    with pytest.raises(UsageError, match="width_map of width"):
        judged({"width_map": broken})


def test_unless_it_is_said() -> None:
    warning = judged({}, uncalibrated=True)
    assert warning is not None
    assert warning.startswith("not calibrated: width_map of width; latency of pose; exumi rig")


def test_what_is_doubtful_is_told() -> None:
    warning = judged({"width_map": MAP})
    assert warning is not None
    assert warning.startswith("not calibrated: latency of pose; ")


def test_nothing_is_said_of_a_rig_that_is_calibrated() -> None:
    latency = CalibrationItem(value=12_000_000, unit="ns", time=now())
    assert judged({"width_map": MAP, "latency/pose": latency}) is None
