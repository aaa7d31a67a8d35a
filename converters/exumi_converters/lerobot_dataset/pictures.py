"""The pictures of one episode: a file of its own verbatim, else cut out of a shared one."""

import struct
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.frame_files import (
    FrameFile,
    FrameFiles,
    add_jpeg_stream,
    add_lossy,
    add_png_stream,
)
from exumi_converters.image_stream import AddedStream, StreamSpec
from exumi_converters.lerobot_dataset.mapping import ImageStream
from exumi_converters.lerobot_dataset.parquet_files import column_rows
from exumi_converters.video_episode import add_video
from exumi_data.errors import SourceError
from exumi_data.model import InputFile, LossyStep, QualityNote, Sensor
from exumi_data.store import jpeg
from exumi_data.store.digest import sha256_file
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.video import MAX_PIXELS, FramePixels, VideoDecoder
from exumi_data.time import format_rate, nominal_times

__all__ = ["Pictures", "add_embedded", "add_pictures"]

_QUALITY = 95
_NS = 1_000_000_000
_TOLERANCE_S = 1e-4
"""LeRobot's own: a frame that is farther from its timestamp cannot be read by it."""
_PNG = b"\x89PNG\r\n\x1a\n"
_FIX = "Get the file again from its source, or leave the episode out."


@dataclass(frozen=True, slots=True)
class Pictures:
    """Where the frames of an episode lie.

    Attributes
    ----------
    path : pathlib.Path
        The video.
    file : InputFile
        Its name and digest.
    begin_s : float
        When the episode begins in it.
    alone : bool
        Whether no other episode has frames in it.
    count : int
        Frames of the episode.
    rate : Fraction
    """

    path: Path
    file: InputFile
    begin_s: float
    alone: bool
    count: int
    rate: Fraction


def add_pictures(writer: EpisodeWriter, image: ImageStream, source: Pictures) -> None:
    """Store the frames of an episode: the video's own bytes wherever that can be.

    Raises
    ------
    SourceError
        There are not as many frames as the episode has, or not at their times.
    """
    spec = StreamSpec(name=image.name, kind=image.kind, sensor=None)
    with VideoDecoder(str(source.path), source.path) as decoder:
        whole = source.alone and decoder.declared_frames in {0, source.count}
    if whole and source.begin_s < 0.5 / source.rate:
        added = add_video(writer, spec, source.path, source.file)
    else:
        added = _add_cut(writer, spec, source)
    _check_frames(writer, added, source)
    _describe(added, image)


def _add_cut(writer: EpisodeWriter, spec: StreamSpec, source: Pictures) -> AddedStream:
    """Cut the episode's frames out: copied where they stand by themselves, else as JPEG."""
    with tempfile.TemporaryDirectory() as folder:
        cut = Path(folder, "frames.mp4")
        with VideoDecoder(str(source.path), source.path) as decoder:
            first, stop = _range(source, decoder.time_base)
            copied = decoder.codec != "mjpeg" and decoder.copy_frames(first, stop, str(cut))
        if copied:
            size = cut.stat().st_size
            file = InputFile(name=cut.name, sha256=sha256_file(cut), bytes=size)
            added = add_video(writer, spec, cut, file)
            added.stream.model.description = (
                f"frames of {source.file.name} from {source.begin_s:.6f} s, copied without "
                "decoding into a file of their own"
            )
            return added
    return _add_jpegs(writer, spec, source)


def _range(source: Pictures, time_base: Fraction) -> tuple[int, int]:
    """Return the first pts of the episode and the one after its last: half a frame before."""
    begin = Fraction(source.begin_s)
    half = Fraction(1, 2) / source.rate
    end = begin + source.count / source.rate
    return round((begin - half) / time_base), round((end - half) / time_base)


