"""Calibrations: named, of the time of the recording, and known somehow."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.calibration import add_intrinsics, add_rectification
from exumi_data.episode import open_episode
from exumi_data.model import CalibrationItem, RawData
from exumi_data.model.calibration import Intrinsics
from exumi_data.raw_to_data import RawToData, read_map
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile.rectification import PixelMap
from exumi_validators import Report, validate
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


# ------------------------------------------------------------------------------------- the map

# A gripper whose linkage is not linear, with a 12-bit encoder that wraps at 0.109 m.
COUNTS = [3440, 3500, 3560, 3620, 3680, 3750, 3820, 3890, 3960, 4030, 4110]
WIDTHS = [round(0.01 * (1 + i), 2) for i in range(11)]
MAP = {"raw": COUNTS, "data": WIDTHS}
EVERYWHERE = np.arange(3440, 4111)


def travel(
    path: Path,
    change: Callable[[np.ndarray], np.ndarray],
    *,
    counts: np.ndarray = EVERYWHERE,
    modulus: int | None = 4096,
    stated: object = MAP,
    stored: type[np.generic] = np.uint16,
    flags: np.ndarray | None = None,
) -> Report:
    """Judge an episode of a gripper that opens, whose widths are not what the counts say."""
    true = np.interp(counts, COUNTS, WIDTHS)
    item = CalibrationItem(value={"raw_to_data": stated}, method="by gauge blocks")
    values = metadata(start=START, calibration={"encoder": item})
    with EpisodeWriter(path, values, durable=False) as writer:
        raw = RawData(unit="count", transform="encoder", modulus=modulus)
        width = writer.add_stream("width", kind="width", clock=CLOCK, raw=raw)
        rows = {} if flags is None else {"flags": flags}
        wrapped = counts if modulus is None else counts % modulus
        time = np.arange(len(counts)) * 10_000_000
        width.append(time, change(true), raw=wrapped.astype(stored), **rows)
    report: Report = validate(path, levels=("document", "arrays"))
    assert report.coverage.unchecked == ()
    return report


def map_codes(report: Report) -> list[str]:
    return [code for code in report.codes() if code in ("CAL-005", "CAL-006")]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda true: true, []),
        (lambda true: true.round(3), []),
        (lambda true: true + 0.00099, []),  # the map spans 0.1 m
        (lambda true: true + 0.00101, ["CAL-006"]),
        (lambda true: 1.008 * true, []),
        (lambda true: 1.012 * true, ["CAL-006"]),
        (lambda true: 2 * true, ["CAL-006"]),
        (lambda true: true / 10, ["CAL-006"]),
        (lambda true: np.full_like(true, np.nan), []),
    ],
)
@pytest.mark.parametrize("modulus", [4096, None])
def test_widths_follow_from_counts(
    tmp_path: Path,
    change: Callable[[np.ndarray], np.ndarray],
    expected: list[str],
    modulus: int | None,
) -> None:
    assert map_codes(travel(tmp_path / "e.zarr", change, modulus=modulus)) == expected


def test_what_is_said_of_a_width_that_is_off(tmp_path: Path) -> None:
    def once(true: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(true)) >= 600, true - 0.1, true)

    (problem,) = [
        problem
        for problem in travel(tmp_path / "e.zarr", once).problems
        if problem.code == "CAL-006"
    ]
    assert problem.location.index == 600
    assert problem.message == (
        "`data` is 0.00125 at sample 600, the calibration gives 0.1013 for its raw value "
        "(71 of 671 samples)"
    )


def test_samples_that_the_device_called_invalid_need_not_follow(tmp_path: Path) -> None:
    flags = np.zeros(len(EVERYWHERE), np.uint32)
    flags[5:9], flags[100] = 8, 16

    def spoil(true: np.ndarray) -> np.ndarray:
        return np.where(flags > 0, 0.05, true)

    assert map_codes(travel(tmp_path / "e.zarr", spoil, flags=flags)) == []
    assert map_codes(travel(tmp_path / "f.zarr", spoil)) == ["CAL-006"]


def test_beyond_its_ends_a_map_says_nothing(tmp_path: Path) -> None:
    beyond = np.arange(3300, 3440)
    report = travel(tmp_path / "e.zarr", lambda true: true - 0.005, counts=beyond)
    assert map_codes(report) == []
    reasons = [item.reason for item in report.coverage.skipped if item.code == "CAL-006"]
    assert reasons == ["no readable raw value lies on the calibration's map"]


@pytest.mark.parametrize(
    ("stated", "detail"),
    [
        (5, "is not an object"),
        ({"raw": [1, 2]}, "has no `data`, a list of finite numbers"),
        ({"raw": [1, "2"], "data": [1, 2]}, "has no `raw`, a list of finite numbers"),
        ({"raw": [True, 2], "data": [1, 2]}, "has no `raw`, a list of finite numbers"),
        ({"raw": [1, 10**400], "data": [1, 2]}, "has no `raw`, a list of finite numbers"),
        ({"raw": [1], "data": [1]}, "has 1 numbers in `raw` and 1 in `data`"),
        ({"raw": [1, 2, 3], "data": [1, 2]}, "has 3 numbers in `raw` and 2 in `data`"),
        ({"raw": [1, 1], "data": [1, 2]}, "has a `raw` that does not ascend"),
        (
            {"raw": [1, 4098], "data": [1, 2]},
            "goes over 4097 counts, which begin anew after 4096",
        ),
    ],
)
def test_a_map_that_is_none(tmp_path: Path, stated: object, detail: str) -> None:
    report = travel(tmp_path / "e.zarr", lambda true: true, stated=stated)
    assert map_codes(report) == ["CAL-005"]
    (problem,) = [problem for problem in report.problems if problem.code == "CAL-005"]
    assert problem.location.pointer == "/attributes/exumi/calibration/encoder/value/raw_to_data"
    assert problem.message.endswith(detail)


@pytest.mark.parametrize(("share", "found"), [(1.0, []), (1.05, ["CAL-006"])])
def test_counts_with_their_turns(tmp_path: Path, share: float, found: list[str]) -> None:
    stated = {"raw": [-6000, 400], "data": [0.08, 0.0]}
    counts = np.arange(400, -6000, -10)
    report = travel(
        tmp_path / "e.zarr",
        lambda _: share * 0.08 * (400 - counts) / 6400,
        counts=counts,
        modulus=None,
        stated=stated,
        stored=np.int32,
    )
    assert map_codes(report) == found


def test_a_calibration_without_a_map_is_not_checked(tmp_path: Path) -> None:
    report = travel(tmp_path / "e.zarr", lambda true: 2 * true, stated=None)
    assert map_codes(report) == []
    assert "CAL-006" in {item.code for item in report.coverage.skipped}


@pytest.mark.parametrize(
    ("modulus", "count", "meant"),
    [
        (None, 5, np.nan),
        (None, 75, 0.25),
        (100, 5, 0.55),  # 105
        (100, 49, 0.99),  # 149
        (100, 50, 0.0),  # 50 and 150 are as near to 100: the lower one
        (1000, 75, 0.25),
    ],
)
def test_a_count_stands_for_the_number_nearest_to_the_middle(
    modulus: int | None, count: int, meant: float
) -> None:
    stated = read_map({"raw_to_data": {"raw": [50, 150], "data": [0.0, 1.0]}})
    assert isinstance(stated, RawToData)
    np.testing.assert_allclose(stated.at(np.array([count]), modulus), [meant])


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
