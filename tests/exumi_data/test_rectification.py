"""Rectified and combined tactile images, against the released code's formulas."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exumi_data.tactile import ACTIVE_THRESHOLD_COMBINED, ActivityMeter
from exumi_data.tactile.combined import Combiner, combined_scale
from exumi_data.tactile.rectification import PixelMap, Rectifier, Turn, read_ninedtact

Image = npt.NDArray[np.uint8]
SENSORS = ("sensor_1", "sensor_2")


def random_map(height: int, width: int, seed: int) -> npt.NDArray[np.uint16]:
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, height, (height, width))
    columns = rng.integers(0, width, (height, width))
    return np.stack([rows, columns], axis=-1).astype(np.uint16)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(4, 40),
    st.integers(4, 40),
    st.sampled_from([1, 3]),
    st.sampled_from(["none", "left", "right"]),
    st.integers(0, 2**32 - 1),
    st.data(),
)
def test_pixels_are_moved_as_by_indexing(
    height: int, width: int, channels: int, turn: Turn, seed: int, data: st.DataObject
) -> None:
    index = random_map(height, width, seed)
    crop = (data.draw(st.integers(1, height)), data.draw(st.integers(1, width)))
    top = data.draw(st.integers(0, height - crop[0]))
    left = data.draw(st.integers(0, width - crop[1]))
    centre = (top + crop[0] / 2, left + crop[1] / 2)
    pixel_map = PixelMap(index, centre, crop)
    frame = np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)
    whole = frame[index[..., 0], index[..., 1]]
    cut = whole[top : top + crop[0], left : left + crop[1]]
    expected = np.rot90(cut, {"none": 0, "left": 1, "right": -1}[turn])
    assert np.array_equal(Rectifier(pixel_map, turn)(frame), expected)
    assert np.array_equal(
        Rectifier(None, turn)(frame), np.rot90(frame, {"none": 0, "left": 1, "right": -1}[turn])
    )


def released(image: Image, folder: Path) -> Image:
    """What 9DTact's `Camera.rectify_crop_image` does, with exUMI's crop."""
    row, column, position = (
        np.load(folder / f"{name}.npy", allow_pickle=False)
        for name in ("row_index", "col_index", "position_scale")
    )
    image = image[row, column]
    top, bottom = int(position[0] - 340 / 2), int(position[0] + 340 / 2)
    left, right = int(position[1] - 460 / 2), int(position[1] + 460 / 2)
    return image[top:bottom, left:right]


def calibration(real_data: Path, sensor: str) -> Path:
    return real_data / "ninedtact" / sensor / "camera_calibration"


def picture(folder: Path, name: str) -> Image:
    image = cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_COLOR_RGB)
    assert image is not None
    return np.asarray(image, np.uint8)


@pytest.mark.parametrize("name", ["ref", "sample"])
def test_real_fingers_are_combined_as_the_released_code_does(real_data: Path, name: str) -> None:
    folders = [calibration(real_data, sensor) for sensor in SENSORS]
    maps = [read_ninedtact(folder) for folder in folders]
    images = [picture(folder, name) for folder in folders]
    cut = [released(image, folder) for image, folder in zip(images, folders, strict=True)]
    for pixel_map, image, expected in zip(maps, images, cut, strict=True):
        assert np.array_equal(Rectifier(pixel_map)(image), expected)
    turned = [
        cv2.rotate(cut[0], cv2.ROTATE_90_COUNTERCLOCKWISE),
        cv2.rotate(cut[1], cv2.ROTATE_90_CLOCKWISE),
    ]
    combined = Combiner(*maps)(*images)
    assert combined.shape == (460, 680, 3)
    assert np.array_equal(combined, cv2.hconcat(turned))


def dots(image: Image) -> npt.NDArray[np.float64]:
    """The dark dots of the calibration plate, (N, 2) row and column."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    dark = cv2.GaussianBlur(grey, (0, 0), 18) - cv2.GaussianBlur(grey, (0, 0), 4)
    highest = cv2.dilate(dark, np.ones((25, 25)))
    rows, columns = np.nonzero((dark == highest) & (dark > 3))
    inside = (rows > 12) & (rows < len(grey) - 12) & (columns > 12)
    inside &= columns < grey.shape[1] - 12
    return np.column_stack([rows, columns])[inside].astype(np.float64)


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_dots_of_a_real_plate_stand_in_straight_rows(real_data: Path, sensor: str) -> None:
    folder = calibration(real_data, sensor)
    pixel_map = read_ninedtact(folder)
    assert pixel_map.mm_per_px is not None
    # 2.5 mm apart: position_scale.npy holds mm per pixel.
    pitch = 2.5 / pixel_map.mm_per_px[0]
    off = {}
    images = {"raw": picture(folder, "sample")}
    images["rectified"] = Rectifier(pixel_map)(images["raw"])
    for name, image in images.items():
        found = dots(image)
        assert len(found) > 30
        middle = found[np.abs(found - np.array(image.shape[:2]) / 2).sum(axis=1).argmin()]
        steps = (found - middle) / pitch
        off[name] = np.abs(steps - steps.round()) * pitch
    assert off["rectified"].mean() < 2.5
    assert off["rectified"].mean() < 0.4 * off["raw"].mean()


