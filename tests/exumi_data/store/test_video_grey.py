"""The luma of a video frame is what FFmpeg's own scaler gives, level by level."""

import av
import numpy as np
import pytest
from av.video.reformatter import VideoReformatter

from exumi_data.store.video import FramePixels


def frame_of(pixel_format: str, color_range: int) -> av.VideoFrame:
    """A frame whose luma has every level from 0 to 255."""
    frame = av.VideoFrame(320, 240, pixel_format)
    for index, plane in enumerate(frame.planes):
        levels = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)  # type: ignore[call-overload]  # PyAV's stubs do not say that a plane is a buffer
        levels[:] = np.resize(np.arange(256), levels.shape) if index == 0 else 128
    frame.color_range = color_range
    return frame


@pytest.mark.parametrize("color_range", [0, 1, 2])
@pytest.mark.parametrize(
    "pixel_format",
    ["yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj422p", "yuvj444p", "nv12", "gray"],
)
def test_grey_is_ffmpeg_s_for_every_level(pixel_format: str, color_range: int) -> None:
    frame = frame_of(pixel_format, color_range)
    expected = VideoReformatter().reformat(frame, format="gray").to_ndarray()
    grey = FramePixels().grey(frame)
    assert grey.shape == (240, 320)
    assert grey.dtype == np.uint8
    assert np.array_equal(grey, expected)
    assert len(np.unique(grey)) > 200


def test_grey_does_not_share_the_decoder_s_buffer() -> None:
    frame = frame_of("yuvj420p", 2)
    grey = FramePixels().grey(frame)
    before = grey.copy()
    plane = np.frombuffer(frame.planes[0], np.uint8)  # type: ignore[call-overload]  # PyAV's stubs do not say that a plane is a buffer
    plane[:] = 0
    assert np.array_equal(grey, before)
