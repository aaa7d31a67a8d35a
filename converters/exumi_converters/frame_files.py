"""Frames that are files of their own: JPEG stored verbatim, PNG as pixels."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from exumi_converters.image_stream import AddedStream, StreamSpec, describe_clock, times_of
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_data.errors import DamagedDataError, SourceError
from exumi_data.model import ArrayImages, EncodedImages, LossyStep, QualityNote
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import DataStreamWriter, EncodedStreamWriter, StreamWriter
from exumi_data.store.video import MAX_PIXELS
from exumi_data.tactile import to_grey

__all__ = [
    "FrameFile",
    "FrameFiles",
    "add_jpeg_stream",
    "add_lossy",
    "add_png_stream",
    "encoder_name",
]

_PNG, _PNG_HEADER = b"\x89PNG\r\n\x1a\n", 26

FrameFile = tuple[int, bytes]
"""Presentation time, in units of the time base, and the file."""


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """Files of frames, in order, that can be read more than once.

    Attributes
    ----------
    read : callable
        Yields (pts, file) from the first on.
    time_base : Fraction
        Seconds per unit of pts.
    rate : Fraction or None
        Frames a second, nominally.
    where : object
        Named in errors.
    clock : str
        Where the times come from: ``container``, or ``none`` where only their order is known.
    """

    read: Callable[[], Iterator[FrameFile]]
    time_base: Fraction
    rate: Fraction | None
    where: object
    clock: str = "container"


@dataclass(slots=True)
class _Found:
    """What the first pass found out."""

    pts: list[int] = field(default_factory=list)
    positions: list[int] = field(default_factory=list)  # of the good files among all
    damaged: list[tuple[int, str]] = field(default_factory=list)
    total: int = 0


class _Reader:
    """The good frames of a stream, again."""

    def __init__(self, files: FrameFiles, found: _Found, shape: tuple[int, int, int]) -> None:
        self._files = files
        self._positions = set(found.positions)
        self._shape = shape

    def _good(self) -> Iterator[bytes]:
        for position, (_, file) in enumerate(self._files.read()):
            if position in self._positions:
                yield file

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every frame, (H, W) uint8 luma."""
        for file in self._good():
            yield _decode(file, (*self._shape[:2], 1))[..., 0]

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Return some frames, ascending, each (H, W, C) uint8."""
        wanted = set(indices)
        return [_decode(file, self._shape) for i, file in enumerate(self._good()) if i in wanted]


def _decode(file: bytes, shape: tuple[int, int, int]) -> np.ndarray:
    out = np.empty(shape, dtype=np.uint8)
    jpeg.decode_into(file, out)
    return out


def _check(file: bytes, shape: tuple[int, int, int]) -> np.ndarray:
    """Decode a frame's luma, and so find out whether it is whole."""
    if not jpeg.is_jpeg(file):
        raise DamagedDataError("the JPEG is cut short")
    if shape[0] * shape[1] > MAX_PIXELS:
        raise DamagedDataError(f"it claims {shape[1]}x{shape[0]} pixels: more than are read")
    if jpeg.size_of(file) != shape:
        raise DamagedDataError(f"it is {jpeg.size_of(file)} (height, width, channels), not {shape}")
    return _decode(file, (*shape[:2], 1))[..., 0]


def add_jpeg_stream(writer: EpisodeWriter, spec: StreamSpec, files: FrameFiles) -> AddedStream:
    """Store JPEG files verbatim as a stream, with reference, activity and salience if tactile.

    A file that cannot be decoded is left out: a gap is recorded in its place, and a quality note
    says so.

    Parameters
    ----------
    writer : EpisodeWriter
    spec : StreamSpec
    files : FrameFiles

    Returns
    -------
    AddedStream

    Raises
    ------
    SourceError
        Not one frame can be decoded.
    """
    first = _first_good(files)
    shape = jpeg.size_of(first)
    stream: EncodedStreamWriter = writer.add_stream(
        spec.name,
        kind=spec.kind,
        images=EncodedImages(
            encoding="encoded",
            media_type="image/jpeg",
            height=shape[0],
            width=shape[1],
            channels=1 if shape[2] == 1 else 3,
        ),
        **spec.fields(),
    )
    found, analysis, comments, times = _Found(), TactileAnalysis(), set(), []
    for pts, file in files.read():
        position = found.total
        found.total += 1
        times.append(pts)
        try:
            grey = _check(file, shape)
        except DamagedDataError as error:
            found.damaged.append((position, error.what))
            continue
        stream.append(int(times_of([pts], files.time_base)[0]), file)
        found.pts.append(pts)
        found.positions.append(position)
        comments.add(jpeg.comment(file))
        if spec.kind == "tactile":
            analysis.add(grey)
    _describe(stream, found, files)
    if found.damaged:
        writer.metadata.quality.append(_damaged_note(spec.name, found))
    _name_encoder(writer, stream, comments)
    if spec.kind == "tactile":
        analysis.finish(writer, stream, _Reader(files, found, shape))
    return AddedStream(stream, times_of(times, files.time_base))


