"""Frames: where they lie, whether they are whole, and whether they are what they should be."""

import math
from collections.abc import Iterator

import numpy as np

from exumi_data.errors import DamagedDataError, ExumiError
from exumi_data.model.images import ArrayImages, EncodedImages
from exumi_data.model.streams import RgbStream, TactileStream
from exumi_data.store import jpeg
from exumi_data.store.images import MAX_FRAME_BYTES
from exumi_data.store.shards import ArrayReader, crc32c
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.frozen import FrozenFrames
from exumi_validators.registry import check
from exumi_validators.report import Problem
from exumi_validators.touch_pass import begin_statistics

__all__ = ["array_frames", "encoded_frames", "frames", "offsets"]


def _image_streams(
    episode: EpisodeContext, encoding: type[ArrayImages | EncodedImages]
) -> Iterator[tuple[str, ArrayImages | EncodedImages]]:
    for name, stream in episode.streams.items():
        if isinstance(stream, RgbStream | TactileStream) and isinstance(stream.images, encoding):
            yield name, stream.images


@check("IMG-004")
def offsets(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the offsets divide the data among the frames."""
    for name, _ in _image_streams(episode, EncodedImages):
        yield from _offset_problems(episode, name)


def _offset_problems(episode: EpisodeContext, name: str) -> Iterator[Problem]:
    path = f"streams/{name}/offset"
    data = episode.reader(f"streams/{name}/data")
    last = 0
    for start, (offset,) in episode.blocks(path):
        if start == 0 and offset[0] != 0:
            yield problem("IMG-004", path, index=0, detail=f"the first offset is {offset[0]}")
            return
        joined = np.concatenate((np.array([last], np.uint64), offset))
        back = joined[1:] < joined[:-1]
        if back.any():
            row = int(back.argmax())
            detail = f"offset {start + row} is {joined[row + 1]}, after {joined[row]}"
            yield problem("IMG-004", path, index=start + row, detail=detail)
            return
        last = int(offset[-1])
    if path in episode.scanned and data is not None and last != data.shape[0]:
        detail = f"the last offset is {last}, the data has {data.shape[0]} bytes"
        yield problem("IMG-004", path, detail=detail)


@check("IMG-005", "IMG-006", "IMG-007", "IMG-008", "IMG-009")
def frames(episode: EpisodeContext) -> Iterator[Problem]:
    """Read and decode every frame that is stored as a file or as pixels."""
    for name, images in _image_streams(episode, EncodedImages):
        assert isinstance(images, EncodedImages)  # noqa: S101  # that is what was asked for
        if not any(_offset_problems(episode, name)):
            yield from encoded_frames(episode, name, images)
    for name, _ in _image_streams(episode, ArrayImages):
        yield from array_frames(episode, name)


def encoded_frames(episode: EpisodeContext, name: str, images: EncodedImages) -> Iterator[Problem]:
    """Judge the frames of a stream stored as ``encoded``.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the stream.
    images : EncodedImages
    """
    base = f"streams/{name}"
    data = episode.reader(f"{base}/data")
    offset, checksum = episode.reader(f"{base}/offset"), episode.reader(f"{base}/crc32c")
    count = episode.count(name)
    if data is None or offset is None or checksum is None or count is None:
        return
    if offset.shape[0] != count + 1 or checksum.shape[0] != count:
        return
    size = (images.height, images.width, images.channels)
    if math.prod(size) > MAX_FRAME_BYTES or f"{base}/offset" not in episode.scanned:
        return
    # The luma alone: every bit of a file is still decoded, but no colour is computed.
    luma = np.empty((*size[:2], 1), dtype=np.uint8)
    frozen, statistics = _frozen_frames(episode), begin_statistics(episode, name)
    for start, (time, crc) in episode.blocks(f"{base}/time", f"{base}/crc32c"):
        edges = offset.rows(start, start + len(time) + 1).tolist()
        for row, (instant, expected) in enumerate(zip(time.tolist(), crc.tolist(), strict=True)):
            index = start + row
            length = edges[row + 1] - edges[row]
            if length > MAX_FRAME_BYTES:
                reason = f"its file has {length} bytes"
                yield problem("IMG-006", f"{base}/data", index=index, detail=reason)
                continue
            try:
                file = data.bytes_at(edges[row], length)
            except (ExumiError, OSError) as error:
                reason = str(getattr(error, "what", error))
                yield problem("IMG-006", f"{base}/data", index=index, detail=reason)
                continue
            found = crc32c(file)
            if found != expected:
                shown = f"{found:08x}"
                yield problem(
                    "IMG-005", f"{base}/data", index=index, expected=f"{expected:08x}", found=shown
                )
            mistakes = tuple(_file_problems(file, index, f"{base}/data", images, luma))
            yield from mistakes
            if statistics is not None and found == expected and not mistakes:
                statistics.add(index, luma)
                if statistics.searches(index):
                    statistics.search(index, _colours(file, luma, images.channels))
            episode.frames += 1
            run = frozen.add(index, instant, found)
            if run is not None:
                yield from _frozen(run, f"{base}/data")
    if statistics is not None:
        statistics.end()
    yield from _frozen(frozen.end(), f"{base}/data")


def _colours(file: bytes, luma: np.ndarray, channels: int) -> np.ndarray:
    """Decode a file that was decoded before, with its colours."""
    if channels == 1:
        return luma
    out = np.empty((*luma.shape[:2], channels), dtype=np.uint8)
    jpeg.decode_into(file, out)
    return out


def _file_problems(
    file: bytes, index: int, path: str, images: EncodedImages, luma: np.ndarray
) -> Iterator[Problem]:
    """Judge a file, and decode its luma."""
    declared = (images.height, images.width, images.channels)
    try:
        size = jpeg.size_of(file)
    except DamagedDataError as error:
        yield problem("IMG-006", path, index=index, detail=error.what)
        return
    if size != declared:
        yield problem("IMG-007", path, index=index, expected=list(declared), found=list(size))
        return
    if not jpeg.is_jpeg(file):
        yield problem("IMG-006", path, index=index, detail="the JPEG has no end")
        return
    try:
        jpeg.decode_into(file, luma)
    except DamagedDataError as error:
        yield problem("IMG-006", path, index=index, detail=error.what)
        return
    if images.jpeg_comment is not None:
        comment = jpeg.comment(file)
        if comment != images.jpeg_comment:
            expected = images.jpeg_comment
            found_comment = comment or "none"
            yield problem("IMG-008", path, index=index, expected=expected, found=found_comment)


def array_frames(episode: EpisodeContext, name: str) -> Iterator[Problem]:
    """Judge the frames of a stream stored as ``array``.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the stream.
    """
    base = f"streams/{name}"
    data, count = episode.reader(f"{base}/data"), episode.count(name)
    if data is None or data.shape[0] != count:
        return
    frozen, statistics = _frozen_frames(episode), begin_statistics(episode, name)
    for start, (time,) in episode.blocks(f"{base}/time"):
        for row, instant in enumerate(time.tolist()):
            index = start + row
            try:
                frame = _pixels(data, index)
            except (ExumiError, OSError) as error:
                reason = str(getattr(error, "what", error))
                yield problem("IMG-006", f"{base}/data", index=index, detail=reason)
                continue
            if statistics is not None:
                image = np.frombuffer(frame, np.uint8).reshape(data.shape[1:])
                statistics.add(index, image)
                statistics.search(index, image)
            episode.frames += 1
            yield from _frozen(frozen.add(index, instant, hash(frame)), f"{base}/data")
    if statistics is not None:
        statistics.end()
    yield from _frozen(frozen.end(), f"{base}/data")


def _pixels(data: ArrayReader, index: int) -> bytes:
    row_bytes = data.document.row_bytes
    return data.bytes_at(index * row_bytes, row_bytes)


def _frozen_frames(episode: EpisodeContext) -> FrozenFrames:
    return FrozenFrames(
        longer_than_s=episode.limit("IMG-009", "same_s"),
        frames=episode.limit("IMG-009", "frames"),
    )


def _frozen(run: tuple[int, int, float] | None, path: str) -> Iterator[Problem]:
    if run is not None:
        first, length, seconds = run
        yield problem("IMG-009", path, index=first, found=length, detail=f"{seconds:.1f} s")
