"""Frames stored as video: the files, where frames lie in them, and whether they decode."""

from collections.abc import Iterator
from fractions import Fraction
from typing import IO, Any

import numpy as np

from exumi_data.errors import ExumiError
from exumi_data.model.images import VideoFile, VideoImages
from exumi_data.model.streams import RgbStream, StreamModel, TactileStream
from exumi_data.time import NS_PER_S, apply_clock
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.frame_statistics import FrameStatistics
from exumi_validators.registry import check
from exumi_validators.report import Problem
from exumi_validators.touch_pass import begin_statistics
from exumi_validators.video_file import looks_like, open_file, sha256_of

__all__ = ["containers", "file_index", "file_offsets", "keyframes", "pts_ascends", "time_of_pts"]

_ROUNDING_NS = 1


def _video_streams(
    episode: EpisodeContext,
) -> Iterator[tuple[str, StreamModel, VideoImages]]:
    for name, stream in episode.streams.items():
        if isinstance(stream, RgbStream | TactileStream) and isinstance(stream.images, VideoImages):
            yield name, stream, stream.images


@check("VID-001")
def file_offsets(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the offsets divide the data among the files."""
    for name, _, images in _video_streams(episode):
        detail = _offset_mistake(episode, name, images.files)
        if detail:
            yield problem("VID-001", f"streams/{name}/offset", detail=detail)


def _offset_mistake(episode: EpisodeContext, name: str, files: list[VideoFile]) -> str | None:
    reader = episode.reader(f"streams/{name}/offset")
    if reader is None:
        return None
    if reader.shape[0] != len(files) + 1:
        return f"there are {reader.shape[0]} offsets for {len(files)} files"
    offset = _edges(episode, name)
    if offset is None or offset[0] != 0:
        return None if offset is None else f"the first offset is {offset[0]}"
    for index, file in enumerate(files):
        length = offset[index + 1] - offset[index]
        if length != file.bytes:
            return f"file {index} has {length} bytes, the metadata says {file.bytes}"
    data = episode.reader(f"streams/{name}/data")
    if data is not None and offset[-1] != data.shape[0]:
        return f"the last offset is {offset[-1]}, the data has {data.shape[0]} bytes"
    return None


def _edges(episode: EpisodeContext, name: str) -> list[int] | None:
    """Where the files begin and end; None when it cannot be read."""
    path = f"streams/{name}/offset"
    edges: list[int] = []
    for _, (offset,) in episode.blocks(path):
        edges += offset.tolist()
    return edges if path in episode.scanned else None


@check("VID-002")
def file_index(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that frames come file by file."""
    for name, _, images in _video_streams(episode):
        yield from _file_problems(episode, name, len(images.files))


def _file_problems(episode: EpisodeContext, name: str, files: int) -> Iterator[Problem]:
    path = f"streams/{name}/file"
    last = 0
    for start, (file,) in episode.blocks(path):
        joined = np.concatenate((np.array([last], np.uint32), file))
        wrong = (joined[1:] < joined[:-1]) | (file >= files)
        if wrong.any():
            row = int(wrong.argmax())
            expected = f"{joined[row]} to {files - 1}"
            found = int(file[row])
            yield problem("VID-002", path, index=start + row, expected=expected, found=found)
            return
        last = int(file[-1])


@check("VID-003")
def pts_ascends(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that presentation times ascend within a file."""
    for name, _, _ in _video_streams(episode):
        yield from _pts_problems(episode, name)


def _pts_problems(episode: EpisodeContext, name: str) -> Iterator[Problem]:
    path = f"streams/{name}/pts"
    last: tuple[np.ndarray, np.ndarray] | None = None
    for start, (pts, file) in episode.blocks(path, f"streams/{name}/file"):
        all_pts = pts if last is None else np.concatenate((last[0], pts))
        of_file = file if last is None else np.concatenate((last[1], file))
        wrong = (all_pts[1:] <= all_pts[:-1]) & (of_file[1:] == of_file[:-1])
        if wrong.any():
            row = int(wrong.argmax())
            index = start + row + (last is None)
            expected, found = int(all_pts[row]), int(all_pts[row + 1])
            yield problem("VID-003", path, index=index, expected=expected, found=found)
            return
        last = pts[-1:], file[-1:]


@check("VID-004")
def keyframes(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that decoding can start where it is said to start."""
    for name, _, images in _video_streams(episode):
        if not any(_file_problems(episode, name, len(images.files))):
            yield from _keyframe_problems(episode, name)


def _keyframe_problems(episode: EpisodeContext, name: str) -> Iterator[Problem]:
    path = f"streams/{name}/keyframe"
    known, before = -1, -1  # keyframe and file of the frame before
    for start, (keyframe, file) in episode.blocks(path, f"streams/{name}/file"):
        own = np.arange(start, start + len(keyframe), dtype=np.uint64)
        first_of_file = file != np.concatenate((np.array([before]), file[:-1]))
        same = np.zeros(len(keyframe), dtype=bool)
        same[1:] = keyframe[1:] == keyframe[:-1]
        same[0] = int(keyframe[0]) == known
        wrong = (keyframe != own) & (first_of_file | ~same)
        if wrong.any():
            row = int(wrong.argmax())
            detail = "a frame is a keyframe itself, or has that of the frame before it"
            if first_of_file[row]:
                detail = "the first frame of a file is its own keyframe"
            found = int(keyframe[row])
            yield problem("VID-004", path, index=start + row, found=found, detail=detail)
            return
        known, before = int(keyframe[-1]), int(file[-1])


def _index_is_sound(episode: EpisodeContext, name: str, images: VideoImages) -> bool:
    """Whether frames can be looked for in the files at all."""
    return not (
        _offset_mistake(episode, name, images.files)
        or any(_file_problems(episode, name, len(images.files)))
        or any(_pts_problems(episode, name))
        or any(_keyframe_problems(episode, name))
    )


@check("VID-005")
def time_of_pts(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that time follows from the presentation times."""
    for name, stream, images in _video_streams(episode):
        if stream.clock.raw_time is not None:
            continue  # then the raw time is another one, and has a rule of its own
        base = f"streams/{name}"
        for start, (time, pts, file) in episode.blocks(
            f"{base}/time", f"{base}/pts", f"{base}/file"
        ):
            expected = _expected_time(pts, file, images.files, stream)
            if expected is None:
                continue
            wrong = np.asarray(np.abs(time - expected) > _ROUNDING_NS, dtype=bool)
            if wrong.any():
                row = int(wrong.argmax())
                yield problem(
                    "VID-005",
                    f"{base}/time",
                    index=start + row,
                    expected=int(expected[row]),
                    found=int(time[row]),
                )
                break


def _expected_time(
    pts: np.ndarray, file: np.ndarray, files: list[VideoFile], stream: StreamModel
) -> np.ndarray | None:
    raw = np.zeros(len(pts), dtype=object)
    for index in np.unique(file).tolist():
        if index >= len(files):
            return None
        chosen = file == index
        scale = Fraction(files[index].time_base) * NS_PER_S
        # Python's integers: pts times the scale may leave 64 bits.
        values: Any = pts[chosen].astype(object)
        twice = 2 * scale.denominator
        raw[chosen] = (
            files[index].start_ns + (2 * values * scale.numerator + scale.denominator) // twice
        )
    if stream.clock.is_identity:
        return raw
    clock = stream.clock
    try:
        return apply_clock(
            raw.astype(np.int64),
            t_ref=clock.t_ref_ns,
            drift_ppm=clock.drift_ppm,
            offset_ns=clock.offset_ns,
            latency_ns=clock.latency_ns,
        )
    except (ValueError, OverflowError):
        return None


@check("VID-006", "VID-007", "VID-008", "VID-009", "VID-010")
def containers(episode: EpisodeContext) -> Iterator[Problem]:
    """Digest every file and decode every frame."""
    for name, _, images in _video_streams(episode):
        if not _index_is_sound(episode, name, images):
            continue
        data, edges = episode.reader(f"streams/{name}/data"), _edges(episode, name)
        if data is None or edges is None:
            continue
        listed, statistics = _Listed(episode, name), begin_statistics(episode, name)
        for index, file in enumerate(images.files):
            path = f"streams/{name}/data"
            try:
                container = open_file(data, edges[index], edges[index + 1])
                found = sha256_of(container)
                if found != file.sha256:
                    yield problem("VID-006", path, index=index, expected=file.sha256, found=found)
                yield from _container_problems(
                    episode, path, index, container, images, listed, statistics
                )
            except (ExumiError, OSError) as error:
                detail = f"cannot be read: {getattr(error, 'what', error)}"
                yield problem("VID-007", path, index=index, detail=detail)
        if statistics is not None:
            statistics.end()


class _Listed:
    """The listed frames, one after the other.

    Attributes
    ----------
    current : (int, int, int, bool) or None
        Index, file, pts, and whether it is a keyframe; None after the last one.
    """

    def __init__(self, episode: EpisodeContext, name: str) -> None:
        base = f"streams/{name}"
        self._rows = self._read(episode, (f"{base}/file", f"{base}/pts", f"{base}/keyframe"))
        self.current = next(self._rows, None)

    @staticmethod
    def _read(
        episode: EpisodeContext, paths: tuple[str, ...]
    ) -> Iterator[tuple[int, int, int, bool]]:
        for start, (file, pts, keyframe) in episode.blocks(*paths):
            columns = zip(file.tolist(), pts.tolist(), keyframe.tolist(), strict=True)
            for index, (number, instant, key) in enumerate(columns, start=start):
                yield index, number, instant, key == index

    def step(self) -> tuple[int, int, int, bool] | None:
        """Go to the next frame, and return it."""
        self.current = next(self._rows, None)
        return self.current


def _container_problems(
    episode: EpisodeContext,
    path: str,
    number: int,
    container: IO[bytes],
    images: VideoImages,
    listed: _Listed,
    statistics: FrameStatistics | None,
) -> Iterator[Problem]:
    from exumi_data.store.video import VideoDecoder, most_pixels  # PyAV is slow to import

    file = images.files[number]
    container.seek(0)
    if not looks_like(container.read(12), file.media_type):
        yield problem("VID-007", path, index=number, detail=f"it is no {file.media_type}")
        return
    container.seek(0)
    pixels = most_pixels(images.height, images.width)
    with VideoDecoder(container, file.name, pixels=pixels) as decoder:
        mistake = _declaration_mistake(decoder, file, images)
        if mistake:
            yield problem("VID-007", path, index=number, detail=mistake)
            return
        yield from _decoded_problems(episode, path, number, decoder, images, listed, statistics)


def _declaration_mistake(decoder: Any, file: VideoFile, images: VideoImages) -> str | None:
    from exumi_data.store.video import is_grey  # PyAV is slow to import

    if decoder.codec != file.codec:
        return f"its codec is {decoder.codec}, the metadata says {file.codec}"
    if decoder.time_base != Fraction(file.time_base):
        return f"its time base is {decoder.time_base}, the metadata says {file.time_base}"
    if (decoder.height, decoder.width) != (images.height, images.width):
        return (
            f"it is {decoder.width}x{decoder.height}, "
            f"the metadata says {images.width}x{images.height}"
        )
    if file.pixel_format is not None and decoder.pixel_format != file.pixel_format:
        return f"its pixels are {decoder.pixel_format}, the metadata says {file.pixel_format}"
    channels = 1 if is_grey(decoder.pixel_format) else 3
    if channels != images.channels:
        return f"it has {channels} channels, the metadata says {images.channels}"
    return None


def _decoded_problems(
    episode: EpisodeContext,
    path: str,
    number: int,
    decoder: Any,
    images: VideoImages,
    listed: _Listed,
    statistics: FrameStatistics | None,
) -> Iterator[Problem]:
    from exumi_data.store.video import FramePixels

    # Of every frame of every video: what can be had beforehand is not asked for again.
    size, pixels = (images.height, images.width), FramePixels()
    row, unlisted = listed.current, 0
    first_unlisted: int | None = None
    for frame in decoder.frames():
        pts = frame.pts
        while row is not None and row[1] == number and row[2] < pts:
            yield problem("VID-008", path, index=row[0], detail=f"no frame has the pts {row[2]}")
            row = listed.step()
        if row is None or row[1] != number or row[2] != pts:
            unlisted += 1
            first_unlisted = pts if first_unlisted is None else first_unlisted
            continue
        index = row[0]
        if (frame.height, frame.width) != size:
            detail = f"it is {frame.width}x{frame.height}"
            yield problem("VID-008", path, index=index, detail=detail)
        elif statistics is not None:
            # The luma as it is stored, where it will do: colours cost as much as decoding.
            grey, levels = pixels.stored_grey(frame)
            statistics.add(index, grey, levels=levels)
            if statistics.searches(index):
                statistics.search(index, pixels.rgb(frame))
        if row[3] and not frame.key_frame:
            yield problem("VID-010", path, index=index)
        episode.frames += 1
        row = listed.step()
    while row is not None and row[1] == number:
        reason = decoder.problem or "the file ends before it"
        yield problem("VID-008", path, index=row[0], detail=reason)
        row = listed.step()
    if first_unlisted is not None:
        yield problem("VID-009", path, index=number, found=unlisted, expected=first_unlisted)
