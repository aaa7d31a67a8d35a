"""Video files decoded from memory with PyAV, frame by frame, with a bounded buffer."""

import io
import os
from collections.abc import Iterator
from fractions import Fraction
from itertools import chain
from typing import IO, Any

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation, VideoReformatter

from exumi_data.errors import DamagedDataError, SourceError
from exumi_data.store.mp4_tables import tables_mistake

__all__ = [
    "LIMITED_TO_FULL",
    "MAX_PIXELS",
    "FramePixels",
    "MjpegPackets",
    "VideoDecoder",
    "VideoFrames",
    "most_pixels",
    "probe_video",
]

MAX_PIXELS = 1 << 25
"""Pixels of the largest frame that is decoded: more than 8K has."""
_MARGIN = 128  # decoders fill up the edges
_PASS_OVER = 48  # AVDISCARD_ALL
_REORDERED = 64  # packets that a decoder may hold back, and more
_LEAST_PIXELS = 1 << 20  # and have buffers that do not shrink with the picture

_EXTENSIONS = {
    ".mov": "video/quicktime",
    ".mp4": "video/mp4",
    ".avi": "video/x-msvideo",
    ".mkv": "video/x-matroska",
    ".webm": "video/webm",
}


# What FFmpeg's own scaler gives for these formats, value by value, at a quarter of its price.
_FULL_RANGE_FORMATS = frozenset(("yuvj420p", "yuvj422p", "yuvj444p", "gray"))
_PLANAR = _FULL_RANGE_FORMATS | {"yuv420p", "yuv422p", "yuv444p"}
_FULL_RANGE = 2  # AVCOL_RANGE_JPEG
_BT601 = frozenset((2, 5, 6))  # AVCOL_SPC_*; FFmpeg takes unspecified, the first, for BT.601
# FFmpeg's quick way to RGB cuts off where it should round: its grey is 1.3 levels below the luma,
# of which activity and what models see (7 times the difference from the reference) are made.
_ROUNDED = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
_BLACK = 16  # of limited range; white is 235
_TO_FULL = 255 / 219

LIMITED_TO_FULL = np.clip(np.rint((np.arange(256) - _BLACK) * _TO_FULL), 0, 255).astype(np.uint8)
"""Levels of full range by levels of limited range."""


class FramePixels:
    """Turn decoded frames into RGB or luma arrays; keeps FFmpeg's scaling context."""

    def __init__(self) -> None:
        self._reformatter = VideoReformatter()

    def rgb(self, frame: VideoFrame) -> np.ndarray:
        """Return (H, W, 3) uint8 RGB, of which `to_grey` makes what `grey` gives, to a level."""
        if _is_common(frame):  # rounded as well, and quicker
            planes = frame.to_ndarray()
            return np.asarray(cv2.cvtColor(planes, cv2.COLOR_YUV2RGB_I420), np.uint8)
        # Where grey is made of RGB, it does not matter how that is rounded.
        way = _ROUNDED if frame.colorspace in _BT601 else None
        return self._reformatter.reformat(
            frame, format="rgb24", threads=1, interpolation=way
        ).to_ndarray()

    def grey(self, frame: VideoFrame) -> np.ndarray:
        """Return (H, W) uint8 grey: luma in full range, no colour computed.

        The luma of other colours than BT.601's weighs them otherwise than grey does, by tens of
        levels where they are strong: grey is made of RGB there, as it is of images.
        """
        if _luma_is_grey(frame):
            return self.luma(frame)
        return np.asarray(cv2.cvtColor(self.rgb(frame), cv2.COLOR_RGB2GRAY), np.uint8)

    def stored_grey(self, frame: VideoFrame) -> tuple[np.ndarray, np.ndarray | None]:
        """Return (H, W) uint8 as cheaply as can be, and the table that makes of it what `grey` is.

        The table is (256,) uint8, or None where there is nothing to change. Nothing is copied where
        the frame has a plane of it: it is the frame's own memory then.
        """
        if not _luma_is_grey(frame):
            return self.grey(frame), None
        luma, is_full_range = self.stored_luma(frame)
        return luma, None if is_full_range else LIMITED_TO_FULL

    def luma(self, frame: VideoFrame) -> np.ndarray:
        """Return (H, W) uint8, the frame's own Y in full range: for what is looked for in it."""
        if frame.format.name in _PLANAR:
            luma, is_full_range = self.stored_luma(frame)
            if is_full_range:
                return luma.copy()
            above = cv2.max(luma, _BLACK)  # type: ignore[call-overload]  # it takes a number, too
            return np.asarray(
                cv2.convertScaleAbs(above, alpha=_TO_FULL, beta=-_BLACK * _TO_FULL), np.uint8
            )
        return self.stored_luma(frame)[0]

    def stored_luma(self, frame: VideoFrame) -> tuple[np.ndarray, bool]:
        """Return (H, W) uint8 luma as the decoder left it, and whether it is of full range.

        Nothing is copied where the frame has a plane of it: it is the frame's own memory then.
        """
        name = frame.format.name
        if name not in _PLANAR:
            grey = self._reformatter.reformat(frame, format="gray", threads=1).to_ndarray()
            return grey, True
        plane = frame.planes[0]
        luma: np.ndarray = np.ndarray(
            (plane.height, plane.width),
            np.uint8,
            plane,  # type: ignore[arg-type]  # PyAV's stubs do not say that a plane is a buffer
            strides=(plane.line_size, 1),
        )
        return luma, frame.color_range == _FULL_RANGE or name in _FULL_RANGE_FORMATS

    def into(self, frame: VideoFrame, out: np.ndarray) -> None:
        """Fill `out`, (H, W, 1|3) uint8."""
        pixels = self.grey(frame)[..., None] if out.shape[2] == 1 else self.rgb(frame)
        if pixels.shape != out.shape:
            raise DamagedDataError(
                f"the video frame is {pixels.shape[1]}x{pixels.shape[0]}, "
                f"the metadata says {out.shape[1]}x{out.shape[0]}"
            )
        out[:] = pixels


