"""Calibrations: named, of the time of the recording, and known somehow."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.calibration import add_intrinsics, add_rectification
from exumi_data.episode import open_episode
from exumi_data.model import CalibrationItem, RawData
from exumi_data.model.calibration import Intrinsics
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile.rectification import PixelMap
from exumi_validators import validate
from tests.exumi_data.builders import CLOCK, HEIGHT, WIDTH, add_images, edit_metadata, metadata

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


def write_images(path: Path, **said: Any) -> Path:
    """An episode of a finger with a map, and a camera whose lens is known."""
    index = np.moveaxis(np.mgrid[:HEIGHT, :WIDTH], 0, -1).astype(np.uint16)
    pixel_map = PixelMap(index, (HEIGHT / 2, WIDTH / 2), (HEIGHT, WIDTH))
    camera = Intrinsics(model="pinhole", width=WIDTH, height=HEIGHT, fx=9.0, fy=9.5, cx=-3, cy=2.5)
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        add_images(writer)
        add_rectification(writer, "tactile", pixel_map, method="dots", **said)
        add_intrinsics(writer, "gopro", camera, method="board")
    return path


def changed(path: Path, name: str, **value: Any) -> list[str]:
    edit_metadata(path, lambda exumi: exumi["calibration"][name]["value"].update(value))
    return codes(path)


def test_a_whole_map_with_a_whole_crop_fits(tmp_path: Path) -> None:
    path = write_images(tmp_path / "e.zarr")
    assert codes(path) == []
    # Half a pixel further is rounded down to the same place; the whole pixel is outside.
    name = "rectification/tactile"
    assert changed(path, name, centre_px=[HEIGHT / 2 + 0.5, WIDTH / 2 + 0.5]) == []
    assert changed(path, name, centre_px=[HEIGHT / 2 + 1, WIDTH / 2]) == ["CAL-007"]
    assert changed(path, name, centre_px=[HEIGHT / 2 - 0.5, WIDTH / 2]) == ["CAL-007"]
    assert changed(path, name, centre_px=[HEIGHT / 2, WIDTH / 2], crop_px=[HEIGHT, 0]) == [
        "CAL-007"
    ]


@pytest.mark.parametrize(("last", "found"), [(HEIGHT - 1, []), (HEIGHT, ["CAL-007"])])
def test_the_last_row_is_inside_the_next_is_not(
    tmp_path: Path, last: int, found: list[str]
) -> None:
    path = write_images(tmp_path / "e.zarr")
    with open_episode(path) as episode:
        index = episode.calibration_array("rectification/tactile").copy()
    index[3, 4, 0] = last
    with EpisodeWriter(tmp_path / "o.zarr", metadata(), durable=False) as writer:
        writer.add_calibration_array("rectification/tactile", index)
    shutil.rmtree(path / "calibration")
    shutil.copytree(tmp_path / "o.zarr" / "calibration", path / "calibration")
    assert codes(path) == found


def test_a_map_lies_where_its_name_says(tmp_path: Path) -> None:
    path = write_images(tmp_path / "e.zarr")
    place = path / "calibration" / "rectification" / "tactile"
    place.rename(place.with_name("other"))

    def elsewhere(exumi: dict[str, Any]) -> None:
        exumi["calibration"]["rectification/tactile"]["array"] = "calibration/rectification/other"

    edit_metadata(path, elsewhere)
    assert codes(path) == ["CAL-007"]


def test_intrinsics_of_another_size_or_lens(tmp_path: Path) -> None:
    path = write_images(tmp_path / "e.zarr")
    name = "intrinsics/gopro"
    assert changed(path, name, width=WIDTH + 1) == ["CAL-008"]
    assert changed(path, name, width=WIDTH, fx=0.0) == ["CAL-008"]
    assert changed(path, name, fx=1e-9, distortion=[0.0] * 5) == []
    assert changed(path, name, distortion=[0.0] * 6) == ["CAL-008"]
    assert changed(path, name, distortion=[], **{"acme:lens": "wide"}) == []
    assert changed(path, name, lens="wide") == ["CAL-008"]


def test_items_of_streams_that_are_not_there_are_not_judged(tmp_path: Path) -> None:
    path = write_images(tmp_path / "e.zarr")

    def other(exumi: dict[str, Any]) -> None:
        items = exumi["calibration"]
        items["intrinsics/width"] = {"value": 1, "method": "?"}
        items["rectification/nobody"] = items.pop("rectification/tactile") | {"value": 1}

    edit_metadata(path, other)
    report = validate(path)
    assert [problem.code for problem in report.problems] == []
    skipped = {(s.code, s.reason) for s in report.coverage.skipped}
    assert {code for code, reason in skipped if reason == "no stream of images of that name"} == {
        "CAL-007",
        "CAL-008",
    }
