"""Counts to openings: wraps, units, scatter, and what is refused."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.errors import SourceError
from exumi_data.gripper_readings import (
    GripperReadings,
    fit_gripper,
    gripper_item,
    read_gripper_file,
    readings_at_rest,
    unwrap,
)
from exumi_data.raw_to_data import RawToData, read_map

OPENINGS = tuple(0.01 * i for i in range(9))
# As exUMI's hub leaves it: it says centimetres, holds metres, and its counts run over the end.
RELEASED = {
    "metadata": {"unit": "cm", "sensor_range": [0, 4095]},
    "calibration": [[0.08, 90], [0.07, 0], [0.06, 4010], [0.05, 3930], [0.04, 3845], [0.03, 3770]],
}


def counts_at(opening_m: np.ndarray, zero: int, per_m: float) -> np.ndarray:
    """A gripper whose gear is not quite straight."""
    turned = per_m * opening_m * (1.0 + 0.8 * opening_m)
    return np.asarray(np.rint(zero + turned).astype(np.int64) % 4096)


def readings(zero: int = 3900, per_m: float = 6000.0, noise: int = 0) -> GripperReadings:
    rng = np.random.default_rng(0)
    groups = []
    for opening in OPENINGS:
        true = counts_at(np.array([opening]), zero, per_m)
        groups.append((true + rng.integers(-noise, noise + 1, 9)) % 4096)
    return GripperReadings(OPENINGS, tuple(groups))


@settings(max_examples=25)
@given(zero=st.integers(0, 4095), per_m=st.floats(1500, 30_000), down=st.booleans())
def test_any_zero_and_either_way(zero: int, per_m: float, down: bool) -> None:
    per_m = -per_m if down else per_m
    item = gripper_item(fit_gripper(readings(zero, per_m)))
    found = read_map(item.value)
    assert isinstance(found, RawToData)
    assert found.raw[0] < 4096
    opening = np.linspace(0.001, 0.079, 200)
    width = found.at(counts_at(opening, zero, per_m), 4096)
    assert np.abs(width - opening).max() < 1.1 / abs(per_m) + 5e-5


def test_the_uncertainty_fits_the_errors() -> None:
    found = fit_gripper(readings(noise=3), gauge_m=0.0)
    assert 1e-5 < found.residual_rms_m < found.uncertainty_m < 1e-3
    worse = fit_gripper(readings(noise=3), gauge_m=1e-3)
    assert worse.uncertainty_m == pytest.approx(np.hypot(1e-3, found.uncertainty_m))
    assert np.isnan(found.residual_m[[0, -1]]).all()


def test_the_released_file(tmp_path: Path) -> None:
    path = tmp_path / "gripper_calibration.json"
    path.write_text(json.dumps(RELEASED))
    found = read_gripper_file(path)
    assert found.notes == ("the file says cm, which would be a travel of 0.5 mm; it holds m",)
    item = gripper_item(fit_gripper(found))
    stated = read_map(item.value)
    assert isinstance(stated, RawToData)
    # A count of 0 is a reading, and lies between those beside the encoder's end.
    assert stated.at(np.array([0, 90, 4010]), 4096) == pytest.approx([0.07, 0.08, 0.06])
    assert "run over 4095" in (item.procedure or "")
    assert item.unit == "m"
    assert item.value["range_m"] == [0.03, 0.08]
    assert item.uncertainty is not None
    assert item.uncertainty > 5e-4


def test_the_real_file(real_data: Path) -> None:
    found = fit_gripper(read_gripper_file(real_data / "exumi/gripper_calibration.json"))
    assert found.opening_m[[0, -1]] == pytest.approx([0.01, 0.11])
    assert found.raw[[0, -1]] == pytest.approx([3465, 4099])
    # Set by hand and eye: neighbours disagree by some 2 mm, and the item says so.
    assert 1.5e-3 < found.uncertainty_m < 3e-3


def test_csv_and_units(tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    lines = [f"{10 * i},{100 + 60 * i + k}" for i in range(6) for k in (-1, 0, 1)]
    path.write_text("opening_mm,count\n" + "\n".join(lines) + "\n")
    found = read_gripper_file(path)
    assert found.opening_m == pytest.approx([0.01 * i for i in range(6)])
    assert [len(group) for group in found.counts] == [3] * 6
    averaged = tmp_path / "averaged.csv"
    averaged.write_text("opening_mm,count\n0,100.25\n")
    assert read_gripper_file(averaged).counts[0].tolist() == [100.25]
    forced = read_gripper_file(path, unit="cm")
    assert forced.opening_m[1] == pytest.approx(0.1)
    assert forced.notes == ("openings are in cm; the file says mm",)
    with pytest.raises(CalibrationRefusedError, match="Say one of m, cm, mm"):
        read_gripper_file(path, unit="inch")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", "{}", "no calibration of a gripper"),
        ("a.json", '{"metadata": {"unit": "m"}, "calibration": [[0.1, 4096]]}', "no reading"),
        ("a.json", '{"metadata": {"unit": "m"}, "calibration": [[-0.1, 4]]}', "no reading"),
        ("a.csv", "opening_mm,counts\n1,2\n", "no readings of a gripper"),
        ("a.csv", "", "no readings of a gripper"),
        ("a.csv", "opening_mm;count\n0;100\n", "divided by commas"),
        ("a.csv", "opening_mm,count\n0,nan\n", "no reading"),
    ],
)
def test_files_that_hold_something_else(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SourceError, match=said):
        read_gripper_file(tmp_path / name)


def refused(openings: list[float], counts: list[list[int]]) -> str:
    groups = tuple(np.array(group) for group in counts)
    with pytest.raises(CalibrationRefusedError) as caught:
        fit_gripper(GripperReadings(tuple(openings), groups))
    return str(caught.value)


def test_what_is_refused() -> None:
    steps = [0.0, 0.01, 0.02, 0.03, 0.04]
    line = [[100], [160], [220], [280], [340]]
    assert "there are 4 openings" in refused(steps[:4], line[:4])
    assert "too coarse" in refused([0.0, 0.01, 0.02, 0.05, 0.06], line)
    assert "do not go one way" in refused(steps, [[100], [160], [150], [280], [340]])
    assert "do not go one way" in refused(steps, [[100], [160], [160], [280], [340]])
    assert "too far to know" in refused(steps, [[100], [160], [1800], [1900], [2000]])
    assert "scatter" in refused(steps, [[100], [160], [150, 290], [280], [340]])


def test_openings_that_make_no_map() -> None:
    line = [[100 + 60 * i] for i in range(5)]
    assert "an opening of -5 mm" in refused([-0.005, 0.0, 0.01, 0.02, 0.03], line)
    assert "span 4 mm" in refused([0.0, 0.001, 0.002, 0.003, 0.004], line)
    assert "hardly change, 100 to 101" in refused(
        [0.01 * i for i in range(5)], [[100], [100], [101], [100], [101]]
    )


def test_one_wrong_reading_is_named() -> None:
    openings = [0.01 * i for i in range(9)]
    line = [[100 + 60 * i] for i in range(9)]
    # As large as the whole way, it does not turn the way round.
    said = refused(openings, [*line[:8], [100]])
    assert "do not go one way: 520 at 70 mm, 100 at 80 mm" in said
    # 20 of 60 counts pass; more than half of a step does not.
    fit_gripper(GripperReadings(tuple(openings), tuple(np.array(c) for c in line)))
    bent = [*line[:4], [340 + 20], *line[5:]]
    assert (
        fit_gripper(
            GripperReadings(tuple(openings), tuple(np.array(c) for c in bent))
        ).uncertainty_m
        > 1e-3
    )
    wrong = [*line[:4], [340 + 50], *line[5:]]
    assert "opening of 40 mm does not fit between its neighbours" in refused(openings, wrong)
    # What a gauge is off by is no fault of the encoder's.
    loose = GripperReadings(tuple(openings), tuple(np.array(c) for c in wrong))
    assert fit_gripper(loose, gauge_m=5e-3).uncertainty_m > 5e-3


@pytest.mark.parametrize("per_step", [900, -900])
def test_more_than_a_turn(per_step: int) -> None:
    openings = tuple(0.01 * i for i in range(7))
    wrapped = [np.array([(300 + per_step * i) % 4096]) for i in range(7)]
    found = fit_gripper(GripperReadings(openings, tuple(wrapped)))
    assert found.modulus is None
    assert any("1.32 turns" in note and "home = 300" in note for note in found.notes)
    # As the driver hands them over that counts turns from home.
    going_on = [np.array([300 + per_step * i]) for i in range(7)]
    item = gripper_item(found)
    assert gripper_item(fit_gripper(GripperReadings(openings, tuple(going_on), None))).value == (
        item.value
    )
    stated = read_map(item.value)
    assert isinstance(stated, RawToData)
    assert "modulus" not in item.value
    assert stated.at(np.array([300, 300 + 5 * per_step])) == pytest.approx([0.0, 0.05])
    # Of counts that wrap it tells nothing, and says why.
    assert np.isnan(stated.at(np.array([300]), 4096)).all()
    assert stated.beyond_a_turn(4096) == "goes over 5400 counts, which begin anew after 4096"


def test_a_recording_in_steps() -> None:
    rng = np.random.default_rng(1)
    held = np.repeat(np.array(OPENINGS), 400)
    moving = np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(OPENINGS)]).reshape(-1, 60)
    opening = np.concatenate(
        [part for i in range(8) for part in (held[400 * i : 400 * (i + 1)], moving[i])]
        + [held[-400:]]
    )
    counts = (counts_at(opening, 3900, 6000.0) + rng.integers(-1, 2, len(opening))) % 4096
    time = np.arange(len(opening)) * 5_000_000
    found = readings_at_rest(time, counts, OPENINGS)
    assert [len(group) for group in found.counts] == pytest.approx([400] * 9, abs=12)
    assert fit_gripper(found).residual_rms_m < 3e-4
    with pytest.raises(CalibrationRefusedError, match="rested 9 times"):
        readings_at_rest(time, counts, OPENINGS[:-1])


def test_unwrap() -> None:
    assert unwrap(np.array([4090, 2, 10, 4095]), 4096).tolist() == [4090, 4098, 4106, 4095]
    assert unwrap(np.array([], np.int64)).tolist() == []