def _luma_is_grey(frame: VideoFrame) -> bool:
    """Whether a frame's luma weighs the colours as grey does."""
    return frame.colorspace in _BT601 or is_grey(frame.format.name)


def _is_common(frame: VideoFrame) -> bool:
    """Whether OpenCV converts a frame as FFmpeg does: BT.601, limited range, even size."""
    return (
        frame.format.name == "yuv420p"
        and frame.color_range != _FULL_RANGE
        and frame.colorspace in _BT601
        and frame.width % 2 == 0
        and frame.height % 2 == 0
    )


# A playlist or a list of files under a video's name would make FFmpeg open what it names.
_CONTAINERS_ONLY = {"format_whitelist": "mov,avi,matroska,webm"}


def is_grey(pixel_format: str | None) -> bool:
    """Whether a pixel format of FFmpeg's has no colours.

    Parameters
    ----------
    pixel_format : str or None
        Its name, such as ``gray`` or ``yuv420p``.
    """
    return pixel_format is not None and pixel_format.startswith(("gray", "ya8", "ya16", "mono"))


def most_pixels(height: int, width: int) -> int:
    """Return the limit of pixels for a video whose metadata gives this size."""
    return min(MAX_PIXELS, max(_LEAST_PIXELS, (height + _MARGIN) * (width + _MARGIN)))


def _open(source: bytes | str | IO[bytes], where: object, pixels: int, threads: int) -> Any:
    file = io.BytesIO(source) if isinstance(source, bytes) else source
    _check_tables(file, where)
    # Twice: while the container is looked through, and in the decoder itself.
    limit = {"max_pixels": str(pixels)}
    try:
        container = av.open(file, options=_CONTAINERS_ONLY | limit)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise SourceError(
            f"not a readable video ({_short(error)})",
            where=where,
            fix="Check that the file is complete; play it with ffplay.",
        ) from None
    if not container.streams.video:
        container.close()
        raise SourceError("the file holds no video stream", where=where)
    context = container.streams.video[0].codec_context
    if context is None:  # PyAV's stubs do not know of streams that nothing decodes
        container.close()  # type: ignore[unreachable]
        raise SourceError("there is no decoder for the video", where=where)
    context.thread_count = threads
    if threads > 1:
        context.thread_type = "AUTO"
    context.options = limit
    return container


def _check_tables(file: str | IO[bytes], where: object) -> None:
    try:
        if isinstance(file, str):
            with open(file, "rb") as opened:  # noqa: PTH123  # a name, as av.open takes it
                mistake = tables_mistake(opened)
        else:
            mistake = tables_mistake(file)
    except OSError:
        return  # it is told by who opens it
    if mistake:
        raise SourceError(f"not a readable video ({mistake})", where=where)


