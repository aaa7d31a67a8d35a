"""The kind and its checks keep the contracts of exUMI Data, and find what they are for."""

import json
from pathlib import Path

import numpy as np
import pytest
from acme_thermal import checks
from acme_thermal.kind import THERMAL
from acme_thermal.recording import write_episode

from exumi_data.testing import check_stream_kind
from exumi_validators import read_config, validate
from exumi_validators.testing import check_checks

WARM = np.linspace(22, 36, 50)
RANGE = {"acme:range_celsius": [-40.0, 125.0]}


@pytest.fixture
def warm(tmp_path: Path) -> Path:
    return write_episode(tmp_path / "warm.zarr", WARM, **RANGE)


def test_the_kind_keeps_the_contract(warm: Path) -> None:
    check_stream_kind(THERMAL, warm)


def test_the_checks_keep_the_contract(warm: Path, tmp_path: Path) -> None:
    burning = write_episode(tmp_path / "burning.zarr", np.append(WARM, [130.0]), **RANGE)
    check_checks(checks, good=[warm], bad={burning: {"acme:THERM-001": 1, "acme:THERM-002": 1}})


def test_metadata_is_judged(warm: Path) -> None:
    file = warm / "zarr.json"
    document = json.loads(file.read_text())
    stream = document["attributes"]["exumi"]["streams"]["finger_heat"]
    stream["acme:emissivity"] = 3.0
    stream["acme:emisivity"] = 0.9
    file.write_text(json.dumps(document))
    at = "/attributes/exumi/streams/finger_heat"
    found = {(p.code, p.location.pointer) for p in validate(warm).problems}
    assert found == {("META-002", f"{at}/acme:emissivity"), ("META-003", f"{at}/acme:emisivity")}


def test_a_range_that_is_not_stated_is_not_judged(tmp_path: Path) -> None:
    report = validate(write_episode(tmp_path / "plain.zarr", WARM))
    assert report.problems == ()
    assert [item.code for item in report.coverage.skipped] == ["acme:THERM-002"]


def test_limits_can_be_changed(warm: Path, tmp_path: Path) -> None:
    file = tmp_path / "exumi.toml"
    file.write_text('[validate.rules]\n"acme:THERM-001" = {limits = {high_celsius = 30}}\n')
    report = validate(warm, config=read_config(file))
    assert report.codes() == {"acme:THERM-001": 1}
    assert report.problems[0].location.index == int(np.argmax(WARM > 30))
    assert report.conformant


def test_a_report_names_the_package(warm: Path) -> None:
    named = {(item.provides, item.name) for item in validate(warm).extensions}
    assert named >= {("checks", "acme-thermal"), ("stream kind", "acme:thermal")}
