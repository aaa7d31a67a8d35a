"""How the frames of an image stream are stored (spec: Images)."""

from typing import Annotated, Literal

from pydantic import Field

from exumi_data.model.base import WHOLE_NUMBER, Identifier, Int64, Model, Rational, Sha256

__all__ = ["ArrayImages", "EncodedImages", "Images", "VideoFile", "VideoImages"]

Side = Annotated[int, Field(ge=1, le=65535)]


class _Images(Model):
    height: Side
    width: Side
    channels: Annotated[Literal[1, 3], WHOLE_NUMBER]
    """1 is grey, 3 is RGB, in this order."""


class ArrayImages(_Images):
    """Frames as an array ``data`` (N, H, W, C) uint8, one frame an inner chunk: lossless."""

    encoding: Literal["array"]


class EncodedImages(_Images):
    """Frames as image files end to end: ``data`` (B,), ``offset`` (N+1,), ``crc32c`` (N,)."""

    encoding: Literal["encoded"]
    media_type: Literal["image/jpeg"]
    jpeg_comment: str | None = None
    """The comment that all frames carry: it often names the encoder."""


class VideoFile(Model):
    """One container file of a video stream, kept verbatim."""

    name: Identifier
    media_type: Literal[
        "video/mp4", "video/quicktime", "video/x-msvideo", "video/x-matroska", "video/webm"
    ]
    codec: Identifier
    """FFmpeg's name of the codec, such as ``mpeg4``, ``h264`` or ``hevc``."""
    pixel_format: Identifier | None = None
    time_base: Rational
    """Seconds per unit of ``pts``."""
    start_ns: Int64 = 0
    """``time`` of the frame whose pts is 0: ``time = start_ns + pts·time_base``."""
    sha256: Sha256
    bytes: Annotated[int, Field(ge=1)]


class VideoImages(_Images):
    """Frames as inter-frame video: container files verbatim.

    ``data`` (B,), ``offset`` (F+1,); per frame ``file``, ``pts`` and ``keyframe`` (N,).
    """

    encoding: Literal["video"]
    files: list[VideoFile] = []


Images = Annotated[ArrayImages | EncodedImages | VideoImages, Field(discriminator="encoding")]
