"""``exumi rig``, and what ``exumi record`` does with a rig that is not calibrated."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from exumi_data.cli.app import app
from exumi_data.model.description import CalibrationItem
from exumi_recorders.calibration.files import Calibration, write_calibration

Program = Callable[..., Result]

RAW_TO_DATA = {"raw": [2000, 6000], "data": [-0.5, 1.0]}


@pytest.fixture
def exumi() -> Program:
    """Run the program in this process: most of what a process of its own takes is its imports."""

    def run(*arguments: object) -> Result:
        return CliRunner().invoke(app, list(map(str, arguments)))

    return run


def begin(exumi: Program, folder: Path) -> Path:
    """A rig file of the simulated encoder, slow enough for any machine."""
    path = folder / "try.toml"
    done = exumi("rig", "init", "simulated", path)
    assert done.exit_code == 0, done.stderr
    path.write_text(path.read_text("utf-8").replace("rate_hz = 200", "rate_hz = 50"), "utf-8")
    return path


def test_init_says_what_is_next_and_overwrites_nothing(exumi: Program, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    done = exumi("rig", "init", path)
    assert done.exit_code == 0
    assert f"exumi rig check {path}" in done.stdout
    assert "plugged in" in done.stdout
    assert tomllib.loads(path.read_text("utf-8"))["rig"]["name"] == "exumi"
    again = exumi("rig", "init", "tmi", path)
    assert again.exit_code == 2
    assert "--force" in again.stderr
    assert tomllib.loads(path.read_text("utf-8"))["rig"]["name"] == "exumi"
    assert exumi("rig", "init", "tmi", path, "--force").exit_code == 0
    assert tomllib.loads(path.read_text("utf-8"))["rig"]["name"] == "octopi-tmi"
    assert exumi("rig", "init", "a", "b", "c").exit_code == 2
    assert "exumi rig init tmi rig.toml" in exumi("rig", "init", "tmi").stderr


def test_a_rig_is_calibrated_before_it_is_recorded_with(exumi: Program, tmp_path: Path) -> None:
    path = begin(exumi, tmp_path)
    failed = exumi("rig", "check", path, "--seconds", "0.5")
    assert failed.exit_code == 1, failed.stderr
    assert "width_map" in failed.stdout
    assert "exumi calibrate gripper" in failed.stdout
    refused = exumi("record", "--rig", path, "--task", "x", "--duration", "0.5")
    assert refused.exit_code == 2
    assert "this rig is not calibrated: width_map of width" in refused.stderr
    assert not (tmp_path / "simulated-recordings").exists()

    items = {"width_map": CalibrationItem(value={"raw_to_data": RAW_TO_DATA})}
    write_calibration(tmp_path / "rig.json", Calibration(items))
    text = path.read_text("utf-8")
    path.write_text(text.replace("calibration = []", 'calibration = ["rig.json"]'), "utf-8")
    passed = exumi("rig", "check", path, "--seconds", "0.5", "--format", "json")
    document = json.loads(passed.stdout)
    assert document["format"] == "exumi-rig-check"
    wrong = {gate["name"] for gate in document["gates"] if gate["verdict"] == "fail"}
    assert wrong <= {"drops"}  # a busy machine reads late, and says so
    assert document["passed"] is (not wrong)
    assert passed.exit_code == (1 if wrong else 0)
    found = {gate["name"]: gate for gate in document["gates"] if gate["where"] == "width"}
    assert found["width_map"]["verdict"] == "pass"
    assert "mm now" in found["width_map"]["found"]


def test_mistakes_in_the_file_are_all_said(exumi: Program, tmp_path: Path) -> None:
    path = begin(exumi, tmp_path)
    text = path.read_text("utf-8")
    path.write_text(text.replace("rate_hz", "rate").replace("licence", "license"), "utf-8")
    done = exumi("rig", "check", path)
    assert done.exit_code == 2
    assert "rig.license" in done.stderr
    assert "devices.encoder.rate" in done.stderr


def test_the_simulated_rig_is_checked_like_any_other(exumi: Program) -> None:
    done = exumi("rig", "check", "simulated", "--seconds", "0.5", "--format", "json")
    document = json.loads(done.stdout)
    found = {(gate["name"], gate["where"]): gate["verdict"] for gate in document["gates"]}
    well = [("device", name) for name in ("headset", "encoder", "tactile_left", "rgb")]
    well += [("world_frame", "headset"), ("flag", "headset"), ("magnet", "encoder")]
    well += [("width_map", "width"), ("intrinsics", "rgb"), ("latency", "tactile_right")]
    well += [("reference", "tactile_left"), ("reference", "tactile_right"), ("clock", "")]
    assert {key: found[key] for key in well} == dict.fromkeys(well, "pass")
    # How fast pictures are drawn is this machine's affair.
    others = {key[0] for key, verdict in found.items() if verdict == "fail"}
    assert others <= {"rate", "drops"}
    assert done.exit_code == (1 if others else 0)
