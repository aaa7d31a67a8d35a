"""Readings out of recordings: the streams of an episode, the frames of a clip."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration import intrinsics_of
from exumi_data.camera import resized
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UsageError
from exumi_data.model.calibration import INTRINSICS, Intrinsics
from exumi_data.model.streams import images_of
from exumi_data.standard import flags
from exumi_recorders.calibration.files import Calibration
from exumi_recorders.calibration.sweep import PoseTrack

__all__ = [
    "as_stamped",
    "clip_frames",
    "fitting",
    "frames_of",
    "intrinsics_for",
    "pose_track",
    "stream_of",
]


def stream_of(episode: Episode, kind: str, name: str | None) -> StreamView:
    """Return the stream that a user means: the one that is named, or the only one of its kind.

    Parameters
    ----------
    episode : Episode
    kind : str
    name : str, optional

    Raises
    ------
    UsageError
        There is none, or more than one and none is named.
    """
    if name is not None:
        stream = episode[name]
        if stream.kind != kind:
            raise UsageError(f"{name!r} is a stream of kind {stream.kind}", where=episode.path)
        return stream
    streams = episode.of_kind(kind)
    if len(streams) != 1:
        names = ", ".join(stream.name for stream in streams) or "none"
        raise UsageError(
            f"which stream of kind {kind}: {names}", where=episode.path, fix="Name it."
        )
    return streams[0]


def as_stamped(stream: StreamView) -> NDArray[np.int64]:
    """Return the times of a stream without its latency taken out, ns.

    A latency that is measured by these is one of the stamps, whatever was known of it before.
    """
    return np.asarray(stream.time + stream.metadata.clock.latency_ns, np.int64)


def _usable(stream: StreamView) -> NDArray[np.bool_]:
    """Return which samples are not flagged as invalid."""
    marks = stream.flags
    if marks is None:
        return np.ones(len(stream), np.bool_)
    return np.asarray((marks & flags()["invalid"].mask) == 0)


def pose_track(stream: StreamView) -> PoseTrack:
    """Return the valid poses of a stream with their stamps.

    Parameters
    ----------
    stream : StreamView
        Of kind pose.
    """
    poses = np.asarray(stream.data, np.float64)
    good = _usable(stream) & np.isfinite(poses).all(axis=1)
    good &= np.linalg.norm(poses[:, 3:], axis=1) > 0.5
    return PoseTrack(as_stamped(stream)[good], poses[good])


def frames_of(
    stream: StreamView, time_ns: NDArray[np.int64]
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Go through the frames of a stream with their times, one at a time."""
    for time, frame in zip(time_ns.tolist(), stream.frames, strict=True):
        yield int(time), frame


def clip_frames(path: Path, *, start_ns: int = 0) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Go through the frames of a video file, grey, with the times that the container states.

    Parameters
    ----------
    path : pathlib.Path
    start_ns : int, optional
        Time of the container's zero.

    Raises
    ------
    SourceError
        It is no video.
    """
    from exumi_data.store.video import VideoDecoder

    with VideoDecoder(str(path), path) as video:
        base = video.time_base
        for frame in video.frames():
            time = start_ns + round(int(frame.pts or 0) * base * 1_000_000_000)
            yield time, np.asarray(frame.to_ndarray(format="gray"), np.uint8)


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


def intrinsics_for(
    episode: Episode, stream: StreamView, calibration: Calibration | None
) -> Intrinsics:
    """Return the intrinsics of a stream's camera: from a calibration, else from the episode.

    Parameters
    ----------
    episode : Episode
    stream : StreamView
    calibration : Calibration or None

    Raises
    ------
    UsageError
        They are not known.
    MetadataError
        They are none.
    """
    name = INTRINSICS + stream.name
    images = images_of(stream.metadata)
    if calibration is not None and name in calibration.items and images is not None:
        camera = Intrinsics.model_validate(calibration.items[name].value)
        return fitting(camera, images.width, images.height, f"{episode.path}: {stream.name}")
    found = intrinsics_of(episode, stream.name)
    if found is None:
        raise UsageError(
            f"nothing says how the camera of {stream.name!r} sees",
            where=episode.path,
            fix="Put its intrinsics into the calibration file: exumi calibrate camera.",
        )
    return found
