"""Reference without contact, 9DTact's maps and depths."""

from pathlib import Path

import numpy as np
import pytest

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.errors import SourceError
from exumi_recorders.calibration.tactile import (
    captured_reference,
    depth_table,
    rectification,
    scale,
    selected_reference,
)

HEIGHT, WIDTH = 120, 160


def frames(count: int, touched: range = range(0), seed: int = 0) -> np.ndarray:
    """Frames of a gel with noise; in some a ball is pressed in."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    rest = 120 + 0.3 * x + rng.normal(0, 1.0, (count, HEIGHT, WIDTH))
    ball = 60 * np.exp(-((x - 80) ** 2 + (y - 60) ** 2) / 200)
    for i in touched:
        rest[i] -= ball
    return np.repeat(np.clip(rest, 0, 255).astype(np.uint8)[..., None], 3, axis=3)


def test_a_reference_at_rest() -> None:
    shown = frames(40)
    found = captured_reference(shown, "tactile_left")
    item = found.items["tactile_reference/tactile_left"]
    image = found.arrays["tactile_reference/tactile_left"]
    assert item.array == "calibration/tactile_reference/tactile_left"
    assert item.value is None
    assert image.dtype == np.uint8
    assert np.abs(image.astype(int) - shown.mean(axis=0)).mean() < 0.7
    assert item.residual is not None
    assert 0.3 < item.residual < 2.0


def test_contact_makes_no_reference() -> None:
    with pytest.raises(CalibrationRefusedError, match="of the image changes"):
        captured_reference(frames(40, range(20, 25)), "tactile_left")
    with pytest.raises(CalibrationRefusedError, match="4 frames"):
        captured_reference(frames(4), "tactile_left")
    moving = np.concatenate([np.roll(frames(1, range(1)), 12 * i, axis=2) for i in range(24)])
    with pytest.raises(CalibrationRefusedError, match="no frames without contact"):
        selected_reference(list(moving), "tactile_left")


def test_quiet_frames_among_touches() -> None:
    shown = frames(60, range(20, 50))
    found = selected_reference(list(shown), "t")
    image = found.arrays["tactile_reference/t"]
    assert np.abs(image.astype(int) - shown[:20].mean(axis=0)).mean() < 1.0


def test_many_frames_take_no_more_memory() -> None:
    held: list[int] = []

    def counted() -> object:
        for i, frame in enumerate(frames(300)):
            held.append(i)
            yield frame

    found = captured_reference(counted(), "t")  # type: ignore[arg-type]  # a generator of frames
    assert len(held) == 300
    assert "in 300 frames" in (found.items["tactile_reference/t"].procedure or "")


def write_maps(folder: Path) -> None:
    folder.mkdir(parents=True)
    rows, columns = np.mgrid[:480, :640].astype(np.int32)
    np.save(folder / "row_index.npy", rows)
    np.save(folder / "col_index.npy", columns)
    np.save(folder / "position_scale.npy", np.array([240.0, 320.0, 0.05]))


def test_maps_of_9dtact(tmp_path: Path) -> None:
    write_maps(tmp_path / "camera_calibration")
    found = rectification(tmp_path / "camera_calibration", "tactile_left")
    item = found.items["rectification/tactile_left"]
    assert item.value == {
        "centre_px": [240.0, 320.0],
        "crop_px": [340, 460],
        "mm_per_px": [0.05, 0.05],
    }
    assert found.arrays["rectification/tactile_left"].shape == (480, 640, 2)
    with pytest.raises(SourceError, match="lies outside"):
        rectification(tmp_path / "camera_calibration", "t", crop_px=(481, 10))
    with pytest.raises(SourceError, match="row_index"):
        rectification(tmp_path, "t")


def test_depths_of_9dtact(tmp_path: Path) -> None:
    path = tmp_path / "Pixel_to_Depth.npy"
    np.save(path, np.array([-0.9, 0.02, 0.05, 0.05, 0.1]))
    item = depth_table(path, "t").items["depth_table/t"]
    assert item.value == {"depth_mm": [0.0, 0.02, 0.05, 0.05, 0.1]}
    assert "-0.9 in the file, set to 0" in (item.procedure or "")
    for wrong in (np.array([0.0, 0.2, 0.1]), np.array([0.0, np.nan]), np.zeros((2, 2))):
        np.save(path, wrong)
        with pytest.raises(SourceError, match=r"the depth falls|no table"):
            depth_table(path, "t")
    np.save(path, np.array([{}], dtype=object))
    with pytest.raises(SourceError, match="no table of depths"):
        depth_table(path, "t")


@pytest.mark.parametrize("sensor", ["sensor_1", "sensor_2"])
def test_the_real_sensors(real_data: Path, sensor: str) -> None:
    folder = real_data / "ninedtact" / sensor
    table = depth_table(folder / "depth_calibration/Pixel_to_Depth.npy", "t").items
    depths = table["depth_table/t"].value["depth_mm"]
    assert depths[0] == 0.0
    assert 1.3 < depths[-1] < 2.0
    value = rectification(folder / "camera_calibration", "t").items["rectification/t"].value
    assert value["mm_per_px"][0] == pytest.approx(0.05, abs=0.002)


def test_a_scale() -> None:
    item = scale((0.06, 0.05), "t", method="a rule").items["mm_per_px/t"]
    assert (item.value, item.unit) == ([0.06, 0.05], "mm/px")
    with pytest.raises(CalibrationRefusedError, match="a scale of"):
        scale((0.0, 0.05), "t", method="a rule")
