"""The RGB of a video frame has the grey that is its luma: a reference in RGB fits grey frames."""

import av
import numpy as np
import pytest

from exumi_data.store.video import FramePixels
from exumi_data.tactile import ActivityMeter, to_grey

BT601, BT709 = 5, 1


def gel(
    pixel_format: str, colorspace: int, *, height: int = 240, width: int = 320
) -> av.VideoFrame:
    """A gel in three lights: red, green and blue from its sides."""
    y, x = np.mgrid[:height, :width]
    lights = np.stack([60 + x * 120 / width, 50 + y * 140 / height, 180 - x * 120 / width], axis=-1)
    picture = av.VideoFrame.from_ndarray(lights.astype(np.uint8), format="rgb24")
    frame = picture.reformat(format=pixel_format, dst_colorspace=colorspace)
    frame.colorspace = colorspace
    return frame


FORMATS = ["yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj422p", "nv12", "yuv420p10le"]


@pytest.mark.parametrize("size", [(240, 320), (239, 321)])
@pytest.mark.parametrize("colorspace", [BT601, BT709])
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_grey_is_that_of_rgb(pixel_format: str, colorspace: int, size: tuple[int, int]) -> None:
    frame = gel(pixel_format, colorspace, height=size[0], width=size[1])
    pixels = FramePixels()
    above = pixels.grey(frame).astype(int) - to_grey(pixels.rgb(frame))
    assert abs(above.mean()) < 0.1  # cut off instead of rounded: 0.9 to 1.4
    assert abs(above).max() <= 2


@pytest.mark.parametrize("colorspace", [BT601, BT709])
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_grey_as_it_is_stored_is_that_grey(pixel_format: str, colorspace: int) -> None:
    frame, pixels = gel(pixel_format, colorspace), FramePixels()
    stored, levels = pixels.stored_grey(frame)
    grey = stored if levels is None else levels[stored]
    assert abs(grey.astype(int) - pixels.grey(frame)).max() <= 1


@pytest.mark.parametrize("pixel_format", FORMATS)
def test_rgb_is_what_the_gel_was(pixel_format: str) -> None:
    pixels = FramePixels()
    rgb = pixels.rgb(gel(pixel_format, BT601)).astype(int)
    assert (
        np.abs((rgb - gel_rgb()).mean(axis=(0, 1))).max() < 1.5
    )  # another matrix, order or range: tens


def gel_rgb() -> np.ndarray:
    return gel("rgb24", BT601).to_ndarray().astype(int)


@pytest.mark.parametrize("colorspace", [BT601, BT709])
def test_a_frame_is_not_active_for_its_own_reference(colorspace: int) -> None:
    frame, pixels = gel("yuv420p", colorspace), FramePixels()
    # A threshold that a bias of a level and a quarter would pass.
    meter = ActivityMeter(pixels.rgb(frame), threshold=1.1)
    assert meter.measure(pixels.grey(frame)) < 0.01