def _short(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error).split(";")[0]


def _alone(packets: Iterator[Any], first: int, stop: int) -> Iterator[Any]:
    """Yield the packets of frames from `first` to before `stop`; None: one leans on later ones.

    In the order of decoding, whatever a frame is made from comes before it.
    """
    beyond = 0
    for packet in packets:
        inside = first <= packet.pts < stop
        if inside and beyond:
            yield None
            return
        if inside:
            yield packet
        elif packet.pts >= stop:
            beyond += 1
            if beyond > _REORDERED:
                return


class VideoDecoder:
    """Decode one video file in presentation order.

    Parameters
    ----------
    source : bytes, str or binary file
        The file's bytes, its path, or something to read and seek in.
    where : object
        Named in errors.
    pixels : int
        Most pixels of a frame.
    threads : int
        That decode: more than one where nothing else is to be done at the same time.

    Attributes
    ----------
    codec, pixel_format : str
    time_base : fractions.Fraction
        Seconds per unit of pts.
    rate : fractions.Fraction or None
        The container's nominal frame rate.
    height, width : int
    declared_frames : int
        What the container says; 0 when it does not say.
    encoder : str or None
        Who made the file, as it says itself.
    duration_s : float or None
        Of the video, as the container says.
    tags : dict of str to str
        What the container and its video say in words, such as ``timecode`` and ``creation_time``.
    problem : str or None
        Why decoding ended before the end of the file, once it has.
    """

    def __init__(
        self,
        source: bytes | str | IO[bytes],
        where: object,
        *,
        pixels: int = MAX_PIXELS,
        threads: int = 1,
    ) -> None:
        self.where = where
        self._container = _open(source, where, pixels, threads)
        stream = self._container.streams.video[0]
        self._stream = stream
        context = stream.codec_context
        self.codec: str = context.codec.canonical_name
        self.pixel_format: str | None = context.pix_fmt
        self.time_base: Fraction = Fraction(stream.time_base)
        rate = stream.average_rate or stream.base_rate
        self.rate: Fraction | None = Fraction(rate) if rate else None
        self.height: int = context.height
        self.width: int = context.width
        self.declared_frames: int = stream.frames
        names = (stream.metadata.get("encoder"), self._container.metadata.get("encoder"))
        self.encoder: str | None = " ".join(filter(None, names)) or None
        self.duration_s: float | None = (
            float(stream.duration * stream.time_base) if stream.duration else None
        )
        self.tags: dict[str, str] = {**self._container.metadata, **stream.metadata}
        self.problem: str | None = None

    def __enter__(self) -> "VideoDecoder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the decoder."""
        self._container.close()

    def frames(self) -> Iterator[VideoFrame]:
        """Yield frames in presentation order until the end, or until decoding fails."""
        try:
            for frame in self._container.decode(self._stream):
                if frame.pts is None:
                    self.problem = "a frame has no presentation time"
                    return
                yield frame
        except (av.FFmpegError, OSError, ValueError) as error:
            self.problem = _short(error)

    def keyframes(self) -> Iterator[VideoFrame]:
        """Yield the keyframes alone; what lies between them is not decoded.

        Nothing else can be decoded with this decoder afterwards.
        """
        self._stream.codec_context.skip_frame = "NONKEY"
        yield from self.frames()

    def seek(self, pts: int) -> None:
        """Go to the keyframe at or before `pts`.

        Raises
        ------
        DamagedDataError
            There is no such place in the file.
        """
        try:
            self._container.seek(pts, stream=self._stream, backward=True)
        except (av.FFmpegError, OSError, ValueError, OverflowError) as error:
            raise DamagedDataError(
                f"pts {pts} cannot be found ({_short(error)})", where=self.where
            ) from None

    def packets(self) -> Iterator[Any]:
        """Yield the packets of the video stream, undecoded."""
        yield from self._packets((self._stream,))

    def copy_frames(self, first: int, stop: int, target: str) -> bool:
        """Copy frames into a new MP4 file as they are encoded; their pts count from the first.

        Parameters
        ----------
        first, stop : int
            From pts `first` to before pts `stop`.
        target : str
            Path of the new file.

        Returns
        -------
        bool
            False where they cannot be understood by themselves: the first is no keyframe, or some
            were made from frames that come after the last. Then there is no such file.

        Raises
        ------
        DamagedDataError
            There is no such place in the file.
        SourceError
            An MP4 file cannot hold them.
        """
        self.seek(first)
        packets = (packet for packet in self.packets() if packet.pts is not None)
        head = next((packet for packet in packets if packet.pts >= first), None)
        if head is None or head.pts >= stop or not head.is_keyframe:
            return False
        origin = head.pts
        try:
            with av.open(target, "w", format="mp4") as container:
                copied = container.add_stream_from_template(self._stream, opaque=True)
                copied.time_base = self.time_base
                for packet in _alone(chain((head,), packets), first, stop):
                    if packet is None:
                        break
                    packet.pts -= origin
                    packet.dts = packet.pts if packet.dts is None else packet.dts - origin
                    packet.stream = copied
                    container.mux(packet)
        except (av.FFmpegError, OSError, ValueError) as error:
            raise SourceError(
                f"frames cannot be copied ({_short(error)})", where=self.where
            ) from None
        if packet is None:
            os.unlink(target)  # noqa: PTH108  # a name, as av.open takes it
        return packet is not None

    def data_packets(self) -> Iterator[Any]:
        """Yield the packets of the tracks that are neither picture nor sound; pass over the rest.

        Nothing else can be read from this decoder afterwards.
        """
        wanted = tuple(self._container.streams.data)
        for stream in self._container.streams:
            # Older PyAV cannot pass over them, and reads them in vain.
            if stream.type != "data" and hasattr(stream, "discard"):
                stream.discard = _PASS_OVER
        if wanted:
            yield from self._packets(wanted)

    def _packets(self, streams: tuple[Any, ...]) -> Iterator[Any]:
        try:
            for packet in self._container.demux(*streams):
                if packet.size:
                    yield packet
        except (av.FFmpegError, OSError, ValueError) as error:
            self.problem = _short(error)


