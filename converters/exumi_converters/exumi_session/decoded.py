"""Frames of a video as JPEG: a lossy step of its own, which the episode's metadata state."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exumi_converters.frame_files import add_lossy
from exumi_data.clips.clip import ClipFrames
from exumi_data.errors import SourceError
from exumi_data.model import EncodedImages, LossyStep
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.video import FramePixels, VideoDecoder

__all__ = ["as_jpeg", "estimated_bytes", "jpeg_frames", "note_decoding"]

UInt8Array = NDArray[np.uint8]

_BYTES_PER_PIXEL = 0.15
"""Of a JPEG of quality 95, about: a gel's or a room's."""


def estimated_bytes(videos: Iterable[Path]) -> int:
    """Return about how large the frames of some videos will be as JPEG, by their headers.

    Parameters
    ----------
    videos : iterable of pathlib.Path
    """
    pixels = 0
    for path in videos:
        try:
            with VideoDecoder(str(path), path) as decoder:
                pixels += decoder.width * decoder.height * decoder.declared_frames
        except SourceError:
            continue  # converting says what is the matter with it
    return round(_BYTES_PER_PIXEL * pixels)


def as_jpeg(frames: ClipFrames) -> EncodedImages:
    """Return how frames of a video are stored as JPEG."""
    return EncodedImages(
        encoding="encoded",
        media_type="image/jpeg",
        height=frames.height,
        width=frames.width,
        channels=frames.channels,
    )


def jpeg_frames(
    video: Path, wanted: Mapping[int, int], like: ClipFrames, quality: int
) -> Iterator[tuple[int, bytes, UInt8Array]]:
    """Decode some frames of a video and encode them as JPEG, in order.

    Parameters
    ----------
    video : pathlib.Path
    wanted : mapping of int to int
        Presentation times of the frames, and what they are called.
    like : ClipFrames
        Size and channels.
    quality : int

    Yields
    ------
    int
        What the frame is called.
    bytes
        The JPEG.
    (H, W) uint8
        Luma of the frame, before it was encoded.
    """
    if not wanted:
        return
    pixels = FramePixels()
    left = set(wanted)
    with VideoDecoder(str(video), video) as decoder:
        for frame in decoder.frames():
            pts = int(frame.pts or 0)
            if pts not in left:
                continue
            left.discard(pts)
            colour = like.channels == 3
            grey = pixels.grey(frame)
            file = jpeg.encode(pixels.rgb(frame) if colour else grey[..., None], quality)
            yield wanted[pts], file, grey
            if not left:
                return


def note_decoding(writer: EpisodeWriter, stream: str, frames: ClipFrames, quality: int) -> None:
    """Put on record that frames were decoded and encoded again."""
    add_lossy(
        writer,
        LossyStep(
            step="jpeg-encode",
            stream=stream,
            detail=f"the frames were decoded from {frames.file.codec} and encoded as JPEG",
            parameters={"quality": quality},
        ),
    )
