"""The gel: pressed where the object is, smooth around it, untouched elsewhere."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from exumi_data.simulation import OBJECTS, Finger, SimulatedObject
from exumi_data.simulation.gel import Contact, GelPad
from exumi_data.simulation.gel_look import make_pad
from exumi_data.simulation.objects import height_map, object_by_name

SIZE = (120, 160)


@pytest.fixture(scope="module")
def pad() -> GelPad:
    return make_pad(SIZE, dotted=False, seed=3)


@pytest.mark.parametrize("item", OBJECTS, ids=lambda item: item.name)
@pytest.mark.parametrize("finger", ["left", "right"])
def test_membrane_reaches_the_indentation_and_never_lies_below_the_object(
    pad: GelPad, item: SimulatedObject, finger: Finger
) -> None:
    heights = height_map(item, finger, pad.m_per_px)
    assert heights.max() == pytest.approx(0.0, abs=1e-7)
    assert heights.dtype == np.float32

    contact = Contact(item.hold_depth_m, 0.0, 0.0, 0.0)
    skin_mm = pad.indentation_mm(heights, contact)
    depth_mm = item.hold_depth_m * 1e3
    middle = heights.shape[0] // 2
    window = heights[middle - 60 : middle + 60, middle - 80 : middle + 80]
    # Window and pad differ by half a pixel: compare the volumes, not the pixels.
    rigid_mm = np.maximum(window * 1e3 + depth_mm, 0.0)
    assert skin_mm.shape == SIZE
    assert 0.8 * depth_mm < skin_mm.max() <= depth_mm + 1e-3
    assert skin_mm.min() >= 0.0
    assert skin_mm.sum() > rigid_mm.sum()  # the halo around the object


def test_contact_moves_and_turns_with_the_object(pad: GelPad) -> None:
    heights = height_map(object_by_name("ball"), "left", pad.m_per_px)
    for u_m, v_m in ((0.0, 0.0), (3e-3, -1.5e-3), (-2e-3, 2e-3)):
        skin = pad.indentation_mm(heights, Contact(1e-3, u_m, v_m, 0.0))
        rows, columns = np.nonzero(skin > 0.5)
        assert (columns.mean() - 79.5) * pad.m_per_px == pytest.approx(u_m, abs=0.4e-3)
        assert (rows.mean() - 59.5) * pad.m_per_px == pytest.approx(v_m, abs=0.4e-3)

    bolt = height_map(object_by_name("bolt"), "left", pad.m_per_px)
    skin = pad.indentation_mm(bolt, Contact(1e-3, 0.0, 0.0, 0.4))
    # An upright bolt turned clockwise by 0.4 rad: its stripe leans to the left further down.
    upper, lower = (
        np.average(np.arange(160), weights=half.sum(axis=0)) for half in (skin[:40], skin[80:])
    )
    assert (lower - upper) / 80 == pytest.approx(-np.tan(0.4), abs=0.15)


def test_bump_is_bright_towards_each_light(pad: GelPad) -> None:
    heights = height_map(object_by_name("ball"), "left", pad.m_per_px)
    image = pad.render(heights, Contact(1.1e-3, 0.0, 0.0, 0.0), 1).astype(float)
    change = image - pad.reference()
    rows, columns = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    away = np.hypot(rows - 59.5, columns - 79.5) * pad.m_per_px
    ring = (away > 5e-3) & (away < 7e-3)
    left, right = columns < 60, columns > 99
    assert change[ring & left][:, 0].mean() > 3 > -1 > change[ring & right][:, 0].mean()  # red
    assert change[ring & right][:, 1].mean() > 3 > -1 > change[ring & left][:, 1].mean()  # green
    top, bottom = rows < 50, rows > 69
    assert change[ring & top][:, 2].mean() > 3 > -1 > change[ring & bottom][:, 2].mean()  # blue


def test_without_contact_only_noise_differs_from_the_reference(pad: GelPad) -> None:
    image = pad.render(np.zeros((3, 3), np.float32), Contact(0.0, 0.0, 0.0, 0.0), 5)
    difference = image.astype(int) - pad.reference()
    assert np.abs(difference).max() < 8
    assert abs(difference.mean()) < 0.1
    assert 0.8 < difference.std() < 1.8


def test_dots_follow_the_skin() -> None:
    dotted = make_pad(SIZE, dotted=True, seed=3)
    heights = height_map(object_by_name("ball"), "left", dotted.m_per_px)

    def dots(shear: tuple[float, float, float]) -> NDArray[np.float64]:
        image = dotted.render(heights, Contact(1e-3, 0.0, 0.0, 0.0, shear), 5)
        dark = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[50:70, 70:90] < 55
        rows, columns = np.nonzero(dark)
        return np.array([columns.mean(), rows.mean()]) * dotted.m_per_px

    moved = dots((0.5e-3, 0.3e-3, 0.0)) - dots((0.0, 0.0, 0.0))
    np.testing.assert_allclose(moved, [0.5e-3, 0.3e-3], atol=0.12e-3)