def _describe(stream: StreamWriter, found: _Found, files: FrameFiles) -> None:
    time = times_of(found.pts, files.time_base)
    describe_clock(stream, time, files.rate, files.time_base, source=files.clock)


def _first_good(files: FrameFiles) -> bytes:
    """Return the first file that decodes: it says what size the others have."""
    reason = "there is none"
    for _, file in files.read():
        try:
            _check(file, jpeg.size_of(file))
        except DamagedDataError as error:
            reason = error.what
        else:
            return file
    raise SourceError(
        f"no frame can be decoded ({reason})",
        where=files.where,
        fix="Get the file again from its source, or leave it out.",
    )


def _damaged_note(stream: str, found: _Found) -> QualityNote:
    listed = ", ".join(f"{position} ({reason})" for position, reason in found.damaged[:5])
    more = ", ..." if len(found.damaged) > 5 else ""
    # Only the end is missing: that is a file that was cut.
    cut = found.damaged[0][0] == len(found.positions)
    return QualityNote(
        code="truncated" if cut else "damaged-frames",
        message=f"{len(found.damaged)} of {found.total} frames cannot be decoded and were left "
        f"out: {listed}{more}",
        stream=stream,
    )


def _name_encoder(
    writer: EpisodeWriter, stream: EncodedStreamWriter, comments: set[str | None]
) -> None:
    """Say who made the JPEGs, if they do: a camera's own bear no encoder's name."""
    comment = comments.pop() if len(comments) == 1 else None
    if comment is None or not isinstance(stream.model.images, EncodedImages):  # type: ignore[attr-defined]  # an image stream
        return
    stream.model.images.jpeg_comment = comment  # type: ignore[attr-defined]  # an image stream
    add_lossy(
        writer,
        LossyStep(
            step="jpeg-encode",
            stream=stream.name,
            detail="the frames were encoded as JPEG at capture, before this conversion: the "
            "comment in each of them names the encoder; the conversion kept their bytes",
            by=encoder_name(comment),
        ),
    )


def encoder_name(text: str) -> str:
    """Make the name that a file gives its encoder readable: FFmpeg's libraries sign for it."""
    return f"FFmpeg ({text})" if text.startswith(("Lavc", "Lavf")) else text


def add_lossy(writer: EpisodeWriter, step: LossyStep) -> None:
    """Put a step at which information was lost on record."""
    source = writer.metadata.source
    source.lossy = [*(source.lossy or []), step]


def add_png_stream(writer: EpisodeWriter, spec: StreamSpec, files: FrameFiles) -> AddedStream:
    """Store PNG files as pixels, without loss; see `add_jpeg_stream`.

    Raises
    ------
    SourceError
        A file cannot be decoded, or differs in size from the first.
    """
    import cv2

    def pixels() -> Iterator[tuple[int, np.ndarray]]:
        for pts, file in files.read():
            _check_png(file, pts, files.where)
            image = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR_RGB)
            if image is None:
                raise SourceError(f"frame {pts} is no readable PNG", where=files.where)
            yield pts, np.asarray(image, np.uint8)

    found, analysis = _Found(), TactileAnalysis()
    stream: DataStreamWriter | None = None
    for pts, image in pixels():
        if stream is None:
            height, width = image.shape[:2]
            stream = writer.add_stream(
                spec.name,
                kind=spec.kind,
                images=ArrayImages(encoding="array", height=height, width=width, channels=3),
                **spec.fields(),
            )
        analysis.add(to_grey(image))
        stream.append(int(times_of([pts], files.time_base)[0]), image)
        found.pts.append(pts)
    if stream is None:
        raise SourceError("there is no frame", where=files.where)
    _describe(stream, found, files)
    if spec.kind == "tactile":
        analysis.finish(writer, stream, _PixelReader(lambda: (image for _, image in pixels())))
    return AddedStream(stream, times_of(found.pts, files.time_base))


def _check_png(file: bytes, pts: int, where: object) -> None:
    """Refuse what is no PNG of 8 bits, or claims more pixels than are read, before it is decoded.

    Raises
    ------
    SourceError
    """
    if not file.startswith(_PNG) or len(file) < _PNG_HEADER:
        raise SourceError(f"frame {pts} is no readable PNG", where=where)
    width, height = int.from_bytes(file[16:20], "big"), int.from_bytes(file[20:24], "big")
    if width * height > MAX_PIXELS:
        raise SourceError(
            f"frame {pts} claims {width}x{height} pixels: more than are read", where=where
        )
    if file[24] > 8:
        raise SourceError(
            f"frame {pts} has {file[24]} bits a channel, of which 8 would be kept", where=where
        )


class _PixelReader:
    """Frames that are pixels already, again."""

    def __init__(self, read: Callable[[], Iterator[np.ndarray]]) -> None:
        self._read = read

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every frame, (H, W) uint8."""
        return (to_grey(image) for image in self._read())

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Return some frames, ascending."""
        wanted = set(indices)
        return [image for i, image in enumerate(self._read()) if i in wanted]