def probe_video(name: str) -> str | None:
    """Return the media type that a file name stands for, or None if it is no video's."""
    dot = name.rfind(".")
    return _EXTENSIONS.get(name[dot:].lower()) if dot >= 0 else None


MjpegPackets = Iterator[bytes]


class VideoFrames:
    """Random and sequential access to the frames of one video file by presentation time.

    Sequential reads go on where the last one ended, so no frame is decoded twice.

    Parameters
    ----------
    source : bytes, str or binary file
        The file, its path, or something to read and seek in.
    pts : (N,) int64
        Presentation times of the frames.
    keyframe : (N,) int64
        For each frame, the index of the frame to start decoding from.
    where : object
        Named in errors.
    pixels : int
        Most pixels of a frame.
    """

    def __init__(
        self,
        source: bytes | str | IO[bytes],
        pts: np.ndarray,
        keyframe: np.ndarray,
        where: object,
        *,
        pixels: int = MAX_PIXELS,
    ) -> None:
        self._decoder = VideoDecoder(source, where, pixels=pixels)
        self._pts = pts
        self._keyframe = keyframe
        self._pixels = FramePixels()
        self._where = where
        self._iterator: Iterator[VideoFrame] | None = None
        self._next = 0

    def read_into(self, index: int, out: np.ndarray) -> None:
        """Decode frame `index` of the file into `out`, (H, W, 1|3) uint8."""
        self._pixels.into(self.frame(index), out)

    def frame(self, index: int) -> VideoFrame:
        """Decode frame `index` of the file.

        Raises
        ------
        DamagedDataError
            It is not where the arrays say, or cannot be decoded.
        """
        start = int(self._keyframe[index])
        ahead = self._iterator is not None and self._next <= index
        if not ahead or start > self._next:
            self._decoder.seek(int(self._pts[start]))
            self._iterator = self._decoder.frames()
        target = int(self._pts[index])
        for frame in self._iterator or ():
            pts = frame.pts
            if pts == target:
                self._next = index + 1
                return frame
            if pts is None or pts > target:
                break
        self._iterator = None
        raise DamagedDataError(
            f"frame {index} (pts {target}) cannot be decoded"
            + (f": {self._decoder.problem}" if self._decoder.problem else ""),
            where=self._where,
        )

    def close(self) -> None:
        """Free the decoder."""
        self._decoder.close()
