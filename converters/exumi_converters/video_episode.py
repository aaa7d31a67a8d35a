"""One video file becomes one image stream, with what is derived from it.

Frames of MJPEG are files of their own and are stored as such, verbatim; of any other codec the
container file is stored, verbatim. Nothing is encoded again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
from av.video.frame import VideoFrame

from exumi_converters.frame_files import (
    FrameFile,
    FrameFiles,
    add_jpeg_stream,
    add_lossy,
    encoder_name,
)
from exumi_converters.image_stream import AddedStream, StreamSpec, describe_clock, times_of
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_data.errors import SourceError
from exumi_data.model import InputFile, LossyStep, QualityNote, VideoFile, VideoImages
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import VideoStreamWriter
from exumi_data.store.video import FramePixels, VideoDecoder, VideoFrames, is_grey, probe_video

__all__ = ["VideoHeader", "add_video", "read_header"]

_FIX = "Get the file again from its source, or leave it out."
_FEW = 0.5  # below this share of the usual number of frames a clip counts as truncated


@dataclass(frozen=True, slots=True)
class VideoHeader:
    """What a container says without decoding.

    Attributes
    ----------
    codec : str
    rate : Fraction or None
    frames : int
        0 when it does not say.
    """

    codec: str
    rate: Fraction | None
    frames: int


def read_header(path: Path) -> VideoHeader | None:
    """Read a container's header; None when it cannot be read."""
    try:
        with VideoDecoder(str(path), path) as decoder:
            return VideoHeader(decoder.codec, decoder.rate, decoder.declared_frames)
    except SourceError:
        return None


def add_video(
    writer: EpisodeWriter,
    spec: StreamSpec,
    path: Path,
    file: InputFile,
    *,
    usual_frames: int | None = None,
) -> AddedStream:
    """Store a video file as a stream, with reference, activity and salience if it is tactile.

    Parameters
    ----------
    writer : EpisodeWriter
    spec : StreamSpec
    path : pathlib.Path
    file : InputFile
        Its name and digest.
    usual_frames : int, optional
        How many frames files like this one have: one with far fewer is flagged.

    Returns
    -------
    AddedStream

    Raises
    ------
    SourceError
        Not one frame can be decoded.
    """
    with VideoDecoder(str(path), path) as decoder:
        header = VideoHeader(decoder.codec, decoder.rate, decoder.declared_frames)
        if header.codec == "mjpeg":
            packets = _Packets(path)
            files = FrameFiles(packets.read, decoder.time_base, header.rate, path)
            added, problem = add_jpeg_stream(writer, spec, files), packets.problem
        else:
            added, problem = _add_inter_frame(writer, spec, path, file, decoder)
    note = _length_note(spec.name, len(added.times), header, usual_frames, problem)
    if note is not None:
        writer.metadata.quality.append(note)
    return added


def _length_note(
    stream: str, frames: int, header: VideoHeader, usual: int | None, problem: str | None
) -> QualityNote | None:
    """Say that frames are missing, if the header, the siblings or the decoder say so."""
    if header.frames > frames:
        text = f"the file declares {header.frames} frames, {frames} can be decoded"
        return QualityNote(
            code="truncated", message=text + (f" ({problem})" if problem else ""), stream=stream
        )
    if problem:
        text = f"decoding ended early, after {frames} frames ({problem})"
        return QualityNote(code="truncated", message=text, stream=stream)
    if usual is not None and frames < usual:
        text = f"the clip has {frames} frames; others of its rate in the same folder have {usual}"
        few = frames < _FEW * usual
        return QualityNote(
            code="truncated" if few else "short",
            message=text,
            stream=stream,
            severity="warning" if few else "info",
        )
    return None


