"""The frames of a clip, one at a time, and how its camera sees them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_data.camera import resized
from exumi_data.errors import UsageError
from exumi_data.model.calibration import Intrinsics
from exumi_data.store.video import FramePixels, VideoDecoder

__all__ = ["clip_frames", "clip_size", "fitting"]


def clip_frames(
    path: Path, *, start_ns: int = 0, threads: int = 1, apart_ns: int = 0
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Go through the frames of a video file, grey, with the times that the container states.

    Parameters
    ----------
    path : pathlib.Path
    start_ns : int, optional
        Time of the container's zero.
    threads : int, optional
        That decode.
    apart_ns : int, optional
        Frames that are nearer than this to the one before are decoded and left out.

    Raises
    ------
    SourceError
        It is no video.
    """
    pixels = (
        FramePixels()
    )  # takes the frame's own luma: PyAV's way to grey takes four times as long
    with VideoDecoder(str(path), path, threads=threads) as video:
        base = video.time_base
        before: int | None = None
        for frame in video.frames():
            time = start_ns + round(int(frame.pts or 0) * base * 1_000_000_000)
            if before is not None and time - before < apart_ns:
                continue
            before = time
            yield time, pixels.luma(frame)


def fitting(camera: Intrinsics, width: int, height: int, where: object) -> Intrinsics:
    """Return intrinsics for images of a size: those given, or resized if the shape is the same.

    Parameters
    ----------
    camera : Intrinsics
    width, height : int
    where : object
        Named in errors.

    Raises
    ------
    UsageError
        The images have another shape: they are cropped, and nobody knows where.
    """
    if (camera.width, camera.height) == (width, height):
        return camera
    if abs(camera.width * height - camera.height * width) > max(camera.width, camera.height):
        raise UsageError(
            f"intrinsics for {camera.width}x{camera.height} do not fit images of {width}x{height}",
            where=where,
            fix="Calibrate the camera in the mode that it records in.",
        )
    return resized(camera, width, height)


def clip_size(path: Path) -> tuple[int, int]:
    """Return width and height of a clip's frames.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    SourceError
        It is no video.
    """
    with VideoDecoder(str(path), path) as video:
        return video.width, video.height
