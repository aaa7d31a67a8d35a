"""Video files that Rerun plays itself, and which of their frames belong to which sample."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import rerun as rr

from exumi_data.episode import StreamView
from exumi_data.model.images import VideoFile, VideoImages
from exumi_data.model.streams import images_of
from exumi_data.view.log import Log

__all__ = ["log_video", "not_playable"]

_CODECS = frozenset(("av1", "h264", "hevc", "vp8", "vp9"))
_CONTAINERS = frozenset(("video/mp4", "video/quicktime"))
_LARGEST = 256 << 20
"""Bytes of a file: the viewer holds it as a whole, and so does the one who logs it."""


@dataclass(frozen=True, slots=True)
class _Part:
    """The samples of a stream that lie in one file.

    Attributes
    ----------
    number : int
    first : int
    references_ns : (K,) int64
        For each sample from `first` on, the time in the file as Rerun counts it.
    """

    number: int
    first: int
    references_ns: npt.NDArray[np.int64]


def not_playable(stream: StreamView) -> str | None:
    """Return why Rerun would not play a stream's video, as far as its metadata tell.

    Parameters
    ----------
    stream : StreamView
        With frames that are stored as video.

    Returns
    -------
    str or None
        None where it would.
    """
    images = images_of(stream.metadata)
    for file in images.files if isinstance(images, VideoImages) else ():
        if file.codec not in _CODECS:
            return f"Rerun does not decode {file.codec}"
        if file.media_type not in _CONTAINERS:
            return f"Rerun does not read {file.media_type}"
        if file.bytes > _LARGEST:
            return f"{file.name} is larger than {_LARGEST >> 20} MiB"
    return None


def log_video(log: Log, stream: StreamView, path: str) -> str | None:
    """Log a stream's video files verbatim, and a reference to its frame for each sample.

    Parameters
    ----------
    log : Log
    stream : StreamView
        Whose metadata say that it is playable.
    path : str

    Returns
    -------
    str or None
        Why Rerun would not play it; then nothing was logged that matters. None where it does.

    Raises
    ------
    DamagedDataError
        A file cannot be read.
    """
    parts = []
    for number, asset in _assets(stream):
        part = _part(stream, number, asset)
        if part is None:
            return "Rerun does not find the same frames in it"
        parts.append(part)
    for number, asset in _assets(stream):
        log.fixed(f"{path}/file_{number}", asset)
    for part in parts:
        stop = part.first + len(part.references_ns)
        log.rows(
            path,
            stream.time[part.first : stop],
            rr.VideoFrameReference.columns(
                timestamp=[
                    rr.components.VideoTimestamp(nanoseconds=int(ns)) for ns in part.references_ns
                ],
                video_reference=[f"{path}/file_{part.number}"] * len(part.references_ns),
            ),
        )
    return None


def _assets(stream: StreamView) -> Iterator[tuple[int, rr.AssetVideo]]:
    """Yield the files that samples lie in, one at a time."""
    for number in np.unique(stream.array("file")).tolist():
        # Rerun reads QuickTime files as the MP4 files that they nearly are.
        yield number, rr.AssetVideo(contents=stream.container(number), media_type="video/mp4")


def _part(stream: StreamView, number: int, asset: rr.AssetVideo) -> _Part | None:
    """Find the frames of a file; None where Rerun finds others."""
    files = stream.array("file")
    mine = np.flatnonzero(files == number)
    images = images_of(stream.metadata)
    assert isinstance(images, VideoImages)  # noqa: S101  # the caller has looked
    expected_ns = _times_ns(stream.array("pts")[mine], images.files[number])
    try:
        found_ns = np.sort(np.asarray(asset.read_frame_timestamps_nanos(), np.int64))
    except (RuntimeError, ValueError):
        return None
    references = _same_frames(expected_ns, found_ns)
    return None if references is None else _Part(number, int(mine[0]), references)


def _times_ns(pts: np.ndarray, file: VideoFile) -> npt.NDArray[np.int64]:
    base = Fraction(file.time_base) * 1_000_000_000
    half = base.denominator // 2
    return np.array(  # Python's integers: the product of hostile numbers does not fit into 64 bits
        [(int(one) * base.numerator + half) // base.denominator for one in pts], np.int64
    )


def _same_frames(
    expected_ns: npt.NDArray[np.int64], found_ns: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64] | None:
    """Return for each expected time the frame that it is, or None where that is not clear.

    Rerun counts from the first frame, FFmpeg from where the file says; a stream may use a part of
    a file's frames.
    """
    if not len(found_ns) or len(expected_ns) > len(found_ns):
        return None
    shifts = {0}
    if len(expected_ns) == len(found_ns):
        shifts.add(int(found_ns[0] - expected_ns.min()))
    near_ns = int(np.diff(found_ns).min()) // 4 if len(found_ns) > 1 else 1_000_000
    for shift in sorted(shifts, key=abs):
        wanted = expected_ns + shift
        after = np.searchsorted(found_ns, wanted).clip(1, max(len(found_ns) - 1, 1))
        pairs = np.stack((found_ns[after - 1], found_ns[np.minimum(after, len(found_ns) - 1)]))
        apart = np.abs(pairs - wanted)
        nearest = np.take_along_axis(pairs, apart.argmin(axis=0)[None], axis=0)[0]
        if (np.abs(nearest - wanted) <= near_ns).all():
            return np.asarray(nearest, np.int64)
    return None
