"""Readings out of recordings: the streams of an episode, the frames of a clip."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration import intrinsics_of
from exumi_data.clips.frames import clip_size, fitting
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import SourceError, UsageError
from exumi_data.model.calibration import INTRINSICS, Intrinsics
from exumi_data.model.streams import images_of
from exumi_data.standard import flags
from exumi_data.synchronisation.sweep import PoseTrack
from exumi_data.synchronisation.timing import CameraTiming, Range
from exumi_recorders.calibration.files import Calibration

__all__ = [
    "ImageFolder",
    "activity_of",
    "as_stamped",
    "camera_times",
    "clip_intrinsics",
    "frames_of",
    "intrinsics_for",
    "motion_energy",
    "pose_track",
    "stream_of",
    "width_track",
]


_IMAGES = (".png", ".jpg", ".jpeg", ".bmp")
# Stamps of the first row's beginning; others are of a frame that is there already.
_AT_START = ("buffer_soe", "container_pts", "device", "simulated", "nominal_rate")


def stream_of(episode: Episode, kind: str, name: str | None) -> StreamView:
    """Return the stream that a user means.

    Parameters
    ----------
    episode : Episode
    kind : str
    name : str, optional
        Default: the only one of its kind, or the one that is called like its kind.

    Raises
    ------
    UsageError
        There is none, or more than one and it is not clear which.
    """
    if name is not None:
        stream = episode[name]
        if stream.kind != kind:
            raise UsageError(f"{name!r} is a stream of kind {stream.kind}", where=episode.path)
        return stream
    streams = {stream.name: stream for stream in episode.of_kind(kind)}
    if not streams:
        raise UsageError(f"has no stream of kind {kind}", where=episode.path)
    chosen = next(iter(streams)) if len(streams) == 1 else kind
    if chosen not in streams:
        raise UsageError(
            f"which stream of kind {kind}: {', '.join(streams)}",
            where=episode.path,
            fix="Name it with the option for it.",
        )
    return streams[chosen]


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


def width_track(stream: StreamView) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the valid widths of a stream with their times.

    Parameters
    ----------
    stream : StreamView
        Of kind width.

    Returns
    -------
    time_ns : (N,) int64
    width_m : (N,) float64
        Metres.
    """
    width = np.asarray(stream.data, np.float64)
    good = _usable(stream) & np.isfinite(width)
    return np.asarray(stream.time, np.int64)[good], width[good]


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


def clip_intrinsics(path: Path, calibration: Calibration | None, name: str) -> Intrinsics:
    """Return the intrinsics of a clip's camera, for the clip's frames.

    Parameters
    ----------
    path : pathlib.Path
        The clip.
    calibration : Calibration or None
    name : str
        Of the item.

    Raises
    ------
    UsageError
        The calibration has no such item, or it does not fit the frames.
    SourceError
        The clip is no video.
    """
    if calibration is None or name not in calibration.items:
        raise UsageError(
            f"the calibration file has no {name}",
            where=path,
            fix="Import it: exumi calibrate camera FILE --stream NAME --out ..., and say --camera "
            "NAME.",
        )
    return fitting(Intrinsics.model_validate(calibration.items[name].value), *clip_size(path), path)


def camera_times(stream: StreamView) -> tuple[NDArray[np.int64], CameraTiming]:
    """Return the times of a camera's frames, and how they lie to what the frames show.

    A camera whose latency is known has its events at `time`; of another one, only the stamps are
    known.

    Parameters
    ----------
    stream : StreamView
        With frames.

    Returns
    -------
    time_ns : (N,) int64
    CameraTiming
    """
    clock = stream.metadata.clock
    time = np.asarray(stream.time, np.int64)
    if clock.latency_ns or clock.latency_sigma_ns is not None:
        none = Range(0.0, 0.0)
        return time, CameraTiming(none, none, known_sigma_s=1e-9 * (clock.latency_sigma_ns or 0.0))
    return time, CameraTiming(stamped="start" if clock.stamp_point in _AT_START else "end")


def activity_of(stream: StreamView) -> NDArray[np.float32]:
    """Return the activity of tactile frames: as it is stored, else measured.

    Parameters
    ----------
    stream : StreamView
        Of kind tactile.

    Raises
    ------
    UsageError
        None is stored, and there is no reference to measure it by.
    """
    from exumi_data.tactile import ActivityMeter, to_grey

    stored = stream.activity
    if stored is not None:
        return np.asarray(stored, np.float32)
    reference = stream.reference
    if reference is None:
        raise UsageError(
            f"{stream.name!r} has neither activity nor a reference to measure it by",
            where=stream.name,
            fix="Record it with a reference: exumi calibrate tactile.",
        )
    meter = ActivityMeter(reference)
    return np.array([meter.measure(to_grey(frame)) for frame in stream.frames], np.float32)


def motion_energy(frames: Iterable[NDArray[np.uint8]]) -> NDArray[np.float64]:
    """Return by how much each frame differs from the one before: mean grey levels.

    Parameters
    ----------
    frames : iterable of (H, W, C) uint8

    Returns
    -------
    (N - 1,) float64
    """
    import cv2

    energy: list[float] = []
    before: NDArray[np.uint8] | None = None
    for frame in frames:
        grey = cv2.blur(frame.reshape(*frame.shape[:2], -1).mean(axis=2).astype(np.uint8), (5, 5))
        if before is not None:
            energy.append(float(cv2.absdiff(np.asarray(grey), before).mean()))
        before = np.asarray(grey, np.uint8)
    return np.array(energy, np.float64)


class ImageFolder(Sequence[NDArray[np.uint8]]):
    """The images of a folder in the order of their names, each read when it is asked for.

    Parameters
    ----------
    folder : pathlib.Path
        With PNG, JPEG or BMP files.
    """

    def __init__(self, folder: Path) -> None:
        self._paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in _IMAGES)

    def __len__(self) -> int:
        return len(self._paths)

    @overload
    def __getitem__(self, key: int) -> NDArray[np.uint8]: ...
    @overload
    def __getitem__(self, key: slice) -> list[NDArray[np.uint8]]: ...
    def __getitem__(self, key: int | slice) -> NDArray[np.uint8] | list[NDArray[np.uint8]]:
        """Return an image, (H, W, 3) uint8, or a list of several."""
        import cv2

        if isinstance(key, slice):
            return [self[i] for i in range(*key.indices(len(self)))]
        path = self._paths[key]
        image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise SourceError("no image", where=path)
        return np.ascontiguousarray(image[..., ::-1], np.uint8)