def test_maps_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    index = random_map(8, 10, 0)
    for centre, crop in (((4, 5), (9, 10)), ((3.9, 5), (8, 10)), ((4, 1), (4, 4))):
        with pytest.raises(ValueError, match="lies outside of the map"):
            PixelMap(index, centre, crop)
    outside = index.copy()
    outside[3, 3, 1] = 10
    with pytest.raises(ValueError, match="an index of the map lies outside"):
        PixelMap(outside, (4, 5), (4, 4))
    with pytest.raises(ValueError, match="uint16"):
        PixelMap(index[..., 0], (4, 5), (4, 4))
    with pytest.raises(ValueError, match="larger than"):
        PixelMap(np.zeros((1, 40_000, 2), np.uint16), (0.5, 1), (1, 1))
    with pytest.raises(ValueError, match=r"the frame is \(10, 8\), the map \(8, 10\)"):
        Rectifier(PixelMap(index, (4, 5), (8, 10)))(np.zeros((10, 8, 3), np.uint8))


def write_ninedtact(folder: Path, **changes: npt.NDArray[np.generic]) -> Path:
    files: dict[str, npt.NDArray[np.generic]] = {
        "row_index": np.mgrid[:480, :640][0].astype(np.int32),
        "col_index": np.mgrid[:480, :640][1].astype(np.int32),
        "position_scale": np.array([240.0, 327.0, 0.051]),
    }
    folder.mkdir()
    for name, values in (files | changes).items():
        np.save(folder / f"{name}.npy", values)
    return folder


def test_reading_what_9dtact_writes(tmp_path: Path) -> None:
    pixel_map = read_ninedtact(write_ninedtact(tmp_path / "good"))
    assert (pixel_map.crop.top, pixel_map.crop.left) == (70, 97)
    assert pixel_map.mm_per_px == (0.051, 0.051)
    other = read_ninedtact(tmp_path / "good", crop_px=(345, 460))
    assert (other.crop.top, other.crop.height) == (67, 345)  # 67.5, rounded down
    rows = np.mgrid[:480, :640][0]
    for name, changes, message in (
        ("floats", {"row_index": rows.astype(np.float32)}, "no whole numbers"),
        ("negative", {"row_index": rows - 1}, "no whole numbers"),
        ("shape", {"row_index": rows[:200]}, "row and column index are"),
        ("position", {"position_scale": np.zeros(2)}, "position and scale"),
        ("words", {"position_scale": np.array(["a"])}, "no array of numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            read_ninedtact(write_ninedtact(tmp_path / name, **changes))
    folder = write_ninedtact(tmp_path / "pickled")
    np.save(folder / "row_index.npy", np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle=False"):
        read_ninedtact(folder)
    (folder / "row_index.npy").unlink()
    with pytest.raises(FileNotFoundError):
        read_ninedtact(folder)


def test_fingers_that_do_not_stand_side_by_side_are_refused() -> None:
    combine = Combiner(None, None)
    left = np.zeros((30, 40, 3), np.uint8)
    assert combine(left, left).shape == (40, 60, 3)
    with pytest.raises(ValueError, match="differ"):
        combine(left, np.zeros((30, 42, 3), np.uint8))
    with pytest.raises(ValueError, match="differ"):
        combine(left, np.zeros((30, 40, 1), np.uint8))


def test_the_scale_is_turned_with_the_image() -> None:
    assert combined_scale((0.05, 0.06), (0.05, 0.06)) == pytest.approx((0.06, 0.05))
    assert combined_scale((0.04, 0.06), (0.06, 0.06)) == pytest.approx((0.06, 0.05))
    assert combined_scale((0.04, 0.06), None) is None


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0, 1))
def test_combined_activity_is_the_mean_of_the_halves(seed: int, left: float, right: float) -> None:
    """Each finger fills half of the image: its activity counts for half, the threshold as well."""
    rng = np.random.default_rng(seed)
    fingers = []
    for share in (left, right):
        reference = rng.integers(60, 190, (340, 460), dtype=np.uint8)
        blotch = cv2.GaussianBlur(rng.normal(0, 400 * share, (340, 460)), (0, 0), 9)
        frame = np.clip(reference + blotch, 0, 255).astype(np.uint8)
        fingers.append((frame[..., None], reference[..., None]))
    combine = Combiner(None, None)
    frame, reference = (combine(*pair)[..., 0] for pair in zip(*fingers, strict=True))
    combined = ActivityMeter(reference).measure(frame)
    halves = []
    for (frame, reference), turn in zip(fingers, (1, -1), strict=True):
        differences = [cv2.subtract(frame, reference), cv2.subtract(reference, frame)]
        small = [
            cv2.resize(
                np.ascontiguousarray(np.rot90(d.reshape(340, 460), turn)).astype(np.float32),
                (112, 224),
                interpolation=cv2.INTER_AREA,
            )
            for d in differences
        ]
        halves.append(float((np.maximum(*small) > 0.16 * 255 / 7).mean()))
    assert combined == pytest.approx(sum(halves) / 2, abs=2 / 224**2)
    # A pixel of a half is the mean of two of the finger's own image: one of them is active too.
    alone = [ActivityMeter(r[..., 0]).measure(f[..., 0]) for f, r in fingers]
    assert combined <= sum(alone) / 2 + 2 / 224**2
    assert combined <= max(alone) + 2 / 224**2


def test_one_finger_active_makes_the_combined_image_active() -> None:
    reference = np.full((340, 460, 1), 120, np.uint8)
    touched = reference.copy()
    touched[100:120, 200:220] += 30  # 400 of 156,400 pixels
    alone = ActivityMeter(reference[..., 0]).measure(touched[..., 0])
    combine = Combiner(None, None)
    both = ActivityMeter(combine(reference, reference)[..., 0])
    combined = both.measure(combine(touched, reference)[..., 0])
    assert combined == pytest.approx(alone / 2, rel=0.25)
    assert combined > ACTIVE_THRESHOLD_COMBINED