def _add_jpegs(writer: EpisodeWriter, spec: StreamSpec, source: Pictures) -> AddedStream:
    def read() -> Iterator[FrameFile]:
        pixels = FramePixels()
        with VideoDecoder(str(source.path), source.path) as decoder:
            first, stop = _range(source, decoder.time_base)
            decoder.seek(max(0, first))
            wanted = (f for f in decoder.frames() if first <= int(f.pts or 0))
            for number, frame in enumerate(wanted):
                if int(frame.pts or 0) >= stop:
                    return
                yield number, jpeg.encode(pixels.rgb(frame), _QUALITY)

    files = FrameFiles(read, 1 / source.rate, source.rate, source.path, clock="none")
    added = add_jpeg_stream(writer, spec, files)
    add_lossy(
        writer,
        LossyStep(
            step="jpeg-encode",
            stream=spec.name,
            detail=f"frames of {source.file.name} from {source.begin_s:.6f} s, which cannot be "
            "decoded without those around them, were encoded as JPEG, quality "
            f"{_QUALITY}",
        ),
    )
    return added


def _check_frames(writer: EpisodeWriter, added: AddedStream, source: Pictures) -> None:
    if added.stream.count != source.count:
        raise SourceError(
            f"holds {added.stream.count} frames of the episode, which has {source.count}",
            where=source.path,
            fix=_FIX,
        )
    off = np.abs(added.times - nominal_times(source.count, source.rate))
    if (off * float(source.rate) >= _NS / 2).any():
        raise SourceError(
            f"frames are up to {off.max() / _NS:.4f} s away from where the episode's rate puts "
            "them: nothing says which belongs to which row",
            where=source.path,
            fix=_FIX,
        )
    if (off >= _TOLERANCE_S * _NS).any():
        writer.metadata.quality.append(
            QualityNote(
                code="timestamps-off",
                message=f"frames are up to {off.max() / _NS:.6f} s away from their rows' "
                "timestamps: LeRobot refuses to read them; the frames' own times were kept",
                stream=added.stream.name,
            )
        )


def _describe(added: AddedStream, image: ImageStream) -> None:
    """Take up what is known of the sensor."""
    model: Any = added.stream.model
    if "sensor" in image.fields:
        model.sensor = Sensor.model_validate(image.fields["sensor"])
    if image.kind == "tactile" and "mm_per_px" in image.fields:
        model.mm_per_px = image.fields["mm_per_px"]
    own = image.fields.get("description")
    if own:
        model.description = own
    elif not model.description:
        model.description = f"feature {image.feature}"


def add_embedded(
    writer: EpisodeWriter, image: ImageStream, path: Path, episode: int, rate: Fraction
) -> int:
    """Store pictures that lie in the table itself: JPEG verbatim, PNG as pixels.

    Parameters
    ----------
    writer : EpisodeWriter
    image : ImageStream
    path : pathlib.Path
        The file of rows.
    episode : int
    rate : Fraction

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    SourceError
    """

    def read() -> Iterator[FrameFile]:
        for number, value in enumerate(column_rows(path, episode, image.feature)):
            data = value.get("bytes") if isinstance(value, dict) else None
            if not data:
                raise SourceError(
                    f"picture {number} of {image.feature!r} is not in the table", where=path
                )
            yield number, data

    first = next((data for _, data in read()), b"")
    files = FrameFiles(read, 1 / rate, rate, path, clock="none")
    spec = StreamSpec(name=image.name, kind=image.kind, sensor=None)
    if first.startswith(_PNG):
        checked = FrameFiles(lambda: _checked(read(), path), 1 / rate, rate, path, clock="none")
        added = add_png_stream(writer, spec, checked)
    elif first.startswith(b"\xff\xd8"):
        added = add_jpeg_stream(writer, spec, files)
    else:
        raise SourceError(f"pictures of {image.feature!r} are neither PNG nor JPEG", where=path)
    _describe(added, image)
    added.stream.model.nominal_rate = format_rate(rate)
    return added.stream.count


def _checked(files: Iterator[FrameFile], path: Path) -> Iterator[FrameFile]:
    """Yield PNG files that do not claim more pixels than are decoded."""
    for number, data in files:
        size = struct.unpack(">II", data[16:24]) if len(data) >= 24 else (0, 0)
        if not 0 < size[0] * size[1] <= MAX_PIXELS:
            raise SourceError(f"picture {number} claims {size[0]}x{size[1]} pixels", where=path)
        yield number, data