class _Packets:
    """The packets of an MJPEG file, which are JPEG files."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.problem: str | None = None

    def read(self) -> Iterator[FrameFile]:
        """Yield (pts, file)."""
        with VideoDecoder(str(self._path), self._path) as decoder:
            for packet in decoder.packets():
                pts = packet.pts if packet.pts is not None else packet.dts
                if pts is None:
                    raise SourceError("a frame has no time", where=self._path, fix=_FIX)
                yield int(pts), bytes(packet)
            self.problem = decoder.problem


class _Clip:
    """The frames of an inter-frame video file that decode, and what is known of them."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._pixels = FramePixels()
        self.channels: Literal[1, 3] = 3
        self.pts: list[int] = []
        self.keyframe: list[int] = []
        self.corrupt: list[int] = []
        self.dropped = 0
        self.problem: str | None = None

    def first_pass(self, decoder: VideoDecoder, *, grey: bool) -> Iterator[np.ndarray | None]:
        """Decode every frame once; yield its luma, (H, W) uint8, if that is wanted."""
        self.channels = 1 if is_grey(decoder.pixel_format) else 3
        size = decoder.width, decoder.height
        for frame in self._sound(decoder):
            index = len(self.pts)
            if (frame.width, frame.height) != size:
                raise SourceError(
                    f"frame {index} is {frame.width}x{frame.height}, the header says "
                    f"{size[0]}x{size[1]}",
                    where=self._path,
                    fix="Frames of one stream have one size: divide the file where it changes.",
                )
            if frame.is_corrupt:
                self.corrupt.append(index)
            self.keyframe.append(index if frame.key_frame or not index else self.keyframe[-1])
            self.pts.append(int(frame.pts or 0))
            yield self._pixels.grey(frame) if grey else None
        self.problem = decoder.problem

    def _sound(self, decoder: VideoDecoder) -> Iterator[VideoFrame]:
        """Yield frames without the incomplete ones at the end: a cut file ends with one."""
        held: list[VideoFrame] = []
        for frame in decoder.frames():
            if frame.is_corrupt:
                held.append(frame)
                continue
            yield from held
            held = []
            yield frame
        self.dropped = len(held)

    def greys(self) -> Iterator[np.ndarray]:
        """Decode the frames again, (H, W) uint8 luma."""
        with VideoDecoder(str(self._path), self._path) as decoder:
            for _, frame in zip(self.pts, decoder.frames(), strict=False):
                yield self._pixels.grey(frame)

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Decode some frames again, ascending, each (H, W, 3) uint8 RGB."""
        frames = VideoFrames(
            str(self._path), np.array(self.pts), np.array(self.keyframe), self._path
        )
        try:
            chosen = [frames.frame(index) for index in indices]
        finally:
            frames.close()
        if self.channels == 1:
            return [self._pixels.grey(frame)[..., None] for frame in chosen]
        return [self._pixels.rgb(frame) for frame in chosen]


def _add_inter_frame(
    writer: EpisodeWriter, spec: StreamSpec, path: Path, file: InputFile, decoder: VideoDecoder
) -> tuple[AddedStream, str | None]:
    clip, analysis = _Clip(path), TactileAnalysis()
    tactile = spec.kind == "tactile"
    for grey in clip.first_pass(decoder, grey=tactile):
        if grey is not None:
            analysis.add(grey)
    if not clip.pts:
        reason = clip.problem or "the video stream is empty"
        raise SourceError(f"no frame can be decoded ({reason})", where=path, fix=_FIX)
    times = times_of(clip.pts, decoder.time_base)
    if (np.diff(times) <= 0).any():
        raise SourceError("the frames' times do not increase", where=path, fix=_FIX)
    stream: VideoStreamWriter = writer.add_stream(
        spec.name,
        kind=spec.kind,
        images=VideoImages(
            encoding="video",
            height=decoder.height,
            width=decoder.width,
            channels=clip.channels,
        ),
        **spec.fields(),
    )
    stream.append_file(
        path,
        _video_file(decoder, path, file),
        pts=np.array(clip.pts),
        keyframe=np.array(clip.keyframe),
    )
    describe_clock(stream, times, decoder.rate, decoder.time_base)
    _note_losses(writer, spec.name, decoder, clip)
    if tactile:
        analysis.finish(writer, stream, clip)
    problem = clip.problem or ("the last one is incomplete" if clip.dropped else None)
    return AddedStream(stream, times), problem


def _video_file(decoder: VideoDecoder, path: Path, file: InputFile) -> VideoFile:
    media_type = probe_video(path.name)
    if media_type is None:
        raise SourceError("not the name of a video file", where=path)
    base = decoder.time_base
    values = {
        "name": path.name,
        "media_type": media_type,
        "codec": decoder.codec,
        "time_base": f"{base.numerator}/{base.denominator}",
        "start_ns": 0,
        "sha256": file.sha256,
        "bytes": file.bytes,
    }
    if decoder.pixel_format is not None:
        values["pixel_format"] = decoder.pixel_format
    return VideoFile.model_validate(values)


def _note_losses(writer: EpisodeWriter, stream: str, decoder: VideoDecoder, clip: _Clip) -> None:
    if clip.corrupt:
        listed = ", ".join(map(str, clip.corrupt[:5])) + (", ..." if len(clip.corrupt) > 5 else "")
        writer.metadata.quality.append(
            QualityNote(
                code="damaged-frames",
                message=f"{len(clip.corrupt)} of {len(clip.pts)} frames are incomplete in the file "
                f"and were patched by the decoder: {listed}; those up to the next keyframe build "
                "on them",
                stream=stream,
            )
        )
    step = LossyStep(
        step="video-encode",
        stream=stream,
        detail=f"the frames were encoded as {decoder.codec} ({decoder.pixel_format}) before this "
        "conversion, which kept the file's bytes",
    )
    if decoder.encoder:
        step.by = encoder_name(decoder.encoder)
    add_lossy(writer, step)
